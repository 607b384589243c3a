"""`imucald demo --live`: a simulated bus, the real daemon and the monitor, in one process."""

from __future__ import annotations

import contextlib
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from imucald import cli
from imucald.commands import demo_live


@pytest.mark.slow
def test_a_short_drive_passes_through_daemon_and_monitor(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("LINES", "60")
    # A daemon that is behind leaves frames out that are late: a pace that a slow machine keeps.
    arguments = ["--minutes", "0.4", "--speed", "3", "--mount", "-5,3,30", "--seed", "2"]
    assert cli.main(["demo", "--live", *arguments]) == 0
    text = capsys.readouterr().out
    accel = re.search(r"accel +[\d.]+/s +(\d+) +sound", text)
    assert accel is not None, text
    assert 0.7 * 2400 < int(accel[1]) <= 2400, "it is shown until the last frame was sent"
    assert "0 in conflict" in text
    assert "levelled" in text
    assert re.search(r"Found: +roll [-+]\d+\.\d\d° ±.*\(mount: levelled\)", text)
    assert (
        "The truth: roll -5.00°, pitch +3.00°, yaw +30.00°; x points forward, 30 deg left"
        in " ".join(text.split())
    )


def test_the_socket_for_status_and_orders_is_shown(monkeypatch):
    shown = []

    class Bus:
        def __init__(self, *_: object) -> None: ...
        def start(self) -> None: ...
        def is_over(self) -> bool: ...
        def close(self) -> None: ...

    truth = {"duration_s": 1.0, "mount": {"roll_deg": 0.0, "pitch_deg": 0.0, "yaw_deg": 0.0}}
    monkeypatch.setattr(demo_live, "SimulatedBus", Bus)
    monkeypatch.setattr(demo_live, "_simulated", lambda *_: truth)
    monkeypatch.setattr(
        demo_live, "_daemon", lambda *_: contextlib.nullcontext(Path("/x/status.sock"))
    )
    monkeypatch.setattr(demo_live, "watch", lambda *given: shown.append(given))
    demo_live.run_live(1, 1.0, None, "virtual", None, 1.0, None)
    ((path, _, _, note),) = shown
    assert f"--socket {path}" in note


def test_a_slow_machine_is_watched_until_its_bus_has_sent_the_last_frame(tmp_path):
    log = tmp_path / "drive.log"
    log.write_text("".join(f"({k * 0.01:.6f}) can0 123#00\n" for k in range(30)))
    bus = demo_live.SimulatedBus(log, "virtual", "a-slow-one", 1.0)
    sent, send = [], bus._bus.send

    def slowly(message):
        time.sleep(0.03)  # three times as long as the drive took
        send(message)
        sent.append(message)

    bus._bus.send = slowly
    bus.start()
    while not bus.is_over():
        assert len(sent) <= 30
        time.sleep(0.01)
    bus.close()
    assert len(sent) == 30


LEAN = """
import re, sys
from pathlib import Path
from imucald.cli import main
status = main(["demo", "--live", "--minutes", "0.5", "--speed", "20"])
heavy = {"scipy", "imucald.simulation", "asammdf"} & set(sys.modules)
# Not ru_maxrss: that one begins with the size of the process that started this one.
most = re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())
print("\\n", status, sorted(heavy), int(most[1]) // 1024)
"""


@pytest.mark.slow
def test_daemon_and_monitor_do_not_carry_what_the_simulation_needed():
    done = subprocess.run(
        [sys.executable, "-c", LEAN], capture_output=True, text=True, check=True, timeout=120
    )
    status, heavy, mib = done.stdout.splitlines()[-1].split()
    assert (status, heavy) == ("0", "[]")
    assert int(mib) < 150


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--speed", "0"], "--speed"),
        (["--speed", "2", "--interface", "udp_multicast"], "--speed needs the virtual bus"),
        (["--interface", "nonsense"], "nonsense"),
    ],
)
def test_what_cannot_be_is_reported(arguments, words, capsys):
    assert cli.main(["demo", "--live", "--minutes", "0.1", *arguments]) == 1
    assert words in capsys.readouterr().err
