"""Presets of method A; the configuration maps onto this, and each has a default with its reason."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from imucald.motion.at_rest import ZERO_SPEED_COARSE
from imucald.motion.standstill import StaticTestSettings

RECOGNISERS = ("yaw_rate", "steering", "consistency")
SIGN_SOURCES = ("speed", "brake", "turn", "first_motion")


@dataclass(frozen=True)
class PublishedSettings:
    """Presets of the published solver and of what stands on top of it. SI units.

    The defaults include what goes beyond the publication; `as_published` switches that off.
    """

    # Steps 1-3: standstill and levelling.
    static: StaticTestSettings = field(default_factory=StaticTestSettings)
    standstill_speed: float = ZERO_SPEED_COARSE
    """Speed [m/s] up to which the vehicle stands: one step of an OBD-II speed is 0.28 m/s."""
    average_stops: bool = True
    """Combine all stops (beyond the publication); else the last stop decides."""
    place_distance: float = 25.0
    """Distance [m] after which the next stop is another place with another slope."""
    place_seconds: float = 10.0
    """The same without speed: seconds of motion."""
    slope_std: float = math.radians(1.3)
    """Spread of road slope from stop to stop, per axis [rad]; measured: 0.7-3 deg."""
    accel_bias_std: float = 0.098
    """Accelerometer bias [m/s^2] (10 mg): what no number of stops averages."""
    accel_range: float = math.inf
    """Full scale of the accelerometer [m/s^2]; nothing is learnt close to it."""
    crown: float = 0.0
    """Expected lean of the roads [rad]: positive where traffic keeps right, 0 where unknown."""
    crown_std: float = 0.0134
    """Spread of that lean [rad]; it reads as mount roll and nothing sees it. Without a driving
    side: 1.2 % either way with a spread of 0.6 %."""
    planar: bool = False
    """The accelerometer has two axes only and counts as level; z is taken as gravity."""
    planar_tilt_std: float = math.radians(1.5)
    """How level a planar accelerometer is taken to be [rad]."""
    level_without_stop_after: float = 120.0
    """Seconds of driving after which the mean specific force levels, for want of a stop [s]."""

    # Step 4: straight variable-speed motion.
    recognisers: tuple[str, ...] = RECOGNISERS
    """Recognisers by preference; the first whose signal is there decides."""
    yaw_rate_limit: float = math.radians(2.0)
    """Yaw rate of straight motion [rad/s] where v r is known and gated as well."""
    yaw_rate_limit_without_speed: float = math.radians(1.0)
    """The same where speed is unknown: 1 deg/s at 20 m/s is 0.35 m/s^2."""
    steering_limit: float = math.radians(10.0)
    """Steering-wheel angle of straight motion [rad]."""
    steering_ratio: float = 15.5
    wheelbase: float = 2.7
    """Wheelbase [m]; with the steering ratio it gives yaw rate where nothing measures it."""
    consistency_window: int = 15
    """Successive angles, at 10 per second, that must agree."""
    consistency_spread: float = math.radians(25.0)
    """Range within which they agree [rad]."""
    consistency_smoothing: int = 10
    """Ticks (0.1 s) averaged for each angle: road noise is as large as braking otherwise."""
    lateral_limit: float = 0.6
    """Lateral acceleration v r of straight motion [m/s^2]; 0 switches the gate off."""
    settle: float = 1.5
    """Straight motion [s] after a turn before anything is learnt: body roll swings out."""
    min_speed_change: float = 0.25
    """Least |dv/dt| of variable-speed motion [m/s^2]: below, slope and noise decide the angle."""
    manoeuvre_peak: float = 0.8
    """|dv/dt| that a manoeuvre must reach to count [m/s^2]."""
    min_speed: float = 1.0
    """Speed [m/s] below which nothing is learnt: manoeuvring, clutch, signal dead zone."""
    min_speed_unknown_gear: float = 2.0
    """The same where no signal tells reverse gear: nobody reverses faster for long [m/s]."""

    # Step 5: the target angle and its sign.
    sign_sources: tuple[str, ...] = SIGN_SOURCES
    """What may tell accelerating from braking."""
    subtract_lateral: bool = True
    """Subtract v r where speed and yaw rate are known (beyond the publication)."""
    remove_offset_after: float = 1.0
    """Time constant [s] of the mean that is removed: slope, bank and bias wander. 0: never."""
    wander_speed: float = 2.4
    """Speed [m/s] at which a block counts half: the faster, the more slope and bank wander while
    speed changes (beyond the publication). 0: all count alike."""
    use_speed: bool = True
    """Use dv/dt for gate, sign and weight (beyond the publication for gate and weight)."""
    speed_delay: float = 0.0
    """How late the speed is against the accelerometer [s]; negative where it leads."""
    speed_timeout: float = 2.5
    """Time without a speed sample after which speed is unknown [s]."""
    block_s: float = 0.2
    """Shortest interval over which dv/dt and acceleration are compared [s]."""

    # States; a state is left only when its limit is exceeded by the factor `hysteresis`.
    usable_manoeuvres: int = 3
    usable_yaw_std: float = math.radians(3.0)
    usable_tilt_std: float = math.radians(2.5)
    fine_manoeuvres: int = 8
    fine_yaw_std: float = math.radians(1.0)
    fine_tilt_std: float = math.radians(1.0)
    hysteresis: float = 1.4
    slew: float = math.radians(0.5)
    """Rate [rad/s] at which the applied rotation follows the estimate."""

    def as_published(self) -> PublishedSettings:
        """Return the same presets without what goes beyond the publication."""
        return replace(
            self,
            average_stops=False,
            subtract_lateral=False,
            remove_offset_after=0.0,
            wander_speed=0.0,
            lateral_limit=0.0,
        )
