"""What the driver and the analysis take at 100,000 drives. Run in a process of its own.

python -m benchmarks.fleet.scale FOLDER VEHICLES DRIVES
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.fleet.simulated_fleet import Design, simulated_fleet
from benchmarks.measured import EXAMPLES
from imucald.fleet.driver import FleetRun
from imucald.fleet.fleet_file import load_fleet
from imucald.fleet.lease import Lease
from imucald.fleet.listing import Log
from imucald.fleet.plan import Options, planned
from imucald.fleet.reading import analyse_fleet
from imucald.fleet.store import Store
from imucald.fleet.task import Cost, Outcome, Task

BLOCK = 1000
"""Rows that are simulated at a time: the truth must not count as the driver's memory."""


class Simulated:
    """Workers that answer at once, with simulated rows."""

    slots = 100

    def __init__(self, drives: int) -> None:
        self._vehicles = max(1, BLOCK // drives)
        # one type in a block, always with the same mount: so all blocks fit together
        self._design = Design(types=1, vehicles=self._vehicles, drives=drives, batches=1,
                              bad_batches=0, outliers=self._vehicles // 70)  # fmt: skip
        self._waiting: list[Task] = []
        self._block, self._rows = -1, {}  # type: int, dict[str, Any]

    def submit(self, tasks: Sequence[Task]) -> None:
        """Take tasks."""
        self._waiting += tasks

    def finished(self, timeout: float) -> list[tuple[Task, Outcome | None]]:
        """Give all outcomes."""
        done, self._waiting = self._waiting, []
        return [(task, self._outcome(task)) for task in done]

    def _outcome(self, task: Task) -> Outcome:
        vehicle, drive = task.source.removesuffix(".log").split("/")[-2:]
        number = int(vehicle[1:])
        block, within = divmod(number, self._vehicles)
        if block != self._block:
            columns, _ = simulated_fleet(block, self._design)
            self._rows = {key: list(v) for key, v in columns.items()}
            self._block = block
        i = within * self._design.drives + int(drive)
        row = {key: values[i] for key, values in self._rows.items()}
        for key in ("log_key", "vehicle", "sources", "vehicle_type", "sensor_batch", "firmware",
                    "sensor_serial", "run_key", "date"):  # fmt: skip
            row.pop(key)
        events = [{"t_s": t, "kind": "state", "text": "usable"} for t in (1.0, 2.0, 3.0)]
        return Outcome("ok", log_key=f"{number:08x}{int(drive):08x}", drive=row, events=events,
                       cost=Cost(1.0, 1.0, 60 * 2**20, "worker"))  # fmt: skip

    def call_back(self) -> None:
        """Nothing waits."""

    def close(self) -> None:
        """Nothing is open."""


def main(folder: str, vehicles: int, drives: int) -> None:
    place = Path(folder)
    (place / "fleet.yaml").write_text(
        f"logs: x\nconfig: {EXAMPLES / 'passenger_car.yaml'}\nvehicles: cars.csv\n"
    )
    cars = (f"v{i:05d},type-{i * 5 // vehicles},B{i % 20}" for i in range(vehicles))
    (place / "cars.csv").write_text("\n".join(["vehicle,type,sensor_batch", *cars]))
    fleet, store = load_fleet(place / "fleet.yaml"), Store(str(place / "out"))
    before = _peak()
    logs = [
        Log(f"/logs/v{i:05d}/{d}.log", 10**7, "1") for i in range(vehicles) for d in range(drives)
    ]
    began = time.perf_counter()
    with Lease(store) as lease:
        plan = planned(fleet, store, logs, Options())
        FleetRun(fleet, store, Simulated(drives), plan).go(lease)
    print(
        f"run {time.perf_counter() - began:.1f} s, memory {_peak():.0f} MiB ({before:.0f} at start)"
    )
    began = time.perf_counter()
    with Lease(store):
        done = planned(fleet, store, logs, Options()).done
    print(f"resume {time.perf_counter() - began:.1f} s, {done} known, memory {_peak():.0f} MiB")


def analyse(folder: str) -> None:
    began, cpu = time.perf_counter(), time.process_time()
    tables = analyse_fleet(Store(f"{folder}/out"))
    found = {name.rpartition("/")[2]: len(table) for name, table in tables.items()}
    took = f"{time.perf_counter() - began:.1f} s ({time.process_time() - cpu:.1f} s of processor)"
    print(f"analyse {took}, memory {_peak():.0f} MiB, {found}")


def _peak() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


if __name__ == "__main__":
    if len(sys.argv) == 4:
        main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
    else:
        analyse(sys.argv[1])
