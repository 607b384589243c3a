"""Keys that the file gives and nothing reads, the other keys being as they are: reported, with why.

A key that cannot ever be met is an error (`impossible`); one that is merely idle is a warning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

from imucald.config.attitude import AttitudeSettings, TravelDirectionSettings
from imucald.config.calibration import CalibrationSettings
from imucald.config.signals import Signals
from imucald.core.locations import Place

Rule = tuple[tuple[str, ...], bool, str]
"""Key (dotted path in parts), whether it is idle, why."""


class Keys(Protocol):
    """The sections whose keys are looked at."""

    @property
    def signals(self) -> Signals:
        """Which signal is which quantity."""
        ...

    @property
    def calibration(self) -> CalibrationSettings:
        """How the mount is found."""
        ...

    @property
    def attitude(self) -> AttitudeSettings:
        """Methods B and C."""
        ...

    @property
    def travel_direction(self) -> TravelDirectionSettings:
        """Method D."""
        ...


FILTER_ONLY = ("speed_noise", "speed_scale", "creep_speed", "lever_uncertainty")
"""Of `attitude.compensation`: what widens the filter's noise."""
B_READS = (
    "check",
    "start",
    "longest_step",
    "rest_accel_spread",
    "rest_gyro_spread_deg_s",
    "gyro_start_deg_s",
)
"""Of `attitude.filter`: what method B alone reads for its rests."""


def idle_keys(config: Keys, is_given: Callable[[Place], bool]) -> Iterator[tuple[Place, str]]:
    """Places of given keys that have no effect, each with its reason."""
    for rules in (_calibration(config), _attitude(config), _travel(config)):
        for place, idle, why in rules:
            if idle and is_given(place):
                yield place, f"has no effect {why}"


LEANING = (
    "z is missing: a sensor of two axes cannot be levelled, only one that is level can be turned "
    "(an accelerometer of two axes, or estimator: published with method_a: {level: false})"
)


def impossible(config: Keys) -> Iterator[tuple[Place, str]]:
    """Places of keys that no sensor or sample can ever meet, each with what they need."""
    calibration, signals = config.calibration, config.signals
    up, forward = calibration.orientation.up, calibration.orientation.forward
    if up is not None and forward is not None and up[-1] == forward[-1]:
        text = f"up: {up} and forward: {forward} name one axis: up and forward are never one"
        yield ("calibration", "orientation"), text
    if not _is_level(config):
        for i, sensor in enumerate(signals.parallel):
            if sensor.z is None:
                yield ("signals", "parallel", i), LEANING
    if calibration.estimator != "published":
        return
    has_speed = signals.speed is not None or signals.wheel_speeds is not None
    steering = signals.steering_wheel_angle is not None
    rate = signals.yaw_rate is not None or signals.gyroscope is not None
    there = {"steering": steering, "yaw_rate": rate or (steering and has_speed)}
    groups = calibration.straight.groups
    if not any(all(there.get(name, True) for name in group) for group in groups):
        needs = {"steering": "signals.steering_wheel_angle", "yaw_rate": "signals.yaw_rate"}
        missing = sorted({needs[n] for g in groups for n in g if not there.get(n, True)})
        text = f"no motion is ever straight without {' and '.join(missing)}"
        yield ("calibration", "straight", "recognise_by"), text
    known = {"speed": has_speed, "brake": signals.brake is not None}
    sources = calibration.target_angle.sign_from
    if not any(known.get(source, True) for source in sources):
        missing = sorted(f"signals.{source}" for source in sources)
        text = f"nothing separates forward from backward without {' or '.join(missing)}"
        yield ("calibration", "target_angle", "sign_from"), text


def _is_level(config: Keys) -> bool:
    """Whether the accelerometer, and what is parallel to it, counts as level."""
    calibration = config.calibration
    published = calibration.estimator == "published"
    planar = config.signals.accelerometer[0].z is None
    return planar or (published and not calibration.method_a.level)


def _calibration(config: Keys) -> Iterator[Rule]:
    calibration = config.calibration
    at = "calibration"
    published = calibration.estimator == "published"
    for section in ("static", "straight", "target_angle", "method_a"):
        yield (at, section), not published, "with estimator: full (method A alone reads it)"
    for key in ("cross_axis", "orientation"):
        yield (at, key), published, "with estimator: published"
    if not published:
        return
    letter = calibration.method_a.to_the_letter
    why = "with method_a: to_the_letter, which leaves it out"
    yield (at, "static", "average_stops"), letter, why
    yield (at, "straight", "lateral_limit"), letter, why
    yield (at, "target_angle", "subtract_lateral"), letter, why
    yield (at, "target_angle", "remove_offset_after"), letter, why
    planar = config.signals.accelerometer[0].z is None
    yield (at, "method_a", "level"), planar, "with an accelerometer of two axes"
    flat = _is_level(config)
    yield (at, "static", "average_stops"), flat and not letter, "without levelling"
    named = calibration.straight.recognisers
    for key, recogniser in (
        ("yaw_rate_limit_deg_s", "yaw_rate"),
        ("yaw_rate_limit_without_speed_deg_s", "yaw_rate"),
        ("steering_limit_deg", "steering"),
        ("consistency_window", "consistency"),
        ("consistency_range_deg", "consistency"),
    ):
        idle = recogniser not in named and not key.startswith("yaw_rate_limit")
        yield (at, "straight", key), idle, f"where recognise_by does not name {recogniser}"
    has_steering = config.signals.steering_wheel_angle is not None
    idle = "steering" in named and not has_steering
    why = "without signals.steering_wheel_angle"
    yield (at, "straight", "steering_limit_deg"), idle, why
    has_speed = config.signals.speed is not None or config.signals.wheel_speeds is not None
    for section, key in (
        ("static", "threshold_at_zero_speed"),
        ("static", "standstill_speed"),
        ("straight", "min_speed"),
        ("target_angle", "subtract_lateral"),
    ):
        yield (at, section, key), not has_speed, "without a speed"
    yield (at, "speed_delay"), not has_speed, "without a speed"


def _attitude(config: Keys) -> Iterator[Rule]:
    attitude = config.attitude
    if not attitude.enabled:  # prepared and switched off: that is what `enabled` is for
        return
    at = "attitude"
    alone = attitude.method == "compensation"
    why = "with method: compensation"
    for key in ("squat", "grade_time"):
        yield (at, key), alone, why
    for key in FILTER_ONLY:
        yield (at, "compensation", key), alone, why
    why = "with method: filter"
    yield (at, "compensation", "rate_time"), not alone, why
    idle = not alone and not attitude.compensation.send
    yield (at, "compensation", "centripetal"), idle, f"{why} (it takes all of omega x v)"
    for key in type(attitude.filter).__struct_fields__:
        idle = alone and key not in B_READS
        yield (at, "filter", key), idle, "with method: compensation"
    source = attitude.filter.heading
    why = f"with filter.heading: {source}"
    yield (at, "filter", "heading_noise_deg"), not alone and source != "signal", why
    for key in ("magnetometer_noise_deg", "declination_deg"):
        yield (at, "filter", key), not alone and source != "magnetometer", why
    has_speed = config.signals.speed is not None or config.signals.wheel_speeds is not None
    for key in ("average", "timeout", "delay", "speed_is", *FILTER_ONLY):
        idle = not has_speed and not (alone and key in FILTER_ONLY)
        yield (at, "compensation", key), idle, "without a speed"


def _travel(config: Keys) -> Iterator[Rule]:
    travel, signals = config.travel_direction, config.signals
    if not travel.enabled:
        return
    at = "travel_direction"
    yield (at, "alternative"), signals.gyroscope is None, "without signals.gyroscope"
    yield (at, "compass"), signals.heading is None, "without signals.heading"
    why = "without signals.magnetometer"
    yield (at, "declination_deg"), signals.magnetometer is None, why
    why = "without signals.heading"
    idle = signals.heading is None and signals.gyroscope is not None
    yield (at, "alternative", "compass_time"), idle, why
