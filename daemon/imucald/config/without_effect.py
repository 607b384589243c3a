"""Find keys of the file that have no effect with the present settings, and state the reasons.

A key with a condition that can never be met is an error (`impossible`). An unused key is only a
warning.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Protocol

from imucald.config.attitude import AttitudeSettings, TravelDirectionSettings
from imucald.config.calibration import CalibrationSettings
from imucald.config.signals import Signals
from imucald.core.typed import Place

Rule = tuple[tuple[str, ...], bool, str]
"""A key (parts of the dotted path), whether the key has no effect, and the reason."""


class _Keys(Protocol):
    @property
    def signals(self) -> Signals: ...
    @property
    def calibration(self) -> CalibrationSettings: ...
    @property
    def attitude(self) -> AttitudeSettings: ...
    @property
    def travel_direction(self) -> TravelDirectionSettings: ...
    @property
    def uses_method_a(self) -> bool: ...


FILTER_ONLY = ("speed_noise", "speed_scale", "creep_speed", "lever_uncertainty")
"""Keys of `attitude.compensation` that increase the noise of the filter."""
B_READS = (
    "check",
    "start",
    "longest_step",
    "rest_accel_spread",
    "rest_gyro_spread_deg_s",
    "gyro_start_deg_s",
)
"""Keys of `attitude.filter` that method B alone reads, to detect rest."""
FILTER_NEEDS_SPEED = (
    ("squat",),
    *(("compensation", key) for key in ("average", "timeout", "delay", "speed_is", "lever_arm")),
    *(("compensation", key) for key in FILTER_ONLY),
)
"""Keys of `attitude` that the filter reads only with a speed. Without a speed, the filter has no
forward acceleration, and its noise covers the lever arm."""
B_NEEDS_SPEED = (
    *(("compensation", key) for key in ("average", "interval", "timeout", "speed_is")),
    ("compensation", "centripetal"),
    ("filter", "start"),
)
"""Keys of `attitude` that method B alone reads only with a speed. Without a speed, each rest must
last `filter.check`, as still as a parked vehicle."""


def idle_keys(config: _Keys, is_given: Callable[[Place], bool]) -> Iterator[tuple[Place, str]]:
    """Yield the places of present keys without effect, each with its reason."""
    for rules in (_calibration(config), _attitude(config), _travel(config)):
        for place, idle, why in rules:
            if idle and is_given(place):
                yield place, f"has no effect {why}"


def impossible(config: _Keys) -> Iterator[tuple[Place, str]]:
    """Yield the places of keys with a condition that no sensor or sample can meet, with the
    requirement for the key."""
    calibration, signals = config.calibration, config.signals
    up, forward = calibration.orientation.up, calibration.orientation.forward
    if up is not None and forward is not None and up[-1] == forward[-1]:
        text = f"up: {up} and forward: {forward} name the same axis; name two different axes"
        yield ("calibration", "orientation"), text
    if not _is_level(config):
        for i, sensor in enumerate(signals.parallel):
            if sensor.z is None:
                text = (
                    "z is missing: a sensor of two axes must be mounted level. Configure its z "
                    "axis; or, if the sensors are level, configure an accelerometer of two axes, "
                    "or 'estimator: published' with 'method_a: {level: false}'"
                )
                yield ("signals", "parallel", i), text
    if calibration.estimator != "published":
        return
    has_speed = signals.speed is not None or signals.wheel_speeds is not None
    there = _recognisers_there(config)
    groups = calibration.straight.groups
    if not any(all(there[name] for name in group) for group in groups):
        needs = {"steering": "signals.steering_wheel_angle", "yaw_rate": "signals.yaw_rate"}
        missing = sorted({needs[n] for g in groups for n in g if not there[n]})
        text = f"straight driving cannot be recognised without {' and '.join(missing)}"
        yield ("calibration", "straight", "recognise_by"), text
    known = {"speed": has_speed, "brake": signals.brake is not None}
    sources = calibration.target_angle.sign_from
    if not any(known.get(source, True) for source in sources):
        missing = sorted(f"signals.{source}" for source in sources)
        text = f"forward and backward cannot be separated without {' or '.join(missing)}"
        yield ("calibration", "target_angle", "sign_from"), text


def _is_level(config: _Keys) -> bool:
    """True if the accelerometer and its parallel sensors are configured as level."""
    calibration = config.calibration
    published = config.uses_method_a
    planar = config.signals.accelerometer[0].z is None
    return planar or (published and not calibration.method_a.level)


def _calibration(config: _Keys) -> Iterator[Rule]:
    at, published, estimator = "calibration", config.uses_method_a, config.calibration.estimator
    yield (at, "estimator"), estimator == "full", "any more: 'joint' takes its place"
    why = "without a speed, and without turns or the sensor's z axis: method A is used"
    yield (at, "estimator"), published and estimator == "joint", why
    for section in ("static", "straight", "target_angle", "method_a"):
        yield (
            (at, section),
            not published,
            "without 'estimator: published' (only method A reads it)",
        )
    for key in ("cross_axis", "orientation"):
        why = "with method A (estimator: published; or no speed, and no turns or no z axis)"
        yield (at, key), published, why
    yield from _method_a(config)


def _method_a(config: _Keys) -> Iterator[Rule]:
    calibration, signals, at = config.calibration, config.signals, "calibration"
    if not config.uses_method_a:
        return
    letter = calibration.method_a.to_the_letter
    why = "with 'method_a: to_the_letter', which does not use it"
    yield (at, "static", "average_stops"), letter, why
    yield (at, "static", "threshold_at_zero_speed"), letter, why
    yield (at, "straight", "lateral_limit"), letter, why
    yield (at, "straight", "min_speed_without_reverse"), letter, why
    yield (at, "target_angle", "subtract_lateral"), letter, why
    yield (at, "target_angle", "remove_offset_after"), letter, why
    planar = signals.accelerometer[0].z is None
    yield (at, "method_a", "level"), planar, "with an accelerometer of two axes"
    flat = _is_level(config)
    yield (at, "static", "average_stops"), flat and not letter, "without levelling"
    yield from _recognisers(config)
    has_speed = signals.speed is not None or signals.wheel_speeds is not None
    gated = calibration.straight.lateral_limit > 0.0 and not letter
    idle, why = gated and not has_speed, "without a speed"
    yield (at, "straight", "yaw_rate_limit_deg_s"), idle, why
    why = "with 'lateral_limit: 0': yaw_rate_limit_without_speed_deg_s is used instead"
    yield (at, "straight", "yaw_rate_limit_deg_s"), not gated, why
    idle = not (letter or has_speed or signals.lateral_acceleration is not None)
    why = "without a speed and without signals.lateral_acceleration"
    yield (at, "straight", "lateral_limit"), idle, why
    has_gear = signals.reverse is not None
    why = "without signals.reverse: min_speed_without_reverse is used instead"
    yield (at, "straight", "min_speed"), has_speed and not (has_gear or letter), why
    why = "with signals.reverse: min_speed is used instead"
    idle = has_speed and has_gear and not letter
    yield (at, "straight", "min_speed_without_reverse"), idle, why
    for section, key in (
        ("static", "threshold_at_zero_speed"),
        ("static", "standstill_speed"),
        ("straight", "min_speed"),
        ("straight", "min_speed_without_reverse"),
        ("target_angle", "subtract_lateral"),
    ):
        yield (at, section, key), not has_speed, "without a speed"
    yield (at, "speed_delay"), not has_speed, "without a speed"
    steered = has_speed and signals.steering_wheel_angle is not None
    has_rate = signals.gyroscope is not None or signals.yaw_rate is not None or steered
    for section, key in (
        ("straight", "yaw_rate_limit_deg_s"),
        ("straight", "yaw_rate_limit_without_speed_deg_s"),
        ("target_angle", "subtract_lateral"),
    ):
        yield (at, section, key), not has_rate, "without a yaw rate"


LIMITS = {
    "yaw_rate": ("yaw_rate_limit_deg_s", "yaw_rate_limit_without_speed_deg_s"),
    "steering": ("steering_limit_deg",),
    "consistency": ("consistency_window", "consistency_range_deg", "consistency_mean"),
}
"""For each recogniser (test for straight motion), the keys of `calibration.straight` that it
reads."""


def _recognisers(config: _Keys) -> Iterator[Rule]:
    """Yield rules for the keys of recognisers (tests for straight motion) that are not used.

    A recogniser is not used if it is not named, if its signal is missing, or if a preferred
    recogniser is used. The limits of the yaw rate are also used to find turns, unless to_the_letter
    is set.
    """
    straight, there = config.calibration.straight, _recognisers_there(config)
    deciding = [g for g in straight.groups if all(there[name] for name in g)][:1]
    for name, keys in LIMITS.items():
        idle, why = False, ""
        if name not in straight.recognisers:
            idle, why = True, f"since 'recognise_by' does not name {name}"
        elif name == "steering" and not there[name]:
            idle, why = True, "without signals.steering_wheel_angle"
        elif deciding and name not in deciding[0]:
            first = " and ".join(deciding[0])
            idle, why = True, f"since {first} is configured, which 'recognise_by' prefers to {name}"
        if name == "yaw_rate" and not config.calibration.method_a.to_the_letter:
            idle = False
        for key in keys:
            yield ("calibration", "straight", key), idle, why


def _recognisers_there(config: _Keys) -> dict[str, bool]:
    signals = config.signals
    has_speed = signals.speed is not None or signals.wheel_speeds is not None
    steering = signals.steering_wheel_angle is not None
    rate = signals.yaw_rate is not None or signals.gyroscope is not None
    # the yaw rate may be computed from the steering, but not to confirm the steering (claim 4)
    alone = all("steering" not in g for g in config.calibration.straight.groups if "yaw_rate" in g)
    return {
        "steering": steering,
        "yaw_rate": rate or (alone and steering and has_speed),
        "consistency": True,
    }


def _attitude(config: _Keys) -> Iterator[Rule]:
    attitude = config.attitude
    if not attitude.enabled:  # prepared but switched off is allowed
        return
    at = "attitude"
    alone = attitude.method == "compensation"
    why = "with method: compensation"
    for key in ("squat", "grade_time"):
        yield (at, key), alone, why
    for key in (*FILTER_ONLY, "delay"):
        yield (at, "compensation", key), alone, why
    why = "with method: filter"
    yield (at, "compensation", "rate_time"), not alone, why
    idle = not alone and not attitude.compensation.send
    yield (
        (at, "compensation", "centripetal"),
        idle,
        f"{why} (which always removes the whole of omega x v)",
    )
    for key in type(attitude.filter).__struct_fields__:
        idle = alone and key not in B_READS
        yield (at, "filter", key), idle, "with method: compensation"
    source = attitude.filter.heading
    why = f"with filter.heading: {source}"
    yield (at, "filter", "heading_noise_deg"), not alone and source != "signal", why
    for key in ("magnetometer_noise_deg", "declination_deg"):
        yield (at, "filter", key), not alone and source != "magnetometer", why
    has_speed = config.signals.speed is not None or config.signals.wheel_speeds is not None
    why = "without a speed"
    for place in B_NEEDS_SPEED if alone else FILTER_NEEDS_SPEED:
        yield (at, *place), not has_speed, why
    idle = not (alone or has_speed) and attitude.compensation.send
    yield (at, "compensation", "centripetal"), idle, why


def _travel(config: _Keys) -> Iterator[Rule]:
    travel, signals = config.travel_direction, config.signals
    if not travel.enabled:
        return
    at = "travel_direction"
    yield (at, "alternative"), signals.gyroscope is None, "without signals.gyroscope"
    idle = travel.method == "alternative" and signals.gyroscope is not None
    why = "on the heading with 'method: alternative' and a gyroscope"
    for key in ("tilt_on_turn_deg", "differ_deg", "tilt_deg"):
        yield (at, "choice", key), idle, why
    idle = travel.method == "published" and signals.gyroscope is not None
    why = "on the heading with 'method: published'"
    for key in ("compass_time", "lead_deg", "memory_steps", "carry_change_deg"):
        yield (at, "alternative", key), idle, why
    yield (at, "compass"), signals.heading is None, "without signals.heading"
    why = "without signals.magnetometer"
    yield (at, "declination_deg"), signals.magnetometer is None, why
    why = "without signals.heading"
    idle = signals.heading is None and signals.gyroscope is not None
    yield (at, "alternative", "compass_time"), idle and travel.method == "alternative", why
