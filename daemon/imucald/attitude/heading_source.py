"""Decide whether a heading source may be used, by comparison with the gyroscope.

A heading whose difference from the gyroscope exceeds the gate is not used, because the gyroscope's
heading has a smaller error. The module cannot decide whether the source or the gyroscope is wrong.
If the difference lasts for `LOST_AFTER`, the source counts as lost. The deviation of the heading is
then increased by the largest difference since the loss, the *doubt*. A source proves itself if it
agrees with the gyroscope, up to a constant, for a minute and over a turn. The turn must be so large
that a frozen, mirrored or wrongly scaled source could not have agreed. A proved source is used
again in two cases: it shows the same north as before, or the earlier north was not proved. If two
different norths were both proved, one of them is wrong. The wrong north is not known, so the doubt
stays. The module does no I/O and reads no clock.
"""

from __future__ import annotations

import enum
import math

from imucald.attitude.right_forward_up import wrapped

LOST_AFTER = 5.0
"""Duration of a difference after which the source counts as lost [s]. Outliers are shorter: a
reflected satellite signal, a steel bridge."""
AGREES_FOR = 60.0
"""Shortest time in which a source proves itself [s]."""
TURNED = math.pi / 2.0
"""Smallest turn over which a source proves itself [rad].

The turn must also be twice the possible difference between source and gyroscope.
"""
LONGEST_STEP = 10.0
"""Silence of the source after which its proof begins again [s]."""


class Verdict(enum.Enum):
    """Decision about the use of a heading."""

    FOLLOWED = enum.auto()
    REFUSED = enum.auto()
    BEGUN_AGAIN = enum.auto()
    """The source has proved itself, and the earlier north was not proved: the heading begins again
    from this source.
    """


class HeadingSource:
    """Processes the differences between a source's headings and the gyroscope's heading, in order
    of time."""

    def __init__(self, gate: float) -> None:
        self._gate = gate
        self._proved = self._is_undecided = False
        self.doubt = 0.0
        """Largest difference since the source was lost [rad]; 0 while the source may be used."""
        self.restart()

    def restart(self) -> None:
        """Restart, because the gyroscope's heading begins again. The source must then prove itself
        again, and a doubt stays.
        """
        self._is_undecided |= self.doubt > 0.0 and self._proved
        self._proved = False
        self._beyond_since: float | None = None
        self._begin = self._t = -math.inf
        self._anchor = self._heading = self._turn = self._least = self._most = 0.0
        self._anchor_variance = 0.0

    def judge_heading(
        self,
        t: float,
        difference: float,
        variance: float,
        noise: float,
        heading: float,
        is_bend: bool = False,
    ) -> Verdict:
        """Decide about a heading of stream time t [s].

        difference: source minus gyroscope [rad]. variance: variance of the gyroscope's heading
        [rad^2]. noise: variance of the source [rad^2]. heading: heading of the gyroscope [rad].
        is_bend: the vehicle turns so fast that the delay of the heading causes a larger error than
        the noise of the source. In a bend, a heading can contradict the gyroscope, but it is
        neither a proof nor used.
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
        """Return whether the source has turned as the gyroscope has, for long enough and over a
        large enough turn."""
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
