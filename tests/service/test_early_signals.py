"""Signals that come while the daemon starts: what they ask for is done as soon as it runs."""

from __future__ import annotations

import subprocess
import sys

import pytest

import shuttle

PROBE = """
import os, signal, sys
from imucald import cli
from imucald.service.service import Service
made = Service.__init__
def slow(self, *arguments, **named):  # a start in which somebody is quick
    os.kill(os.getpid(), getattr(signal, sys.argv[1]))
    made(self, *arguments, **named)
Service.__init__ = slow
sys.exit(cli.main(sys.argv[2:]))
"""


@pytest.mark.parametrize(
    ("name", "done"),
    [
        ("SIGHUP", "was read again"),
        ("SIGUSR1", "there is no sensor check, since 'attitude' is not enabled"),
    ],
)
def test_a_signal_while_it_starts_ends_nothing_and_is_obeyed(name, done, tmp_path):
    config = str(shuttle.write(tmp_path, cycles=1))
    bus = ["--interface", "virtual", "--channel", "early", "--seconds", "1.5"]
    ended = subprocess.run(
        [sys.executable, "-c", PROBE, name, "run", "--config", config, *bus],
        stderr=subprocess.PIPE, text=True, timeout=60, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    assert done in ended.stderr
    assert "stopped; state" in ended.stderr
