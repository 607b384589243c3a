"""The pause before a start, as it stands in the unit: in a clock of its own, without systemd."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest

import shuttle
from imucald import cli
from imucald.can.link.link import Frame
from imucald.service.notify import StartCount, start_count_file
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service
from paths import ROOT

UNIT = ROOT / "systemd" / "imucald@.service"
SLEEP = '#!/bin/sh\necho $(( $(cat "$CLOCK") + $1 )) > "$CLOCK"\n'


class Starts:
    """Runs the unit's command line with a clock that only sleeping and `live` move [s]."""

    def __init__(self, folder: Path) -> None:
        line = re.search(r"^ExecStart=/bin/sh -c '(.*?)' imucald ", UNIT.read_text(), re.M | re.S)
        assert line is not None
        # as systemd.service(5) joins and unescapes a line
        self._line = line[1].replace("\\\n", " ").replace("$$", "$")
        self.boot = "9f6d2c1b8a7e4f5093d2b1a0c8e7f6d5"
        self.clock, self.file = folder / "clock", folder / "starts"
        programs = folder / "bin"  # nothing else is found: the shell starts nothing but a pause
        programs.mkdir()
        (programs / "sleep").write_text(SLEEP.replace("cat", shutil.which("cat") or "cat"))
        (programs / "sleep").chmod(0o755)
        self.environment = {
            "PATH": str(programs),
            "CLOCK": str(self.clock),
            "CACHE_DIRECTORY": str(folder),
            "INVOCATION_ID": "1",
        }
        self.clock.write_text("0")

    @property
    def script(self) -> str:
        """What systemd hands to the shell, on this boot."""
        return self._line.replace("%b", self.boot).replace("%%", "%")

    def live(self, seconds: int) -> None:
        """The daemon lives for so long, and does with the count what it does."""
        self.clock.write_text(str(int(self.clock.read_text()) + seconds))
        count = StartCount(start_count_file(self.environment))
        for uptime in range(seconds + 1):
            count.update(uptime)

    def start(self) -> int:
        """Start once; return when [s]."""
        true = shutil.which("true")
        assert true is not None
        subprocess.run(
            ["/bin/sh", "-c", self.script, "imucald", true], env=self.environment, check=True
        )
        return int(self.clock.read_text())


@pytest.fixture
def starts(tmp_path: Path) -> Starts:
    return Starts(tmp_path)


def counted(starts: Starts) -> int:
    """The count that the next start goes on with."""
    return int(starts.file.read_text().split()[0])


def is_counted(count: Path) -> bool:
    """Whether the next start would go on with what is there."""
    return count.read_text().split()[0].isdecimal()


def most_in_a_minute(times: list[int]) -> int:
    return max(sum(t <= other < t + 60 for other in times) for t in times)


@pytest.mark.parametrize("lives", [0, 1, 3, 10, 20])
def test_whatever_the_loop_there_are_ten_starts_a_minute_at_most(starts, lives):
    times = []
    for _ in range(25):
        times.append(starts.start())
        starts.live(lives)
    assert most_in_a_minute(times) <= 10
    assert times[-1] - times[-2] <= 30 + lives, "it is tried for ever"


def test_the_first_restarts_are_at_once_and_again_after_a_minute_of_life(starts):
    for _ in range(3):
        times = [starts.start() for _ in range(5)]
        assert times[-1] == times[0]
        starts.live(60)


@pytest.mark.parametrize("disk", ["read-only", "full"])
def test_where_the_count_cannot_be_written_there_are_ten_starts_a_minute_too(
    starts, tmp_path, disk
):
    if disk == "full":
        starts.file.symlink_to("/proc/version")  # can be read, and takes nothing
    else:
        starts.environment["CACHE_DIRECTORY"] = str(tmp_path / "not_there")
    times = [starts.start() for _ in range(25)]
    assert most_in_a_minute(times) <= 10
    assert times[-1] - times[-2] <= 30, "it is tried for ever"


def test_a_count_that_is_there_goes_on_when_the_disk_is_full(starts):
    starts.start()
    starts.live(60)
    block = starts.file.stat().st_ino
    for expected in range(3):
        starts.start()
        assert counted(starts) == expected
        assert starts.file.stat().st_ino == block
        assert starts.file.stat().st_size > 0


@pytest.mark.parametrize(
    "content", ["", "x y\n", "3\n", "9 9\n", "-1\n", "08\n", "11\n", "7\n7\n", "1e3 $(reboot)\n"]
)
def test_a_damaged_count_stops_no_start(starts, content):
    for text in (content, content.replace("\n", f" {starts.boot}\n")):
        starts.file.write_text(text)
        starts.start()
        assert 0 <= counted(starts) <= 10


def test_only_a_daemon_that_has_lived_for_a_minute_ends_the_count(starts):
    starts.start()
    starts.live(59)
    assert is_counted(starts.file)
    starts.live(60)
    assert not is_counted(starts.file)


def test_an_orderly_end_and_a_wrong_configuration_end_the_count(tmp_path, monkeypatch):
    monkeypatch.setenv("CACHE_DIRECTORY", str(tmp_path))
    monkeypatch.setenv("INVOCATION_ID", "1")
    config = shuttle.write(tmp_path, cycles=1)
    run = ["run", "--config", str(config), "--interface", "virtual", "--seconds", "0.01"]
    for expected in (0, 78):
        (tmp_path / "starts").write_text("3\n")
        assert cli.main(run) == expected
        assert not is_counted(tmp_path / "starts")
        config.write_text(config.read_text() + "nonsense: 1\n")


def test_a_stop_during_the_pause_ends_the_count(starts):
    starts.file.write_text(f"9 {starts.boot}\n")
    environment = {**starts.environment, "PATH": os.environ["PATH"]}
    command = ["/bin/sh", "-c", starts.script, "imucald", "true"]
    shell = subprocess.Popen(command, env=environment, start_new_session=True)
    time.sleep(0.5)
    assert starts.file.read_text() == f"10 {starts.boot}\n"
    os.killpg(shell.pid, signal.SIGTERM)
    assert shell.wait(5.0) == 143
    assert not is_counted(starts.file)


def test_a_count_of_before_the_boot_counts_for_nothing(starts):
    for _ in range(5):
        starts.start()
    assert counted(starts) == 4
    starts.boot = starts.boot[::-1]
    starts.start()
    assert counted(starts) == 0
    starts.start()
    assert counted(starts) == 1


@pytest.mark.parametrize("since", [-7200.0, 7200.0])
def test_a_clock_that_is_set_ends_no_count_and_keeps_none(starts, tmp_path, since):
    """The file is older than this boot, or younger than now: neither says of which boot it is."""
    times = []
    for _ in range(25):
        times.append(starts.start())
        os.utime(starts.file, (time.time() + since,) * 2)
    assert most_in_a_minute(times) <= 10
    starts.boot = starts.boot[::-1]
    assert starts.start() == times[-1]


def test_without_a_unit_there_is_no_count(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "starts").touch()
    StartCount(start_count_file({})).update(100.0)
    assert (tmp_path / "starts").exists()


@pytest.mark.parametrize(("seconds", "is_kept"), [(50, True), (70, False)])
def test_the_service_ends_the_count_while_it_runs(tmp_path, seconds, is_kept):
    count = tmp_path / "starts"
    count.write_text("3\n")
    now = [100.0]
    options = ServiceOptions(
        shuttle.write(tmp_path, cycles=1),
        interface="virtual",
        channel="count",
        start_count=start_count_file({"CACHE_DIRECTORY": str(tmp_path), "INVOCATION_ID": "1"}),
    )
    service = Service(options, clock=lambda: now[0])

    def a_silent_second(_: float) -> list[Frame]:
        now[0] += 1.0
        return []

    service.link.receive = a_silent_second
    service.run(seconds)
    service.close()
    assert is_counted(count) == is_kept
