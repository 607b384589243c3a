"""What needs no bus runs where a system has less than Linux: Windows, macOS."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import can
import pytest

from imucald.can.logs.log_reader import CandumpWriter
from paths import ROOT
from simulated_bus import drive_frames

LESS = """
import os, select, signal, socket, sys, time
# libraries know their systems themselves; what they load here is loaded before
import asyncio, multiprocessing, subprocess, tempfile
import can, cantools, jinja2, matplotlib.pyplot, msgspec, numpy, rich.live, rich.progress
import scipy.linalg, scipy.optimize, threadpoolctl, yaml

class Absent:
    NAMES = ("fcntl", "grp", "pty", "pwd", "resource", "syslog", "termios", "tty")

    def find_spec(self, name, path=None, target=None):
        if name in self.NAMES:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

for name in Absent.NAMES:
    sys.modules.pop(name, None)
sys.meta_path.insert(0, Absent())
ABSENT = {
    os: ("chown", "fchmod", "fchown", "fork", "getegid", "geteuid", "getgid", "getuid", "killpg",
         "mkfifo", "O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW", "O_NONBLOCK", "pread", "pwrite",
         "register_at_fork", "sched_getaffinity", "setsid", "statvfs", "sysconf", "uname"),
    select: ("epoll", "poll"),
    signal: ("alarm", "ITIMER_REAL", "pthread_kill", "pthread_sigmask", "setitimer", "SIGALRM",
             "SIGCHLD", "SIGHUP", "SIGKILL", "SIGPIPE", "SIGQUIT", "SIGUSR1", "SIGUSR2"),
    socket: ("AF_CAN", "AF_UNIX", "CAN_RAW", "CMSG_SPACE", "PF_CAN", "SO_PEERCRED"),
    time: ("clock_gettime", "CLOCK_MONOTONIC", "pthread_getcpuclockid", "tzset"),
}
for module, names in ABSENT.items():
    for name in names:
        if hasattr(module, name):
            delattr(module, name)

from imucald.cli import main
sys.exit(main(sys.argv[1:]))
"""


def run(*arguments: object) -> str:
    command = [sys.executable, "-c", LESS, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


@pytest.mark.slow
def test_init_check_and_replay_run_without_what_only_linux_has(tmp_path: Path) -> None:
    log, config = tmp_path / "drive.log", tmp_path / "car.yaml"
    with CandumpWriter(log) as writer:
        writer.write_columns(drive_frames())
    database = ROOT / "dbc" / "imucald_example.dbc"
    assert "quantities" in run("init", "--database", database, log, "--out", config)
    assert "can be used" in run("check", "--config", config, log)
    result = tmp_path / "result.json"
    options = ["--report", tmp_path / "page", "--write", tmp_path / "drive.csv", "--json", result]
    run("replay", "--config", config, log, *options)
    assert json.loads(result.read_text())["frames"]["used"] > 1000
    assert (tmp_path / "drive.accel.csv").exists()
    assert list((tmp_path / "page").glob("*.html"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["drive.asc", "drive.blf"])
def test_logs_of_tools_that_run_on_windows_are_read_there(name: str, tmp_path: Path) -> None:
    log, result = tmp_path / name, tmp_path / "result.json"
    frames = drive_frames(minutes=1.0)
    rows = zip(frames.t, frames.can_id, frames.data, frames.length, strict=True)
    with can.Logger(log) as writer:
        for t, can_id, data, length in rows:
            writer.on_message_received(
                can.Message(float(t), int(can_id), is_extended_id=False, data=bytes(data[:length]))
            )
    run("replay", "--config", ROOT / "config" / "imucald.yaml", log, "--json", result)
    counts = json.loads(result.read_text())["frames"]
    assert counts["read"] == len(frames)
    assert counts["used"] > 0.99 * len(frames)


@pytest.mark.slow
def test_other_commands_without_a_bus_run_there(tmp_path: Path) -> None:
    assert '"$schema"' in run("schema")
    run("draw", "--axes", "--out", tmp_path / "axes.svg")
    run("simulate", "--minutes", "0.1", "--out", tmp_path / "short.log")
    assert "imucald COMMAND --help" in run("--help")
