"""The pause before a start, as it stands in the unit: in a clock of its own, without systemd."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from paths import ROOT

UNIT = ROOT / "systemd" / "imucald@.service"
DATE = '#!/bin/sh\ncat "$CLOCK"\n'
SLEEP = '#!/bin/sh\necho $(( $(cat "$CLOCK") + $1 )) > "$CLOCK"\n'


class Starts:
    """Runs the unit's command line with a clock that only sleeping and `run_for` move [s]."""

    def __init__(self, folder: Path) -> None:
        line = re.search(r"^ExecStart=/bin/sh -c '(.*?)' imucald ", UNIT.read_text(), re.M | re.S)
        assert line is not None
        # as systemd.service(5) joins and unescapes a line
        self.script = line[1].replace("\\\n", " ").replace("$$", "$").replace("%%", "%")
        self.clock, self.file = folder / "clock", folder / "starts"
        programs = folder / "bin"
        programs.mkdir()
        for name, text in (("date", DATE), ("sleep", SLEEP)):
            (programs / name).write_text(text)
            (programs / name).chmod(0o755)
        self.environment = {
            "PATH": f"{programs}:{os.environ['PATH']}",
            "CLOCK": str(self.clock),
            "RUNTIME_DIRECTORY": str(folder),
        }
        self.run_for(1_600_000_000)

    def run_for(self, seconds: int) -> None:
        now = int(self.clock.read_text()) if self.clock.exists() else 0
        self.clock.write_text(str(now + seconds))

    def start(self) -> int:
        """Start once; return when [s]."""
        subprocess.run(
            ["/bin/sh", "-c", self.script, "imucald", "true"], env=self.environment, check=True
        )
        return int(self.clock.read_text())


@pytest.fixture
def starts(tmp_path: Path) -> Starts:
    return Starts(tmp_path)


def most_in_a_minute(times: list[int]) -> int:
    return max(sum(t <= other < t + 60 for other in times) for t in times)


@pytest.mark.parametrize("lives", [0, 1, 3, 10, 20])
def test_whatever_the_loop_there_are_ten_starts_a_minute_at_most(starts, lives):
    times = []
    for _ in range(25):
        times.append(starts.start())
        starts.run_for(lives)
    assert most_in_a_minute(times) <= 10
    assert times[-1] - times[-2] <= 30 + lives, "it is tried for ever"


def test_the_first_restarts_are_at_once_and_again_after_a_minute_of_life(starts):
    for _ in range(3):
        times = [starts.start() for _ in range(5)]
        assert times[-1] == times[0]
        starts.run_for(61)


@pytest.mark.parametrize(
    "content", ["", "x y\n", "3\n", "9 9 9\n", "-1 -1\n", "08 09\n", "7\n7\n", "1e3 $(reboot)\n"]
)
def test_a_damaged_count_stops_no_start(starts, content):
    starts.file.write_text(content)
    starts.start()
    number, last = map(int, starts.file.read_text().split())
    assert 0 <= number <= 10
    assert last == int(starts.clock.read_text())


def test_a_clock_that_is_set_back_does_not_let_a_loop_run(starts):
    times = []
    for i in range(20):
        before = int(starts.clock.read_text())
        times.append(starts.start() - before)
        if i == 8:
            starts.run_for(-3600)
    assert times[:5] == [0] * 5
    assert times[-5:] == [30] * 5
