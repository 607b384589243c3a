"""Listen on a bus for some time. `check` and `init` do this without a log."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from imucald.can.logs.frame_batches import columns_of_frames
from imucald.commands.terminal import countdown

if TYPE_CHECKING:
    from imucald.can.columns import FrameColumns
    from imucald.can.link.link import Frame, Link


def listen(link: Link, seconds: float, feed: Callable[[FrameColumns], None]) -> None:
    """Pass on the frames that an open link receives in `seconds` [s], then close the link."""
    with link, countdown(f"listening on {link.channel}", seconds) as tick:
        began = time.monotonic()
        waiting: list[Frame] = []

        def pass_on() -> None:
            frames = [(t, can_id, data, 0, False) for t, can_id, data in waiting]
            feed(columns_of_frames(frames, (link.channel,)))
            waiting.clear()

        while (passed := time.monotonic() - began) < seconds:
            waiting += link.receive(min(0.1, seconds - passed))
            if len(waiting) >= 10_000:
                pass_on()
            tick(passed)
        if waiting:
            pass_on()
