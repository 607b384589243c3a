"""SIGTERM and SIGHUP end a command as they should: tidied up, all printed, dead of the signal."""

from __future__ import annotations

import os
import pty
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

IMUCALD = [sys.executable, "-m", "imucald"]


def ended(
    arguments: list[str],
    ready: Callable[[subprocess.Popen[bytes]], bool],
    folder: Path,
    number: signal.Signals,
) -> subprocess.Popen[bytes]:
    """A command after a signal, sent once `ready` says so; its TMPDIR is the folder."""
    process = subprocess.Popen(
        [*IMUCALD, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "TMPDIR": str(folder)},
        cwd=folder,
    )
    try:
        end = time.monotonic() + 60.0
        while not ready(process):
            assert time.monotonic() < end
            assert process.poll() is None, process.communicate()
            time.sleep(0.02)
        process.send_signal(number)
        process.wait(20.0)
    finally:
        process.kill()
    return process


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_live_demo_leaves_no_folder_and_what_it_showed_is_there(
    tmp_path: Path, number: signal.Signals
) -> None:
    began: list[float] = []

    def has_shown(_: subprocess.Popen[bytes]) -> bool:
        if any(tmp_path.glob("imucald-live-*/status.sock")):
            began.append(time.monotonic())
        return bool(began) and time.monotonic() > began[0] + 2.0

    process = ended(["demo", "--live", "--minutes", "2"], has_shown, tmp_path, number)
    assert process.returncode == -number
    assert list(tmp_path.iterdir()) == []
    assert process.stdout is not None
    assert b"simulated car" in process.stdout.read(), "what was shown may not stay in a buffer"


@pytest.mark.slow
def test_a_terminal_that_is_closed_leaves_no_folder_of_a_live_demo(tmp_path: Path) -> None:
    """Nothing can be written any more then, and what was begun is tidied up all the same."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ["TMPDIR"] = str(tmp_path)
        os.execv(sys.executable, [*IMUCALD, "demo", "--live", "--minutes", "2"])
    end = time.monotonic() + 60.0
    while not any(tmp_path.glob("imucald-live-*/status.sock")):
        assert time.monotonic() < end
        if select.select([terminal], [], [], 0.05)[0]:
            os.read(terminal, 65536)
    os.close(terminal)
    _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == -signal.SIGHUP
    assert list(tmp_path.iterdir()) == []
