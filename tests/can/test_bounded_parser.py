"""Databases that take all memory or time: refused, by a process that pays for it alone."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from pathlib import Path

import pytest

from imucald.can.dbc import bounded_parser, database
from imucald.can.dbc.database import load_database, load_database_text
from imucald.can.dbc.database_limits import refuse_heavy
from imucald.core.errors import DatabaseError
from imucald.core.memory import allowed_memory

UNIT_MEMORY = 512 * 2**20
HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_: A\nBO_ 16 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|0] "" A\n'
COMMENT = 'CM_ BO_ 16 "{}";\n'
PROBE = """
import resource, sys
from pathlib import Path
from imucald.can.dbc import bounded_parser, database
from imucald.can.dbc.database import load_database
from imucald.core.errors import DatabaseError
bounded_parser.allowed_memory = database.allowed_memory = lambda: int(sys.argv[2])
try:
    print("read", len(load_database(Path(sys.argv[1])).messages))
except DatabaseError as error:
    print("refused", error)
status = Path("/proc/self/status").read_text()  # ru_maxrss would be at least the test runner's
print(next(int(x.split()[1]) // 1024 for x in status.splitlines() if x.startswith("VmHWM")))
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss // 1024)
"""


def ordinary(messages: int) -> str:
    """A database as vehicles have them: 12 signals a message, a comment each."""
    lines = ['VERSION ""\nNS_ :\nBS_:\nBU_: A']
    for m in range(messages):
        lines.append(f"BO_ {0x8000_0001 + m} MSG_{m}: 8 A")
        lines += [f' SG_ Signal_{m}_{s} : {5 * s}|5@1+ (0.01,0) [0|100] "m/s" A' for s in range(12)]
    lines += [f'CM_ SG_ {0x8000_0001 + m} Signal_{m}_0 "what it says";' for m in range(messages)]
    return "\n".join(lines) + "\n"


def probed(path: Path, memory: int) -> tuple[str, int, int]:
    """What loading says, and the peak of this process and of the parser's [MiB]."""
    command = [sys.executable, "-c", PROBE, str(path), str(memory)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    outcome, own, parsers = done.stdout.splitlines()
    return outcome, int(own), int(parsers)


@pytest.mark.parametrize("megabytes", [5, pytest.param(20, marks=pytest.mark.slow)])
def test_megabytes_of_comment_are_refused_within_what_the_unit_allows(megabytes, tmp_path):
    path = tmp_path / "talk.dbc"
    path.write_text(HEAD + COMMENT.format("word " * (megabytes * 200_000)))
    outcome, own, parsers = probed(path, UNIT_MEMORY)
    assert outcome.startswith("refused")
    assert "307 MiB of memory" in outcome
    assert own < 150
    assert own + parsers < UNIT_MEMORY / 2**20


@pytest.mark.slow
def test_a_vehicles_whole_database_is_read_within_what_the_unit_allows(tmp_path):
    path = tmp_path / "car.dbc"
    path.write_text(ordinary(5000))
    assert path.stat().st_size > 3_500_000
    outcome, own, parsers = probed(path, UNIT_MEMORY)
    assert outcome == "read 5000"
    assert own + parsers < UNIT_MEMORY / 2**20


def test_a_process_of_its_own_reads_the_same_and_refuses_in_the_same_words(monkeypatch):
    good, bad = ordinary(50), ordinary(50) + "SIG_VALTYPE_ oops ;\n"
    here = load_database_text(good, "dbc", "x")
    with pytest.raises(DatabaseError) as refused_here:
        load_database_text(bad, "dbc", "x")
    monkeypatch.setattr(bounded_parser, "SMALL", 0)
    assert load_database_text(good, "dbc", "x").messages == here.messages
    with pytest.raises(DatabaseError) as refused_there:
        load_database_text(bad, "dbc", "x")
    assert str(refused_there.value) == str(refused_here.value)


def test_a_parser_that_crashes_is_a_database_that_was_refused(monkeypatch):
    crash = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
    monkeypatch.setattr(bounded_parser, "_START", crash)
    monkeypatch.setattr(bounded_parser, "SMALL", 0)
    with pytest.raises(DatabaseError, match=r"^x: cannot be read with \d+ MiB"):
        load_database_text(HEAD, "dbc", "x")


@pytest.mark.slow
def test_a_parser_that_takes_for_ever_is_ended(monkeypatch):
    endless = """
import sys, json
sys.path[:] = json.loads(sys.argv[1])
from imucald.core.memory import limit_own
limit_own(1 << 30, 1)
while True: pass
"""
    monkeypatch.setattr(bounded_parser, "_START", endless)
    monkeypatch.setattr(bounded_parser, "SMALL", 0)
    began = time.monotonic()
    with pytest.raises(DatabaseError, match="of processor time"):
        load_database_text(HEAD, "dbc", "x")
    assert time.monotonic() - began < 30.0


@pytest.mark.parametrize(
    ("kind", "text"),
    [
        ("sym", "Sig=" * 250_000),
        ("sym", "Sig= x " * 150_000),
        ("sym", "Sig=A 1" + " 12345h" * 150_000),
        ("sym", "Sig=A " + "9" * 12 + " " * 900_000),
        ("dbc", "SG_ " * 250_000),
        ("dbc", "SG_ a " + "b" * 1_000_000),
        ("dbc", "BO_ " + "1" * 1_000_000),
        ("dbc", "BO_ " * 200_000),
        ("dbc", "SG_MUL_VAL_ " * 80_000),
        ("kcd", "<Message " * 110_000),
        ("kcd", "<Message " + "length " * 150_000),
        ("arxml", "<a:" * 300_000),
    ],
    ids=lambda value: value[:14] if len(value) > 5 else value,
)
def test_a_megabyte_of_anything_is_looked_through_in_a_moment(kind, text):
    began = time.process_time()
    with contextlib.suppress(DatabaseError):
        refuse_heavy(text, kind, "x")
    assert time.process_time() - began < 1.0


@pytest.mark.parametrize(
    "message",
    [
        "BO_ 5 X: 5000 A",
        "BO_ 5X:5000 A",
        "BO_ -5 X : 5000 A",
        "BO_ 5\nX\n:\n5000 A",
        "BO_ 5 A_BO_X: 5000 A",
    ],
)
def test_a_message_that_is_too_long_is_refused_however_it_is_spaced(message):
    with pytest.raises(DatabaseError, match="x:2: the number 5000 is larger than 4096"):
        refuse_heavy(f"BS_: 500000\n{message}\n", "dbc", "x")


def test_numbers_that_are_no_lengths_are_none():
    text = f'NS_ :\n BO_TX_BU_\n\nBS_: 500000\n{HEAD}CM_ BO_ 16 "period: 100000 us";\n'
    refuse_heavy(text, "dbc", "x")


def test_a_small_text_that_needs_all_memory_is_refused(monkeypatch):
    def parse(*_):
        raise MemoryError

    monkeypatch.setattr(bounded_parser, "parse", parse)
    with pytest.raises(DatabaseError, match="x: reading it needs more memory"):
        bounded_parser.parse_bounded("BO_", "dbc", "x")


def test_a_file_larger_than_memory_could_hold_is_refused_unread(tmp_path, monkeypatch):
    path = tmp_path / "long.arxml"
    with path.open("wb") as file:
        file.truncate(40 * 2**20)
    monkeypatch.setattr(database, "allowed_memory", lambda: UNIT_MEMORY)
    assert database.max_file_bytes() == 32 * 2**20
    with pytest.raises(DatabaseError, match="larger than 32 MiB"):
        load_database(path)


def test_the_memory_allowed_is_the_least_of_the_groups_around(tmp_path):
    inner = tmp_path / "system.slice" / "imucald"
    inner.mkdir(parents=True)
    own = tmp_path / "own"
    own.write_text("1:name=systemd:/x\n0::/system.slice/imucald\n")
    physical = allowed_memory(own, tmp_path)
    (inner / "memory.max").write_text("max\n")
    assert allowed_memory(own, tmp_path) == physical > 1 << 28
    (inner / "memory.max").write_text("100000000\n")
    assert allowed_memory(own, tmp_path) == 100_000_000
    (inner.parent / "memory.max").write_text("90000000\n")
    assert allowed_memory(own, tmp_path) == 90_000_000
    assert allowed_memory(tmp_path / "none", tmp_path) == physical


@pytest.mark.parametrize("kind", ["RLIMIT_AS", "RLIMIT_DATA"])
def test_the_memory_allowed_is_no_more_than_the_process_may_have(kind):
    code = (
        "import resource; from imucald.core.memory import allowed_memory\n"
        f"resource.setrlimit(resource.{kind}, (500_000_000, resource.RLIM_INFINITY))\n"
        "print(allowed_memory())"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) == 500_000_000


def test_a_wrong_database_is_refused_also_where_the_end_of_processes_is_not_seen():
    """SIGCHLD may be ignored from the start: every process seems to end with status 0."""
    code = (
        "import signal, sys; signal.signal(signal.SIGCHLD, signal.SIG_IGN)\n"
        "from imucald.can.dbc.bounded_parser import parse_bounded\n"
        "from imucald.core.errors import DatabaseError\n"
        "try: parse_bounded(sys.stdin.read(), 'dbc', 'big.dbc')\n"
        "except DatabaseError as error: print(error)\n"
    )
    command = [sys.executable, "-c", code]
    text = "BO_ nonsense\n" * 20_000
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout.startswith("big.dbc: cannot be read: DBC: ")
