"""Straight intervals of variable speed, joined into manoeuvres. A manoeuvre is one braking or one
acceleration."""

from __future__ import annotations

import math

import numpy as np

from imucald.core.rotations import Matrix3, Vector
from imucald.motion.speed import SpeedInterval
from imucald.mount.method_a.settings import PublishedSettings
from imucald.mount.method_a.target_angle import Manoeuvre, ManoeuvreBook

MANOEUVRES_KEPT = 150
"""Largest number of stored manoeuvres (about an hour in a city). The oldest manoeuvre is dropped
first."""
MAX_MANOEUVRE_S = 8.0
"""Longest duration of a manoeuvre [s]. A longer braking or acceleration is divided into several
manoeuvres."""
MANOEUVRE_HOLE = 1.5
"""Time without an accepted interval after which a manoeuvre ends [s]."""


class ManoeuvreCollector:
    """Keeps the open manoeuvre, and the collections of finished manoeuvres."""

    def __init__(self, settings: PublishedSettings) -> None:
        self._settings = settings
        self.signed = ManoeuvreBook(MANOEUVRES_KEPT)
        """Manoeuvres with a known direction of travel: the speed shows which way is forward."""
        self.unsigned = ManoeuvreBook(MANOEUVRES_KEPT)
        self.gear_known = False
        """True if a signal shows when the vehicle is in reverse."""
        self._open: Manoeuvre | None = None

    def drop(self) -> None:
        """Drop the open manoeuvre because time jumped."""
        self._open = None

    def take_interval(
        self, interval: SpeedInterval, f: Vector, along: float, lateral: float
    ) -> bool:
        """Process an interval with speed. Returns True if a manoeuvre has ended and is kept.

        f: force minus offset in sensor axes [m/s^2]. along, lateral: dv/dt and v r (speed times yaw
        rate) minus their offsets [m/s^2].
        """
        s, m = self._settings, self._open
        straight = s.calibration.straight
        slowest = straight.min_speed if self.gear_known else straight.min_speed_without_reverse
        if (
            abs(interval.speed) < slowest
            or max(abs(along), abs(interval.dvdt)) < straight.min_speed_change
        ):
            return False
        ended = False
        if (
            m is not None
            and m.peak * interval.dvdt < 0.0
            and abs(interval.dvdt) >= straight.min_speed_change
        ):
            ended = self.end()  # from braking to accelerating: another manoeuvre
        m, too_old = self._manoeuvre(interval, signed=True)
        weight = (
            1.0 if s.wander_speed <= 0.0 else 1.0 / (1.0 + abs(interval.speed) / s.wander_speed)
        )
        m.add_interval(interval, f, along, lateral, weight)
        if abs(interval.dvdt) > abs(m.peak):
            m.peak = interval.dvdt
        return ended or too_old

    def take_unsigned(
        self, interval: SpeedInterval, f: Vector, R_level_from_sensor: Matrix3
    ) -> bool:
        """Process an interval without speed: a manoeuvre is recognised by the size of the level
        force."""
        x, y, _ = (R_level_from_sensor @ np.array(f)).tolist()
        size = math.hypot(x, y)
        if size < self._settings.calibration.straight.min_speed_change:
            return False
        m, ended = self._manoeuvre(interval, signed=False)
        m.add_interval(interval, f, 0.0, 0.0, 1.0)
        m.peak = max(m.peak, size)
        return ended

    def _manoeuvre(self, interval: SpeedInterval, signed: bool) -> tuple[Manoeuvre, bool]:
        """Return the open manoeuvre if the interval belongs to it, else a new manoeuvre.

        Also returns True if the previous manoeuvre has ended and is kept.
        """
        m, ended = self._open, False
        if m is not None and (
            m.signed != signed
            or m.seconds >= MAX_MANOEUVRE_S
            or interval.t0 - m.stop > MANOEUVRE_HOLE
        ):
            ended = self.end()
        if self._open is None:
            self._open = Manoeuvre(interval.t0, signed)
        return self._open, ended

    def end(self) -> bool:
        """End the open manoeuvre. Returns True if there was an open manoeuvre and it is kept."""
        m, self._open = self._open, None
        if m is None or abs(m.peak) < self._settings.calibration.straight.manoeuvre_peak:
            return False
        if m.seconds < self._settings.min_manoeuvre:
            return False
        (self.signed if m.signed else self.unsigned).add_manoeuvre(m)
        return True
