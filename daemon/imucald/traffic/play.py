"""Send a drive to a bus in real time (or faster)."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

from imucald.simulation.drive import Drive
from imucald.traffic.can_log import Progress, live_frames
from imucald.traffic.drive_encoder import BusEncoder

EARLY_S = 0.0005
"""Frames due within this time are sent at once [s], because shorter sleeps are not reliable."""
PROGRESS_S = 0.5


class FrameSink(Protocol):
    """The methods of a `can.link.link.Link` that `play` needs."""

    def send(self, can_id: int, data: bytes) -> bool:
        """Send one frame. Return whether it was accepted."""

    def receive(self, timeout: float) -> object:
        """Wait for `timeout` [s]. During this time, the link maintains its connection."""


def play(
    drive: Drive,
    encoder: BusEncoder,
    link: FrameSink,
    speed: float = 1.0,
    with_background: bool = False,
    progress: Progress | None = None,
    clock: Callable[[], float] = time.monotonic,
) -> int:
    """Send the frames of a drive at their times, `speed` times as fast. Return the number of
    accepted frames.

    speed: 1 means real time. A frame that the bus does not accept is lost, as on a real bus.
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
