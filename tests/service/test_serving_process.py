"""The process that serves metrics beside the daemon, also where SIGCHLD is ignored."""

from __future__ import annotations

import subprocess
import sys

import pytest

PROBE = """
import os, signal, sys, time
if sys.argv[1] == "ignored":
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
from imucald.service.listening import ServingProcess, listening_at
made = ServingProcess(listening_at("127.0.0.1:0"), lambda _: time.sleep(float(sys.argv[2])))
print(made.poll())
end = time.monotonic() + float(sys.argv[3])
while not (ended := made.poll()) and time.monotonic() < end:
    time.sleep(0.01)
print(ended, made.poll())
made.close()
print(made.has_ended)
# Where SIGCHLD is ignored, the kernel wakes a waiting parent before it takes the number away.
end = time.monotonic() + 20.0
while time.monotonic() < end:
    try:
        os.kill(made.pid, 0)
    except ProcessLookupError:
        print("gone")
        break
    time.sleep(0.01)
"""


def probed(signal_is: str, lives: float, watched: float) -> list[str]:
    command = [sys.executable, "-c", PROBE, signal_is, str(lives), str(watched)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.parametrize("signal_is", ["ignored", "as usual"])
def test_one_that_ends_by_itself_is_noticed_once(signal_is):
    assert probed(signal_is, 0.2, 30.0) == ["False", "True False", "True", "gone"]


@pytest.mark.parametrize("signal_is", ["ignored", "as usual"])
def test_one_that_serves_ends_with_the_daemon(signal_is):
    assert probed(signal_is, 60.0, 0.0) == ["False", "False False", "True", "gone"]
