"""How fast candump text is read and written, beside python-can's reader on the same file.

    python benchmarks/log_reading.py [--frames 1000000] [--peer-frames 100000]

The log is a vehicle's: 2,700 frames/s of 60 ids, of which nine (15 %) are wanted. python-can reads
a shorter part of it, since its time per frame does not depend on the length. Times are processor
time, best of several runs, so that a busy machine tells much the same as an idle one.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from imucald.can.columns import concatenate
from imucald.can.logs.log_reader import CandumpWriter, FrameColumns, IdMatch, LogReader
from imucald.can.python_can import can

RATE = 2700.0
"""Frames per second of a vehicle bus [1/s]."""

IDS, OURS = 60, 9
RUNS = 5


def vehicle_log(frames: int) -> tuple[FrameColumns, list[IdMatch]]:
    rng = np.random.default_rng(1)
    ids = rng.choice(0x7FF, IDS, replace=False).astype(np.uint32)
    lengths = rng.choice([8, 8, 8, 8, 8, 8, 7, 6, 4, 2], IDS).astype(np.uint8)
    which = rng.integers(0, IDS, frames)
    length = lengths[which]
    data = rng.integers(0, 256, (frames, 8), dtype=np.uint8)
    data *= np.arange(8) < length[:, None]
    t = np.rint((1.6e9 + np.arange(frames) / RATE) * 1e6) / 1e6
    channel = np.zeros(frames, np.uint8)
    keep = [IdMatch(int(can_id), 0x7FF) for can_id in ids[:OURS]]
    return FrameColumns(t, ids[which], length, data, channel, ("can0",)), keep


def best_time(action: Callable[[], int], runs: int = RUNS) -> float:
    """Return seconds per frame of the fastest run; `action` returns its number of frames."""
    times = []
    for _ in range(runs):
        start = time.process_time()
        frames = action()
        times.append((time.process_time() - start) / frames)
    return min(times)


def read(path: Path, keep: list[IdMatch] | None) -> int:
    reader = LogReader([path], keep, strict=True)
    for _ in reader:
        pass
    return reader.frames_read


def write(path: Path, frames: FrameColumns) -> int:
    with CandumpWriter(path) as writer:
        writer.write_columns(frames)
    return writer.frames_written


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--peer-frames", type=int, default=100_000)
    options = parser.parse_args()
    frames, keep = vehicle_log(options.frames)
    with tempfile.TemporaryDirectory() as folder:
        log, packed, short = (Path(folder) / name for name in ("a.log", "a.log.gz", "b.log"))
        write(log, frames)
        write(packed, frames)
        write(short, frames.take(slice(0, options.peer_frames)))
        if not np.array_equal(concatenate(list(LogReader([log]))).data, frames.data):
            sys.exit("what was written is not what is read")
        ours = {
            "read, 15 % wanted": best_time(lambda: read(log, keep)),
            "read, all wanted": best_time(lambda: read(log, None)),
            "read gzip, 15 % wanted": best_time(lambda: read(packed, keep)),
            "write": best_time(lambda: write(log, frames.take(slice(0, 150_000)))),
        }
        peer_read = best_time(lambda: sum(1 for _ in can.CanutilsLogReader(short)), 2)
        messages = list(can.CanutilsLogReader(short))

        def peer_writes() -> int:
            with can.CanutilsLogWriter(short) as writer:
                for message in messages:
                    writer.on_message_received(message)
            return len(messages)

        peer_write = best_time(peer_writes, 2)
    print(f"{'':24}{'us/frame':>10}{'M frames/s':>12}{'python-can':>12}{'ratio':>8}")
    for name, seconds in ours.items():
        peer = peer_write if name == "write" else peer_read
        print(
            f"{name:24}{seconds * 1e6:10.3f}{1e-6 / seconds:12.1f}"
            f"{peer * 1e6:12.2f}{peer / seconds:8.0f}"
        )


if __name__ == "__main__":
    main()
