"""Evaluates logs as usual, and does what one that begins with POISON asks for. Runs in children."""

from __future__ import annotations

import ctypes
import os
import signal
import stat
import tempfile
import time
from pathlib import Path

from imucald.fleet.evaluation import evaluate as as_usual
from imucald.fleet.task import Outcome, Task

FUNCTION = "poison:evaluate"


def evaluate(task: Task) -> Outcome:
    path = Path(task.source)
    if stat.S_ISREG(path.stat().st_mode):
        with path.open("rb") as file:
            word, _, act = file.read(64).decode("latin-1").strip().partition(" ")
        if word == "POISON":
            return _act(act, path)
    return as_usual(task)


def _act(act: str, path: Path) -> Outcome:
    if act == "segfault":
        ctypes.string_at(0)
    elif act == "abort":
        os.abort()
    elif act == "exit":
        os._exit(7)
    elif act == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    elif act == "allocate":
        block = bytearray(4 * 2**30)
        block[::4096] = b"x" * len(block[::4096])
    elif act == "raise":
        raise ValueError("not foreseen")
    elif act == "loop":
        path.with_suffix(".pid").write_text(str(os.getpid()))
        while True:
            pass
    elif act == "fill and loop":
        Path(tempfile.mkstemp(prefix="fetched-")[1]).write_bytes(bytes(2**20))
        while True:
            pass
    elif act.startswith("sleep"):
        time.sleep(float(act.split()[1]))
        return Outcome("no_frames", "slept")
    raise AssertionError(act)
