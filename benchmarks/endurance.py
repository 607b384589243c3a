"""Hours of driving through the live path at speed: memory, threads, open files, state saved.

    python -m benchmarks.endurance [--hours 8]

A simulated drive is repeated end to end with growing stamps; every frame of ours goes through the
service one by one, as from a bus, with its chores on the drive's clock. Growth is counted from the
end of the first half hour.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imucald.can.columns import FrameColumns, concatenate
from imucald.runtime.session import make_engine, open_config
from imucald.service.parts import ServiceOptions
from imucald.service.running_status import process_figures
from imucald.service.service import Service
from imucald.simulation import random_model, simulate
from imucald.traffic.can_log import bus_frames
from imucald.traffic.drive_encoder import BusEncoder

CONFIG = Path(__file__).parent.parent / "config" / "examples" / "passenger_car.yaml"
EPOCH = 1.6e9
MINUTES = 8.0
"""Of the drive that is repeated."""
WARM_UP_S = 1800.0
GROWTH_LIMIT = 1.0
"""MiB per hour."""


@dataclass
class Figures:
    """At one moment: stream time [s], resident memory [MiB], threads, open files."""

    t: float
    rss: float
    threads: int
    files: int


def our_frames(minutes: float = MINUTES) -> FrameColumns:
    """The frames of one drive that the daemon's filter lets through."""
    loaded = open_config(CONFIG)
    drive = simulate(random_model(3, standing_first=True), 3, minutes)
    frames = concatenate(list(bus_frames(drive, BusEncoder(loaded))))
    wanted = np.zeros(len(frames), bool)
    for match in make_engine(loaded).router.matches:
        wanted |= (frames.can_id & match.full_mask) == (match.can_id & match.full_mask)
    return frames.take(np.flatnonzero(wanted))


def drive_for(hours: float, frames: FrameColumns, folder: Path) -> Iterator[Figures]:
    """Run the service; figures every five minutes of driving."""
    now = [0.0]
    options = ServiceOptions(
        CONFIG, interface="virtual", channel="endurance", state_folder=folder / "state"
    )
    service = Service(options, clock=lambda: now[0])
    rows = list(
        zip(
            frames.t.tolist(),
            frames.can_id.tolist(),
            [d[:n].tobytes() for d, n in zip(frames.data, frames.length, strict=True)],
            strict=True,
        )
    )
    send, start, next_chore, next_look = service.link.send, 0.0, 0.0, 0.0
    while start < 3600.0 * hours:
        handle = service.engine.frame
        for t, can_id, data in rows:
            for out_id, out in handle(EPOCH + start + t, can_id, data):
                send(out_id, out)
            if start + t >= next_chore:
                now[0] = next_chore = start + t + 0.1
                service._chores(now[0])
                if now[0] >= next_look:
                    next_look += 300.0
                    found = process_figures()
                    rss = (found["rss_bytes"] or 0) / 2**20
                    yield Figures(now[0], rss, found["threads"], found["open_files"] or 0)
        start += rows[-1][0] + 0.01
    service.close()


def growth(figures: list[Figures], warm_up: float = WARM_UP_S) -> float:
    """Slope of the memory after the warm-up, by least squares [MiB/h]."""
    late = [f for f in figures if f.t >= warm_up]
    return float(np.polyfit([f.t / 3600.0 for f in late], [f.rss for f in late], 1)[0])


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--hours", type=float, default=8.0)
    hours = parser.parse_args().hours
    began = time.monotonic()
    figures = []
    with tempfile.TemporaryDirectory() as folder:
        for figure in drive_for(hours, our_frames(), Path(folder)):
            figures.append(figure)
            if len(figures) % 6 == 1:
                text = f"{figure.t / 3600:5.2f} h  {figure.rss:7.2f} MiB"
                print(f"{text}  {figure.threads} threads  {figure.files} files", flush=True)
    slope = growth(figures)
    late = [f for f in figures if f.t >= WARM_UP_S]
    # a file more while the state is being saved
    steady = late[-1].threads <= late[0].threads and late[-1].files <= late[0].files + 1
    print(f"{hours:g} h in {time.monotonic() - began:.0f} s: {slope:+.3f} MiB/h, limit +1")
    print(f"threads and open files steady: {steady}")
    return 0 if slope < GROWTH_LIMIT and steady else 1


if __name__ == "__main__":
    sys.exit(main())
