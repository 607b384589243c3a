"""Travel direction of a carried terminal: its samples in, one direction per step out.

The module does no I/O and reads no clock. The published method needs an accelerometer and a compass
(magnetometer, or any heading signal of the terminal's y axis). The alternative also needs a
gyroscope. Samples come one by one, in terminal axes and SI units, with stream time. The sign of the
accelerometer on an axis that points up depends on the terminal (`convention`). The counting
direction of a heading signal also depends on the terminal (`compass`). This module converts both.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.config.attitude import TravelDirectionSettings
from imucald.core.rotations import Vector, times, transposed_times
from imucald.motion.physical_limits import is_plausible
from imucald.travel_direction.attitude import TerminalAttitude
from imucald.travel_direction.certainty import (
    AHEAD_KNOWN,
    edge_log_odds,
    probability,
    sign_log_odds,
    whole_std,
)
from imucald.travel_direction.gyro_step_axis import GyroStepAxis
from imucald.travel_direction.method_d import (
    PublishedDirection,
    PublishedResult,
    level_heading,
    y_angle,
)
from imucald.travel_direction.step_cycles import StepCycle, StepCycles

STALE_S = 2.0
"""Time without a step after which the state is STANDING [s]."""
COMPASS_STALE_S = 1.0
"""Largest age of a compass value that is used [s]."""
MAX_FIELDS = 4096
"""Largest number of stored magnetic fields: the fields of one cycle at any sensor rate."""


class TravelState(enum.IntEnum):
    """State of the direction. The numbers are also sent on the bus."""

    NOT_AVAILABLE = 0
    STANDING = 1
    WALKING = 2
    TURNING = 3
    NO_COMPASS = 4
    AMBIGUOUS = 5


@dataclass(frozen=True)
class Step:
    """One step cycle and its headings [rad, clockwise from north]; None if not known.

    heading: heading of the configured method. compass: heading of the terminal's y axis; None if
    this axis is vertical. deviation: standard deviation of the alternative [rad]. ahead:
    probability that the alternative is not wrong by 180 deg.
    """

    t: float
    duration: float
    steps: int
    heading: float | None
    compass: float | None
    published: PublishedResult | None
    alternative: float | None
    trust: float
    deviation: float | None = None
    ahead: float | None = None
    ambiguous: bool = False
    """True if the heading comes from the alternative and may be wrong by 180 deg."""


class TravelDirection:
    """Method D and the alternative method for one terminal."""

    def __init__(self, settings: TravelDirectionSettings | None = None) -> None:
        self.settings = settings or TravelDirectionSettings()
        s = self.settings
        self.cycles = StepCycles(s.steps)
        self.published = PublishedDirection(s.choice)
        self.alternative = GyroStepAxis(s.alternative)
        self.attitude = TerminalAttitude(s.alternative)
        self._upwards = -1.0 if s.convention == "gravity" else 1.0
        self._clockwise = -1.0 if s.compass == "counter_clockwise" else 1.0
        self.last: Step | None = None
        """The newest step, or None."""
        self.rejected = 0
        """Number of samples that were left out because of impossible values."""
        self.gap()

    @property
    def steps(self) -> int:
        """Number of complete step cycles so far."""
        return self.cycles.steps

    def gap(self) -> None:
        """Note a jump of time: no difference is taken between values before the jump and values
        after it."""
        self.cycles.restart()
        self.published.restart()
        self.alternative.restart()
        self.attitude.restart()
        self._fields: deque[tuple[float, Vector]] = deque(maxlen=MAX_FIELDS)
        self._heading: tuple[float, float] | None = None
        self._has_gyro = False
        self._heard = -math.inf
        self._ahead = 0.5
        self.last = None

    def sample(self, t: float, channel: str, values: Sequence[float]) -> Step | None:
        """Process a sample of a channel (see `samples`). Returns the step that this sample
        completes, or None.

        Samples with impossible values are left out and counted.
        """
        if not is_plausible(channel, values):
            self.rejected += 1
            return None
        if channel == "accel":
            return self.accel(t, values)
        if channel == "gyro":
            self.gyro(t, values)
        elif channel == "mag":
            self.mag(t, values)
        elif channel == "heading":
            self.heading(t, values[0])
        return None

    def gyro(self, t: float, values: Sequence[float]) -> None:
        """Process an angular rate [rad/s]."""
        self._has_gyro = True
        self.attitude.gyro(t, (values[0], values[1], values[2]))

    def mag(self, t: float, values: Sequence[float]) -> None:
        """Process a magnetic field [T]."""
        field = (values[0], values[1], values[2])
        self._fields.append((t, field))
        while self._fields[0][0] < t - self.settings.steps.longest - COMPASS_STALE_S:
            self._fields.popleft()
        self.attitude.mag(t, field)

    def heading(self, t: float, heading: float) -> None:
        """Process a compass reading of the terminal's y axis [rad], from north."""
        heading = self._clockwise * heading
        self._heading = (t, heading)
        self.attitude.compass(t, heading)

    def accel(self, t: float, values: Sequence[float]) -> Step | None:
        """Process a specific force [m/s^2].

        Returns the step that this sample completes, or None.
        """
        s = self._upwards
        force = (s * values[0], s * values[1], s * values[2])
        self._heard = t
        self.attitude.accel(t, force)
        level = times(self.attitude.level, force)
        x, y, _ = times(self.attitude.level, self.attitude.rate)
        up = level[2] if self._has_gyro else None
        cycle = self.cycles.add_sample(t, force, level, (x, y), up)
        if cycle is None:
            return None
        self.last = self._step(cycle)
        return self.last

    def state(self, now: float) -> TravelState:
        """Return the state at stream time `now` [s]."""
        if now - self._heard > COMPASS_STALE_S:
            return TravelState.NOT_AVAILABLE
        last = self.last
        if last is None or now - last.t > STALE_S:
            return TravelState.STANDING
        if last.heading is None:
            return TravelState.NO_COMPASS
        if last.ambiguous:
            return TravelState.AMBIGUOUS
        turning = last.published is not None and last.published.is_turn
        return TravelState.TURNING if turning else TravelState.WALKING

    def _step(self, cycle: StepCycle) -> Step:
        level = self._level_heading(cycle)
        published = None if level is None else self.published.take_cycle(cycle, level)
        alternative = self._alternative(cycle)
        by_published = None if published is None else published.heading
        heading = by_published
        taken = self.settings.method == "alternative" and alternative is not None
        if taken:
            heading = alternative
        known = alternative is not None
        ahead = self._ahead if known else None
        return Step(
            t=cycle.t1,
            duration=cycle.duration,
            steps=self.cycles.steps,
            heading=heading,
            compass=None if published is None else published.compass,
            published=published,
            alternative=alternative,
            trust=self.alternative.trust if known else 0.0,
            deviation=whole_std(self.alternative.std, self.attitude.yaw_std) if known else None,
            ahead=ahead,
            ambiguous=taken and ahead is not None and ahead < AHEAD_KNOWN,
        )

    def _alternative(self, cycle: StepCycle) -> float | None:
        yaw = self.attitude.yaw
        if not self._has_gyro:
            return None
        up = transposed_times(self.attitude.level, (0.0, 0.0, 1.0))
        angle = self.alternative.take_cycle(cycle, self.attitude.turned, up)
        if angle is None or yaw is None:
            return None
        swing = self.alternative.swing
        x, y, _ = times(self.attitude.level, (0.0, 1.0, 0.0))
        edge = math.atan2(x, y) if math.hypot(x, y) > 0.0 else angle
        odds = sign_log_odds(self.alternative.phase_agreement, swing)
        odds += edge_log_odds(math.hypot(x, y) * math.cos(angle - edge), up[2], swing)
        self._ahead = probability(abs(odds))
        if odds < 0.0:
            angle += math.pi
        # The rotation of P by yaw is counter-clockwise, so it is subtracted from clockwise angles.
        # The declination then gives true north.
        declination = self.settings.declination if self._heading is None else 0.0
        return (angle - yaw + declination) % math.tau

    def _level_heading(self, cycle: StepCycle) -> float | None:
        """Return the heading of the cycle's level frame, clockwise from north [rad].

        The heading comes from the mean magnetic field in this frame. Without a magnetic field, the
        heading comes from the newest heading of the terminal's y axis.
        """
        mean = cycle.accel.mean(axis=0)
        field = self._mean_field(cycle)
        if field is not None:
            heading = level_heading(field, mean)
            return None if heading is None else (heading + self.settings.declination) % math.tau
        to_y = y_angle(mean)
        if self._heading is None or to_y is None:
            return None
        t, heading = self._heading
        return (heading - to_y) % math.tau if cycle.t1 - t <= COMPASS_STALE_S else None

    def _mean_field(self, cycle: StepCycle) -> NDArray[np.float64] | None:
        """Return the mean magnetic field of the cycle (3,) [T]. If the cycle contains no field,
        return the newest field, or None if it is too old."""
        inside = [field for t, field in self._fields if cycle.t0 <= t < cycle.t1]
        if not inside:
            newest = [field for t, field in self._fields if 0.0 <= cycle.t1 - t <= COMPASS_STALE_S]
            inside = newest[-1:]
        return np.mean(inside, axis=0) if inside else None
