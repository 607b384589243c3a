"""Make the frames of a drive in the order on the bus: as columns, one by one, as a candump log, or
sent to a bus in real time (or faster)."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from imucald.can.columns import FrameColumns
from imucald.can.logs.candump_writer import CandumpWriter
from imucald.simulation.drive import Drive
from imucald.traffic.drive_encoder import BusEncoder
from imucald.traffic.other_units import arbitrated, background, joined

if TYPE_CHECKING:
    from imucald.can.link.link import Link

EPOCH_S = 1_600_000_000.0
"""Default time stamp of the start of a drive [UNIX s]."""
BLOCK_S = 30.0
"""Length of a block of frames [s]. Because of the blocks, background traffic does not increase the
memory."""

Progress = Callable[[float], None]
"""Callback for progress. Argument: time in the drive up to which frames are written [s]."""


def bus_frames(
    drive: Drive, encoder: BusEncoder, with_background: bool = False
) -> Iterator[FrameColumns]:
    """Yield the frames of a drive in bus order, block by block; t is in seconds since its start.

    Each channel of the recording is a separate bus. The traffic of other control units is on the
    first channel.
    """
    ours = joined(list(encoder.frames(drive)))
    ours = ours.take(np.argsort(ours.t, kind="stable"))
    rate = drive.model.bus.background_frames_per_s if with_background else 0.0
    busy_until = [0.0] * len(ours.channels)
    edges = np.arange(0.0, drive.duration_s + 2.0 * BLOCK_S, BLOCK_S)
    for start, stop in itertools.pairwise(edges.tolist()):
        first, last = np.searchsorted(ours.t, [start, stop])
        block = ours.take(slice(int(first), int(last)))
        if rate > 0.0:
            others = background(drive.seed, rate, encoder.ids, start, min(stop, drive.duration_s))
            block = joined([block, _on_channel(others, ours.channels)])
        parts = []
        for index, free in enumerate(busy_until):
            part = block.take(block.channel == index)
            if len(part):
                parts.append(arbitrated(part, drive.model.bus.bitrate, free))
                busy_until[index] = float(parts[-1].t[-1])
        if parts:
            merged = parts[0] if len(parts) == 1 else joined(parts)
            yield merged.take(np.argsort(merged.t, kind="stable"))


def live_frames(
    drive: Drive, encoder: BusEncoder, with_background: bool = False
) -> Iterator[tuple[float, int, bytes]]:
    """Yield single frames: (seconds since the drive's start, id with 29-bit flag, payload)."""
    for block in bus_frames(drive, encoder, with_background):
        yield from block.rows()


def write_log(
    drive: Drive,
    path: Path,
    encoder: BusEncoder,
    with_background: bool = False,
    progress: Progress | None = None,
    start_s: float = EPOCH_S,
) -> int:
    """Write a drive as a candump log. Return the number of frames. Raises LogError if the log
    cannot be written.

    start_s: time stamp of the start [UNIX s].
    """
    with CandumpWriter(path) as writer:
        for block in bus_frames(drive, encoder, with_background):
            writer.write_columns(replace(block, t=block.t + start_s))
            if progress is not None:
                progress(float(block.t[-1]))
    return writer.frames_written


def _on_channel(frames: FrameColumns, channels: tuple[str, ...]) -> FrameColumns:
    return FrameColumns(
        frames.t, frames.can_id, frames.length, frames.data, frames.channel, channels[:1], frames.fd
    )


def play(
    drive: Drive,
    encoder: BusEncoder,
    link: Link,
    speed: float = 1.0,
    with_background: bool = False,
    progress: Progress | None = None,
) -> int:
    """Send the frames of a drive at their times, `speed` times as fast. Return the number of
    accepted frames.

    speed: 1 means real time. A frame that the bus does not accept is lost, as on a real bus.
    """
    began = time.monotonic()
    accepted, reported = 0, 0.0
    for t, can_id, data in live_frames(drive, encoder, with_background):
        wait = began + t / speed - time.monotonic()
        while wait > 0.0005:  # shorter sleeps are not reliable
            link.receive(wait)
            wait = began + t / speed - time.monotonic()
        accepted += link.send(can_id, data)
        if progress is not None and t - reported > 0.5:
            progress(t)
            reported = t
    link.receive(0.0)
    return accepted
