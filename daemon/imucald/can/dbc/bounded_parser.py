"""Parse databases with limits: a large database is parsed in a separate process.

The parser needs 30 to 220 times as much memory as its text. The factor cannot be predicted from the
text. If the separate process exceeds its limits or crashes, the database is refused, and this
process continues.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from imucald.can.dbc.message import Message
from imucald.can.dbc.parser import parse
from imucald.core.errors import DatabaseError
from imucald.core.memory import allowed_memory, limit_own

if TYPE_CHECKING:
    import subprocess

SMALL = 64 * 2**10
"""Largest text [characters] that this process parses itself. 220 times this size is 14 MiB."""
_START = """
import json, sys
sys.path[:] = json.loads(sys.argv[1])
from imucald.can.dbc.bounded_parser import parse_for_parent
sys.exit(parse_for_parent(*sys.argv[2:]))
"""


def parse_bounded(text: str, database_format: str, source: str) -> list[Message]:
    """Return the messages of a database's text. Raises DatabaseError if the text is wrong or too
    large."""
    if len(text) <= SMALL or not sys.executable:
        try:
            return parse(text, database_format, source)
        except MemoryError:
            raise DatabaseError(
                f"{source}: reading it needs more memory than the machine has"
            ) from None
    import subprocess  # noqa: PLC0415 - large databases only

    # the rest is for this process and two copies of the text
    memory = int(allowed_memory() * 0.6)
    # a slow processor takes 10 s per megabyte of DBC
    seconds = max(60, 10 * len(text) // 10**6)
    flags = [flag for flag, is_set in _interpreter_flags() if is_set]
    arguments = [json.dumps(sys.path), database_format, source, str(memory), str(seconds)]
    try:
        done = subprocess.run(
            [sys.executable, *flags, "-c", _START, *arguments],
            input=text.encode("utf-8", "surrogatepass"),
            capture_output=True,
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
            timeout=4.0 * seconds,  # wall-clock time, since the processor is shared
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise DatabaseError(f"{source}: reading it takes too long") from None
    except (OSError, ValueError) as error:
        raise DatabaseError(f"{source}: no process could be started for it: {error}") from None
    try:
        if done.returncode == 0:
            return msgspec.json.decode(done.stdout, type=list[Message])
    except msgspec.DecodeError:
        pass  # if SIGCHLD is ignored (inherited), the status of every process is 0
    raise DatabaseError(f"{source}: {_why(done, memory, seconds)}")


def parse_for_parent(database_format: str, source: str, memory: str, seconds: str) -> int:
    """Parse the text on standard input, and write its messages as JSON. Runs in the separate
    process. Returns the exit code: 1 means that a reason was written instead."""
    limit_own(int(memory), int(seconds))
    with contextlib.suppress(OSError):  # if memory runs out, kill this process first
        Path("/proc/self/oom_score_adj").write_text("1000")
    try:
        text = sys.stdin.buffer.read().decode("utf-8", "surrogatepass")
        found = msgspec.json.encode(parse(text, database_format, source))
    except DatabaseError as error:
        sys.stderr.write(str(error).removeprefix(f"{source}: "))
        return 1
    except MemoryError:
        return 2
    sys.stdout.buffer.write(found)
    return 0


def _why(done: subprocess.CompletedProcess[bytes], memory: int, seconds: int) -> str:
    messages = done.stderr.decode("utf-8", "replace").strip().splitlines()
    if done.returncode in (0, 1) and messages:
        return messages[-1]
    return (
        f"cannot be read with {memory // 2**20} MiB of memory and {seconds} s of processor "
        "time; remove the messages that are not used, or allow more memory (MemoryMax= of "
        "the unit)"
    )


def _interpreter_flags() -> list[tuple[str, Any]]:
    return [("-I", sys.flags.isolated), ("-S", sys.flags.no_site), ("-s", sys.flags.no_user_site)]
