"""How long received frames have waited for the loop, whatever clock stamps them.

The stamps' clock may be wrong, be set at any time, or be an adapter's own. What is certain is the
loop's clock: a frame came after the bus was last found empty. The first frame since stands for that
moment, and the others count from it by their stamps. So a frame counts as older than it is by no
more than the silence before the first. Where the clock was set forward meanwhile, stamps look too
new; then the wall clock tells, as far as they are of it.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence

from imucald.can.link.link import Frame


class Backlog:
    """Tells which frames are too old to be corrected.

    now: monotonic [s], here and in all methods. max_age: of a frame that is handled [s].
    wall: the clock of the stamps, where they are the system's [s].
    """

    def __init__(self, now: float, max_age: float, wall: Callable[[], float] = time.time) -> None:
        self.max_age = max_age
        self._wall = wall
        self._read_at = self._since = now
        self._is_empty = True
        self._first = math.inf  # stamp of the first frame that came after `_since`

    def read(self, frames: Sequence[Frame], is_empty: bool, now: float) -> bool:
        """Take note of what was read until now; whether any of it can be too old.

        is_empty: nothing is left on the bus.
        """
        if self._is_empty:
            self._since = self._read_at
            self._first = frames[0][0] if frames else math.inf
        elif frames and self._first == math.inf:
            self._first = frames[0][0]
        self._is_empty = is_empty
        self._read_at = now
        return self.may_be_late(now)

    def may_be_late(self, now: float) -> bool:
        """Whether any frame of the last read can be too old by now."""
        return now - self._since > self.max_age

    def is_late(self, stamp: float, now: float) -> bool:
        """Whether a frame of the last read is too old by now."""
        waited = now - self._since
        if waited - (stamp - self._first) > self.max_age:
            return True
        return self.max_age < self._wall() - stamp <= waited
