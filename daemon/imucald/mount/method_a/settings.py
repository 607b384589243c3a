"""Settings of method A from the configuration, and its constants with their reasons."""

from __future__ import annotations

import math

from msgspec.structs import replace

from imucald.mount.estimator_settings import Limits, MountSettings


class PublishedSettings(MountSettings, frozen=True):
    """Settings of the published solver and of the additions to it. SI units.

    The defaults include the additions to the publication; `to_the_letter` leaves them out.
    """

    OWN_LIMITS = Limits(
        usable_yaw=math.radians(3.0),
        usable_tilt=math.radians(2.5),
        fine_yaw=math.radians(1.0),
        fine_tilt=math.radians(1.0),
    )

    @property
    def is_level(self) -> bool:
        """True if the accelerometer counts as level, so that no levelling is done."""
        return self.planar or not self.calibration.method_a.level

    def to_the_letter(self) -> PublishedSettings:
        """Return these settings without the additions to the publication."""
        c = self.calibration
        calibration = replace(
            c,
            static=replace(
                c.static, average_stops=False, threshold_at_zero_speed=c.static.threshold
            ),
            straight=replace(
                c.straight, lateral_limit=0.0, min_speed_without_reverse=c.straight.min_speed
            ),
            target_angle=replace(c.target_angle, subtract_lateral=False, remove_offset_after=0.0),
        )
        return replace(
            self,
            calibration=calibration,
            wander_speed=0.0,
            settle=0.0,
            crown_mean=0.0,
            level_without_stop_after=math.inf,
            min_manoeuvre=0.0,
            robust=False,
        )

    # Steps 1-3: standstill and levelling.
    place_distance: float = 25.0
    """Distance [m] after which the next stop counts as another place with another slope."""
    place_seconds: float = 10.0
    """Time of motion [s] after which the next stop counts as another place, if there is no
    speed."""
    slope_std: float = math.radians(1.3)
    """Spread of road slope between stops, per axis [rad]; measured: 0.7-3 deg."""
    planar: bool = False
    """True if the accelerometer has two axes only. Such an accelerometer is assumed to be level,
    and gravity is used as its z value."""
    level_std: float = math.radians(1.5)
    """Deviation from level of an accelerometer that counts as level [rad]."""
    level_without_stop_after: float = 120.0
    """Driving time without a stop [s] after which the mean specific force is used to level."""

    # Step 4: straight variable-speed motion.
    settle: float = 1.5
    """Duration of straight motion [s] after a turn before learning begins: the body roll must
    decay."""
    min_manoeuvre: float = 1.0
    """Shortest duration of a manoeuvre [s]; anything shorter is a bump."""

    # Step 5: the target angle and its sign.
    wander_speed: float = 2.4
    """Speed [m/s] at which a block has half weight. At higher speeds, slope and bank change more
    during a change of speed. With 0, all blocks have the same weight. This weight is an addition to
    the publication.
    """
    robust: bool = True
    """True if a manoeuvre that disagrees with the other manoeuvres gets less weight (Huber)."""
    use_speed: bool = True
    """True if dv/dt from a speed is used for gate, sign and weight. The use for gate and weight is
    an addition to the publication.
    """
    speed_timeout: float = 2.5
    """Time without a speed sample after which the speed is unknown [s]."""
    block_s: float = 0.2
    """Shortest interval over which dv/dt and acceleration are compared [s]."""

    # States; a state is left only when its limit is exceeded by the factor `hysteresis`.
    usable_manoeuvres: int = 3
    fine_manoeuvres: int = 8
    hysteresis: float = 1.4
    slew: float = math.radians(0.5)
    """Rate [rad/s] at which the applied rotation moves to the estimate."""
