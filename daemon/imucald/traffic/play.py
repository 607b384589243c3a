"""A drive in real time (or faster) onto a bus."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from imucald.simulation.drive import Drive
from imucald.traffic.can_log import Progress, live_frames
from imucald.traffic.drive_encoder import BusEncoder

EARLY_S = 0.0005
"""Frames due within this are sent at once: sleeping shorter than that is not dependable."""
PROGRESS_S = 0.5


class FrameSink(Protocol):
    """What `play` needs of a `can.link.link.Link`."""

    def send(self, can_id: int, data: bytes) -> bool:
        """Send one frame; whether it was accepted."""

    def receive(self, timeout: float) -> object:
        """Wait; the link keeps itself alive in the meantime."""


def play(
    drive: Drive,
    encoder: BusEncoder,
    link: FrameSink,
    speed: float = 1.0,
    with_background: bool = False,
    progress: Progress | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Send a drive's frames at their times, `speed` times as fast; return how many were accepted.

    speed: 1 is real time. A frame that the bus does not take is lost, as on a real one.
    """
    began = clock()
    accepted, reported = 0, 0.0
    for t, can_id, data in live_frames(drive, encoder, with_background):
        wait = began + t / speed - clock()
        while wait > EARLY_S:
            link.receive(wait)
            wait = began + t / speed - clock()
        accepted += link.send(can_id, data)
        if progress is not None and t - reported > PROGRESS_S:
            progress(t)
            reported = t
    link.receive(0.0)
    return accepted
