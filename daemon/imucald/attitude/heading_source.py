"""Whether a source of heading may be followed: the gyroscope is held against it.

A difference beyond the gate is not followed: the gyroscope's heading is not wrong by so much.
Which of the two is wrong is not known, so from `LOST_AFTER` on the source counts as lost, and
the heading is doubted by as much as the two have differed since. A source has proved itself when,
but for a constant, it has agreed with the gyroscope for a minute and over a turn that it could
not have followed frozen, mirrored or at another scale. Then it is taken up again: where it is back
at the north from before, or had not proved that one. Of two norths that were both proved one is
wrong, and nothing shows which: the doubt stays. Pure.
"""

from __future__ import annotations

import enum
import math

from imucald.attitude.right_forward_up import wrapped

LOST_AFTER = 5.0
"""Outliers last less than this [s]: a reflected satellite signal, a steel bridge."""
AGREES_FOR = 60.0
"""A source proves itself in no less than this [s] ..."""
TURNED = math.pi / 2.0
"""... and over a turn of at least this, and of twice what the two may differ by meanwhile [rad]."""
LONGEST_STEP = 10.0
"""After a longer silence the source has to begin its proof again [s]."""


class Verdict(enum.Enum):
    """What is to be done with a heading."""

    FOLLOWED = enum.auto()
    REFUSED = enum.auto()
    BEGUN_AGAIN = enum.auto()
    """It has proved itself, and what was followed before had not: heading begins from it."""


class HeadingSource:
    """Takes the differences of a source's headings from the gyroscope's, in order of time."""

    def __init__(self, gate: float) -> None:
        self._gate = gate
        self._proved = self._is_undecided = False
        self.doubt = 0.0
        """Largest difference since the source was lost [rad]; 0 while it may be followed."""
        self.restart()

    def restart(self) -> None:
        """The gyroscope's heading begins again: nothing is proved, and what is doubted stays so."""
        self._is_undecided |= self.doubt > 0.0 and self._proved
        self._proved = False
        self._beyond_since: float | None = None
        self._begin = self._t = -math.inf
        self._anchor = self._heading = self._turn = self._least = self._most = 0.0
        self._anchor_variance = 0.0

    def take(
        self,
        t: float,
        difference: float,
        variance: float,
        noise: float,
        heading: float,
        is_bend: bool = False,
    ) -> Verdict:
        """Judge a heading of stream time t [s].

        difference: of the source from the gyroscope [rad]; variance: of the gyroscope's heading;
        noise: of the source [rad^2]; heading: the gyroscope's [rad]. is_bend: the vehicle turns so
        fast that a late heading is off by more than the source's own noise. It can contradict
        there; it proves nothing, and is not followed.
        """
        if t - self._t > LONGEST_STEP:
            self._beyond_since = None
        proves = self._proves(t, difference, variance, noise, heading)
        is_beyond = difference * difference > self._gate**2 * (variance + noise)
        if not is_beyond:
            self._beyond_since = None
        if is_bend and not is_beyond:
            return Verdict.REFUSED
        proves = proves and not is_bend
        if not self.doubt:
            if not is_beyond:
                self._proved |= proves
                return Verdict.FOLLOWED
            if self._beyond_since is None:
                self._beyond_since = t
            if t - self._beyond_since >= LOST_AFTER:
                self.doubt = abs(difference)
                self._t = -math.inf  # it has to prove itself from here on
            return Verdict.REFUSED
        self.doubt = max(self.doubt, abs(difference))
        if not proves or self._is_undecided or (is_beyond and self._proved):
            return Verdict.REFUSED
        self.doubt, self._beyond_since, self._proved = 0.0, None, True
        return Verdict.BEGUN_AGAIN if is_beyond else Verdict.FOLLOWED

    def _proves(
        self, t: float, difference: float, variance: float, noise: float, heading: float
    ) -> bool:
        """Whether the source has turned as the gyroscope did, long and far enough."""
        grown = max(variance - self._anchor_variance, 0.0)
        limit = self._gate * math.sqrt(2.0 * noise + grown)
        is_near = abs(wrapped(difference - self._anchor)) < limit
        if not is_near or t - self._t > LONGEST_STEP:
            self._begin, self._anchor, self._anchor_variance = t, difference, variance
            self._turn = self._least = self._most = 0.0
        else:
            self._turn += wrapped(heading - self._heading)
            self._least, self._most = min(self._least, self._turn), max(self._most, self._turn)
        self._t, self._heading = t, heading
        turned = self._most - self._least
        return t - self._begin >= AGREES_FOR and turned >= max(TURNED, 2.0 * limit)
