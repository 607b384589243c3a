"""Throughput on real logs: one core against two, and what a log costs beside its replay."""

from __future__ import annotations

import shutil
import sys
from dataclasses import dataclass
from pathlib import Path

from benchmarks.measured import EXAMPLES, FOLDER, Run, best, imucald, made_once, run

DRIVES = 8
MINUTES = 10
POISON = {"cut.mf4": b"MDF     4.10    ", "empty.log": b""}
CONFIG = EXAMPLES / "passenger_car.yaml"
REPLAY = """import sys, imucald
for log in sys.argv[2:]:
    imucald.replay(imucald.Config.load(sys.argv[1]), log, signals=False)
"""


@dataclass(frozen=True)
class Throughput:
    """Best of the rounds; `plain` is one process that replays all logs one after the other."""

    logs: int
    megabytes: float
    plain: Run
    one: Run
    two: Run

    @property
    def speedup(self) -> float:
        """Wall time of one worker over that of two."""
        return self.one.wall / self.two.wall

    @property
    def overhead_cpu_s(self) -> float:
        """Processor time of a log beside its replay, start and tables of the run included."""
        return (self.two.cpu - self.plain.cpu) / self.logs

    @property
    def overhead_wall_s(self) -> float:
        """Wall time with one worker beside plain replay."""
        return (self.one.wall - self.plain.wall) / self.logs


def throughput(copies: int, rounds: int) -> Throughput:
    folder = FOLDER / "fleet"
    logs = _logs(folder, copies)
    fleet = folder / "fleet.yaml"
    fleet.write_text(f"logs: 'logs/**/*'\nconfig: {CONFIG}\n")
    runs: dict[str, list[Run]] = {"plain": [], "1": [], "2": []}
    for _ in range(rounds):
        good = [str(log) for log in logs if log.name not in POISON]
        runs["plain"].append(run([sys.executable, "-c", REPLAY, str(CONFIG), *good]))
        for workers in ("1", "2"):
            out = folder / f"out-{workers}"
            shutil.rmtree(out, ignore_errors=True)
            command = imucald(
                "fleet", "run", "--fleet", fleet, "--out", out, "--workers", workers, "--quiet"
            )
            # status 3: the two poison logs are told
            runs[workers].append(run(["sh", "-c", '"$@"; test $? -eq 3', "sh", *command]))
    megabytes = sum(log.stat().st_size for log in logs) / 1e6
    return Throughput(len(logs), megabytes, *(best(runs[k]) for k in ("plain", "1", "2")))


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
