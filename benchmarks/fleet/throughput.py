"""Throughput on real logs: one core against two, and what a log costs beside its replay."""

from __future__ import annotations

import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from benchmarks.measured import EXAMPLES, FOLDER, Run, imucald, made_once, run

DRIVES = 8
MINUTES = 10
POISON = {"cut.mf4": b"MDF     4.10    ", "empty.log": b""}
CONFIG = EXAMPLES / "passenger_car.yaml"
REPLAY = """import sys, imucald
for log in sys.argv[2:]:
    imucald.replay(imucald.Config.load(sys.argv[1]), log, signals=False)
"""


@dataclass(frozen=True)
class Round:
    """One after the other: plain replay of all logs in one process, one worker, two workers.

    load: average over the last minute before each (1, 2 workers): of a machine that does nothing
    else it is the round before this one, up to 2.
    """

    plain: Run
    one: Run
    two: Run
    load: tuple[float, float]

    @property
    def speedup(self) -> float:
        """Wall time of one worker over that of two."""
        return self.one.wall / self.two.wall


@dataclass(frozen=True)
class Throughput:
    """Rounds of a benchmark; medians, so that a burst of something else in one does not count."""

    logs: int
    megabytes: float
    rounds: list[Round]

    @property
    def speedup(self) -> float:
        """Median over the rounds, each of which ran one and two workers within a minute."""
        return median(r.speedup for r in self.rounds)

    @property
    def overhead_cpu_s(self) -> float:
        """Processor time of a log beside its replay, start and tables of the run included."""
        return median((r.two.cpu - r.plain.cpu) / self.logs for r in self.rounds)

    @property
    def overhead_wall_s(self) -> float:
        """Wall time with one worker beside plain replay."""
        return median((r.one.wall - r.plain.wall) / self.logs for r in self.rounds)


def throughput(copies: int, rounds: int) -> Throughput:
    folder = FOLDER / "fleet"
    logs = _logs(folder, copies)
    fleet = folder / "fleet.yaml"
    fleet.write_text(f"logs: 'logs/**/*'\nconfig: {CONFIG}\n")
    good = [str(log) for log in logs if log.name not in POISON]
    plain = [sys.executable, "-c", REPLAY, str(CONFIG), *good]
    found = []
    run(plain)  # compiles modules and warms the file cache
    for k in range(rounds):
        runs: dict[int, Run] = {}
        load: dict[int, float] = {}
        for workers in (1, 2) if k % 2 == 0 else (2, 1):  # who comes second gains nothing
            out = folder / f"out-{workers}"
            shutil.rmtree(out, ignore_errors=True)
            command = imucald(
                "fleet", "run", "--fleet", fleet, "--out", out, "--workers", str(workers), "--quiet"
            )
            load[workers] = os.getloadavg()[0]
            # status 3: the two poison logs are told
            runs[workers] = run(["sh", "-c", '"$@"; test $? -eq 3', "sh", *command])
        found.append(Round(run(plain), runs[1], runs[2], (load[1], load[2])))
    megabytes = sum(log.stat().st_size for log in logs) / 1e6
    return Throughput(len(logs), megabytes, found)


def _logs(folder: Path, copies: int) -> list[Path]:
    """Some drives, several times with some frames fewer at the end, and two poison logs."""
    shutil.rmtree(folder / "logs", ignore_errors=True)
    found = []
    for k in range(DRIVES):
        arguments = ("--minutes", str(MINUTES), "--seed", str(100 + k))
        log = made_once(
            f"fleet-{k}.log",
            str(arguments),
            lambda path, a=arguments: run(imucald("simulate", "--out", path, *a)),
        )
        lines = log.read_bytes().splitlines(keepends=True)
        for c in range(copies):
            place = folder / "logs" / f"car-{k}" / f"{c}.log"
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(b"".join(lines[: len(lines) - c]))
            found.append(place)
    for name, content in POISON.items():
        place = folder / "logs" / "car-0" / name
        place.write_bytes(content)
        found.append(place)
    return found
