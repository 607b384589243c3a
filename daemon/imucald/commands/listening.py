"""Listen on a bus for some time. `check` and `init` do this without a log."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from imucald.commands.terminal import countdown
from imucald.config_check import columns_of

if TYPE_CHECKING:
    from imucald.can.columns import FrameColumns
    from imucald.can.link.link import Frame, Link

BATCH = 10_000
"""Number of frames that are collected before they are passed on."""


def listen(link: Link, seconds: float, feed: Callable[[FrameColumns], None]) -> None:
    """Pass on the frames that an open link receives in `seconds` [s], then close the link."""
    with link, countdown(f"listening on {link.channel}", seconds) as tick:
        began = time.monotonic()
        waiting: list[Frame] = []
        while (passed := time.monotonic() - began) < seconds:
            waiting += link.receive(min(0.1, seconds - passed))
            if len(waiting) >= BATCH:
                feed(columns_of(waiting, link.channel))
                waiting = []
            tick(passed)
        if waiting:
            feed(columns_of(waiting, link.channel))
