"""Parameters of the vehicle, the road and the driver (sections of the model file).

Values are in SI units unless the name of a key states another unit. The defaults are those of a
compact passenger car on ordinary roads. Sources are given for values that are not obvious.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta

from imucald.core import default_vehicle
from imucald.model.section import (
    ZERO,
    Fraction,
    NonNegative,
    Positive,
    Section,
    Vector3,
)

RouteKind = Literal["mixed", "city", "motorway", "straight_only", "circles", "parked"]
DrivingSide = Literal["right", "left"]
RoadLength = Annotated[float, Meta(ge=15.0)]
"""Correlation length of a road. Shorter waves belong to the roughness."""


MAX_SPEED_MPS = 36.0
"""Highest speed of drivers on any route."""


STEERING_GEAR_S = 0.03
"""Delay between steering wheel and road wheels [s]: a well-damped steering gear with 6 Hz on its
torsion bar. Cars differ by 0.02 s."""


class Chassis(Section, frozen=True):
    """Single-track vehicle. The front stiffness is computed from the understeer gradient and the
    rear stiffness."""

    mass_kg: Positive = 1450.0
    yaw_inertia_kgm2: Positive = 2300.0
    wheelbase_m: Positive = default_vehicle.WHEELBASE
    cg_to_front_m: Positive = 1.20
    track_m: Positive = default_vehicle.TRACK
    steering_ratio: Positive = default_vehicle.STEERING_RATIO
    """Ratio of steering-wheel angle to road-wheel angle."""
    rear_cornering_stiffness_npr: Positive = 110e3
    """Ratio of lateral force to slip angle at the rear axle [N/rad]."""
    understeer_gradient: float = default_vehicle.UNDERSTEER
    """K in delta = L/R + K * a_y [rad/(m/s^2)]."""
    friction: Annotated[float, Meta(ge=0.15)] = 0.95
    """Friction of the tyres. The tyre force saturates at friction times axle load."""
    tyre_saturation: bool = True
    """False: the tyres stay linear."""
    single_track: bool = True
    """False: the vehicle follows the path exactly, without sideslip and without lag."""

    @property
    def cg_to_rear_m(self) -> float:
        """Distance from the centre of gravity to the rear axle [m]."""
        return self.wheelbase_m - self.cg_to_front_m

    @property
    def front_cornering_stiffness_npr(self) -> float:
        """Stiffness of the front axle [N/rad], from K = m/L (l_r/C_f - l_f/C_r)."""
        m, L = self.mass_kg, self.wheelbase_m
        rear = self.cg_to_front_m / self.rear_cornering_stiffness_npr
        return self.cg_to_rear_m / (self.understeer_gradient * L / m + rear)

    def __post_init__(self) -> None:
        if self.cg_to_front_m >= self.wheelbase_m:
            raise ValueError("cg_to_front_m must be shorter than wheelbase_m")
        limit = -self.wheelbase_m / MAX_SPEED_MPS**2
        if self.understeer_gradient < limit:
            raise ValueError(
                f"understeer_gradient must not be below {limit:.4f}: the vehicle would "
                "spin at high speed"
            )


class Suspension(Section, frozen=True):
    """The body on its springs: roll and pitch as second-order systems, and a quarter-car model.

    The body rotates about a centre that moves with the road frame. The lever arm of the sensor
    begins at this centre.
    """

    squat_dive: bool = True
    squat_gradient: float = 0.0035
    """Nose-up angle per forward specific force [rad/(m/s^2)]; 0.0035 is 2 deg/g."""
    dive_gradient: float = 0.0040
    """Nose-down angle per braking specific force [rad/(m/s^2)]."""
    pitch_frequency_hz: Positive = 1.7
    pitch_damping: Positive = 0.35
    body_roll: bool = True
    roll_gradient: float = 0.0080
    """Roll out of the turn per lateral specific force [rad/(m/s^2)]; 0.008 is 4.5 deg/g."""
    roll_frequency_hz: Positive = 1.8
    roll_damping: Positive = 0.35
    heave_frequency_hz: Positive = 1.4
    heave_damping: Positive = 0.30
    wheel_hop_hz: Positive = 11.0
    unsprung_ratio: Positive = 0.12
    """Ratio of unsprung to sprung mass. This ratio and `wheel_hop_hz` determine the stiffness of
    the tyre."""


class Road(Section, frozen=True):
    """Slope, crown, superelevation and roughness of the road."""

    grade: bool = True
    grade_rms: NonNegative = 0.02
    """rms of the slope along the road (tangent), about its mean."""
    grade_mean: float = 0.0
    """Mean slope (tangent), positive uphill."""
    grade_length_m: RoadLength = 110.0
    """Correlation length of the slope (second-order Gauss-Markov process). Slopes are longer on
    fast roads."""
    bank: bool = True
    crown_mean: float = 0.012
    """Mean cross fall towards the kerb (tangent)."""
    bank_rms: NonNegative = 0.015
    """rms of the cross fall about its mean."""
    bank_length_m: RoadLength = 60.0
    superelevation: Fraction = 0.3
    """Share of the centripetal acceleration that superelevated curves compensate. Cities have no
    superelevated curves."""
    superelevation_max: NonNegative = 0.05
    roughness: bool = True
    roughness_n0: NonNegative = 48e-6
    """Displacement spectral density at 0.1 cycles/m [m^3]; ISO 8608: class A 16e-6, class B 64e-6,
    class C 256e-6."""


class DriveRoute(Section, frozen=True):
    """Route of the drive and style of the driver."""

    kind: RouteKind = "mixed"
    driving_side: DrivingSide = "right"
    standing_first_s: NonNegative = 20.0
    """Standing time before the first motion. With 0, the vehicle already moves at the start."""
    standing_last_s: NonNegative = 10.0
    """Standing time at the end, if the drive is long enough."""
    launch_mps2: tuple[Positive, Positive] = (0.8, 2.5)
    """Range of accelerations from rest."""
    braking_mps2: tuple[Positive, Positive] = (0.8, 3.3)
    lateral_mps2: tuple[Positive, Positive] = (1.2, 3.6)
    """Range of the lateral accelerations that the driver accepts in bends."""
    stop_mean_s: Positive = 18.0
    """Mean duration of a stop (log-normal spread)."""
    speed_factor: Positive = 1.0
    """Factor on all target speeds."""
    speed_wander: NonNegative = 0.05
    """rms of the relative variation of the driver's speed."""
    steering_wander_mps2: NonNegative = 0.10
    """rms of the lateral acceleration from the driver's small steering corrections."""
    gear_shifts: bool = True
    reversing: bool = True
    """True: some drives contain manoeuvres in reverse gear."""
    circle_radius_m: Positive = 14.0
    """Radius of the `circles` route."""

    def __post_init__(self) -> None:
        for name in ("launch_mps2", "braking_mps2", "lateral_mps2"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}: write the lower bound first")


class ScheduledShift(Section, frozen=True):
    """A rotation of the sensor at a time. The angles are about the vehicle's axes."""

    t_s: NonNegative
    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0


class Mount(Section, frozen=True):
    """Mount of the sensor: intrinsic Z-Y-X angles of R_vehicle_from_sensor, and its position."""

    roll_deg: float = 0.0
    pitch_deg: float = 0.0
    yaw_deg: float = 0.0
    lever_arm: bool = True
    lever_arm_m: Vector3 = ZERO
    """Vector from the body's centre of rotation (below the centre of gravity) to the sensor, in
    vehicle axes."""
    shifts: tuple[ScheduledShift, ...] = ()

    def __post_init__(self) -> None:
        times = [shift.t_s for shift in self.shifts]
        if times != sorted(times):
            raise ValueError("shifts must be in the order of their times")
