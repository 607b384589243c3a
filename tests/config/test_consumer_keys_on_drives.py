"""Keys of methods B, C and D on a drive and a walk: each has an effect, or `check` says not.

The motion is from no code of the package. Each key is changed alone, with and without each signal.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import gait
from imucald.attitude.compensated import CompensatedAttitude
from imucald.attitude.estimate import AttitudeEstimate
from imucald.attitude.filter import AttitudeFilter
from imucald.config import LoadedConfig, parse_config
from imucald.config.attitude import AttitudeSettings, TravelDirectionSettings
from imucald.travel_direction.direction import TravelDirection

RATE = 20.0
RESTS_S = 33.0
EARTH_FIELD = np.array([20e-6, 0.0, -44e-6])  # north, west, up

ATTITUDE: dict[str, Any] = {
    "squat": 0.004,
    "grade_time": 5.0,
    "compensation.average": 0.6,
    "compensation.interval": 0.4,
    "compensation.timeout": 1.5,
    "compensation.delay": 0.2,
    "compensation.lever_arm": [1.0, 0.5, -0.3],
    "compensation.speed_is": "horizontal",
    "compensation.centripetal": "plane",
    "compensation.rate_time": 1.0,
    "compensation.speed_noise": 0.3,
    "compensation.speed_scale": 0.2,
    "compensation.creep_speed": 0.0,
    "compensation.lever_uncertainty": 5.0,
    "filter.heading": "free",
    "filter.declination_deg": 10.0,
    "filter.check": 10.0,
    "filter.check_level": True,
    "filter.start": 2.0,
    "filter.longest_step": 0.07,
    "filter.rest_update": False,
    "filter.rest_accel_spread": 0.01,
    "filter.rest_gyro_spread_deg_s": 0.01,
    "filter.gyro_resolution_deg_s": 0.5,
    "filter.gyro_noise_deg_s": 0.1,
    "filter.gyro_start_deg_s": 0.05,
    "filter.gyro_random_deg_s": 0.1,
    "filter.gyro_random_time": 30.0,
    "filter.gyro_gain": 0.1,
    "filter.gyro_scale": 0.05,
    "filter.accel_noise": 0.2,
    "filter.accel_random": 0.3,
    "filter.accel_random_time": 30.0,
    "filter.unknown_motion": 3.0,
    "filter.heading_noise_deg": 10.0,
    "filter.magnetometer_noise_deg": 2.0,
    "filter.gate": 0.5,
}
"""For each key one value far from its default."""
FRAMES_ONLY = ("rate", "compensation.send")
"""How often, and whether, frames are sent."""
TRAVEL: dict[str, Any] = {
    "convention": "gravity",
    "compass": "counter_clockwise",
    "declination_deg": 10.0,
    "steps.shortest": 0.6,
    "steps.longest": 0.5,
    "steps.threshold": 2.5,
    "steps.corner_hz": 1.0,
    "steps.gravity_time": 0.5,
    "choice.turn_deg": 1.0,
    "choice.tilt_on_turn_deg": 60.0,
    "choice.differ_deg": 1.0,
    "choice.tilt_deg": 60.0,
    "alternative.gravity_time": 1.0,
    "alternative.compass_time": 5.0,
    "alternative.lead_deg": -60.0,
    "alternative.memory_steps": 5.0,
    "alternative.carry_change_deg": 0.5,
}
DRIVES = (
    ("filter", "free", ()),
    ("filter", "free", ("speed",)),
    ("filter", "signal", ()),
    ("filter", "signal", ("speed",)),
    ("filter", "magnetometer", ()),
    ("filter", "magnetometer", ("speed",)),
    ("compensation", "free", ()),
    ("compensation", "free", ("speed",)),
)
"""Method, source of the heading, signals that are missing."""
WALKS = tuple(
    (method, lacks)
    for method in ("alternative", "published")
    for lacks in (
        ("heading",),
        ("magnetometer",),
        ("heading", "gyroscope"),
        ("magnetometer", "gyroscope"),
    )
)
SIGNALS: dict[str, Any] = {
    "accelerometer": {"x": "A.X", "y": "A.Y", "z": "A.Z"},
    "gyroscope": {"x": "G.X", "y": "G.Y", "z": "G.Z"},
    "magnetometer": {"x": "M.X", "y": "M.Y", "z": "M.Z"},
    "speed": "V.V",
    "heading": "H.H",
    "reverse": "R.R",
}
Array = NDArray[np.float64]
Event = tuple[float, str, list[float]]


def keys(kind: type[msgspec.Struct]) -> set[str]:
    found = set()
    for field in msgspec.structs.fields(kind):
        if isinstance(field.type, type) and issubclass(field.type, msgspec.Struct):
            found |= {f"{field.encode_name}.{inner}" for inner in keys(field.type)}
        else:
            found.add(field.encode_name)
    return found


@cache
def drive() -> list[Event]:
    """A rest, hills and bends with a stop, then reverse.

    The speed is silent for 4.5 s once, and the gyroscope for 0.4 s.
    """
    t = np.arange(0.0, 110.0, 1.0 / RATE)

    def speed(t: Array) -> Array:
        moving = np.clip(t - RESTS_S, 0.0, None)
        v = 9.0 * (1.0 - np.exp(-moving / 3.0)) + 5.0 * np.sin(0.5 * moving) * (moving > 0.0)
        back = 3.0 * np.clip((t - 95.0) / 5.0, 0.0, 1.0)
        return np.asarray(np.clip(v, 0.0, None) * (t < 85.0) - back)

    def attitude(t: Array) -> Rotation:
        s = np.clip(t - RESTS_S, 0.0, None)
        s = s * s / (s + 4.0)
        angles = 0.8 * np.sin(0.11 * s) + 0.3 * s, 0.06 * np.sin(0.3 * s), 0.04 * np.sin(0.5 * s)
        return Rotation.from_euler("ZYX", np.column_stack(angles))

    h, ahead, rng = 1e-4, [1.0, 0.0, 0.0], np.random.default_rng(4)
    R, then = attitude(t), attitude(t + h)
    rate = (R.inv() * then).as_rotvec() / h + rng.normal(0.0, 0.001, (len(t), 3)) + 0.004
    gained = then.apply(ahead) * speed(t + h)[:, None] - R.apply(ahead) * speed(t)[:, None]
    force = R.inv().apply(gained / h + [0.0, 0.0, 9.80665]) + rng.normal(0.0, 0.01, (len(t), 3))
    mag = R.inv().apply(EARTH_FIELD)
    heading = -np.unwrap(R.as_euler("ZYX")[:, 0]) + rng.normal(0.0, 0.05, len(t))
    out: list[Event] = []
    for k, at in enumerate(t.tolist()):
        v = float(speed(np.array([at]))[0])
        if k % 4 == 0 and not 58.0 < at < 62.5:
            heard = at + 0.01 * float(rng.random())  # no limit of an interval is met exactly
            out += [(heard, "reverse", [float(v < 0.0)]), (heard, "speed", [abs(v)])]
        if k % 10 == 0:
            out.append((at, "heading", [float(heading[k]) % math.tau]))
        if not 70.0 < at < 70.4:
            out.append((at, "gyro", rate[k].tolist()))
        out += [(at, "mag", mag[k].tolist()), (at, "accel", force[k].tolist())]
    return out


@cache
def walk(with_heading: bool) -> list[Event]:
    """Half a minute with turns, the terminal tilted."""
    made = gait.walk(gait.Carrying("leaning", (30.0, 15.0, 0.0), 1.5, 2.0), seconds=40.0, seed=2)
    out: list[Event] = []
    for k, t in enumerate(made.t.tolist()):
        if with_heading:
            out.append((t, "heading", [float(made.course[k]) % math.tau]))
        else:
            out.append((t, "mag", made.mag[k].tolist()))
        out += [(t, "gyro", made.gyro[k].tolist()), (t, "accel", made.accel[k].tolist())]
    return out


def loaded(section: str, keys: dict[str, Any], lacks: tuple[str, ...]) -> LoadedConfig:
    signals = {name: source for name, source in SIGNALS.items() if name not in lacks}
    data: dict[str, Any] = {"database": "b.dbc", "signals": signals, section: {"enabled": True}}
    for key, value in keys.items():
        *parents, last = key.split(".")
        place = data[section]
        for parent in parents:
            place = place.setdefault(parent, {})
        place[last] = value
    return parse_config(yaml.safe_dump(data))


def is_reported(made: LoadedConfig, key: str) -> bool:
    """Whether the key or a section above it is said to have no effect."""
    parts = key.split(".")
    places = {".".join(parts[: i + 1]) for i in range(1, len(parts))}
    return any(f"{place}: has no effect" in line for place in places for line in made.idle_keys())


def numbers(estimate: AttitudeEstimate) -> list[float]:
    """All that is sent, without the rounding of sums taken in another order."""
    e = estimate
    values = [e.state, e.roll, e.pitch, e.heading, e.grade, e.grade_std, *e.std, *e.rate]
    return [round(float(x), 9) for x in (*values, *e.rate_std, *e.bias, *e.free_acceleration)]


def driven(keys: dict[str, Any], lacks: tuple[str, ...]) -> str:
    """What the attitude is at every tenth sample."""
    settings = loaded("attitude", keys, lacks).config.attitude
    made = CompensatedAttitude if settings.method == "compensation" else AttitudeFilter
    attitude, out = made(settings), []
    for k, (t, channel, values) in enumerate(drive()):
        if channel in lacks:
            continue
        if channel in ("gyro", "accel", "mag"):
            getattr(attitude, channel)(t, values)
        elif channel == "reverse":
            attitude.reverse(values[0] > 0.5)
        else:
            getattr(attitude, channel)(t, values[0])
        if k % 10 == 0 and attitude.running:
            out.append((attitude.checked, numbers(attitude.estimate(t))))
    return str(out)  # NaN is not equal to itself


def walked(keys: dict[str, Any], lacks: tuple[str, ...]) -> list[tuple[float | None, bool]]:
    """Heading of each step, and whether it is a turn."""
    settings = loaded("travel_direction", keys, lacks).config.travel_direction
    travel, out = TravelDirection(settings), []
    for t, channel, values in walk("magnetometer" in lacks):
        if channel == "gyro" and "gyroscope" in lacks:
            continue
        step = travel.sample(t, channel, values)
        if step is not None:
            is_turn = step.published is not None and step.published.is_turn
            out.append((step.heading, is_turn))
    return out


plain_drive = cache(lambda *case: driven(of_drive(*case), case[2]))
plain_walk = cache(lambda method, lacks: walked({"method": method}, lacks))


def of_drive(method: str, heading: str, lacks: tuple[str, ...]) -> dict[str, Any]:
    source = {"filter.heading": heading} if heading != "free" else {}
    return {"method": method, "compensation.send": True, **source}


def test_every_key_of_methods_b_c_and_d_has_a_value() -> None:
    assert keys(AttitudeSettings) - {"enabled", "method", *FRAMES_ONLY} == set(ATTITUDE)
    assert keys(TravelDirectionSettings) - {"enabled", "method"} == set(TRAVEL)


@pytest.mark.slow
@pytest.mark.parametrize("key", ATTITUDE)
def test_a_key_of_the_attitude_has_an_effect_on_each_drive_or_is_reported(key: str) -> None:
    for case in DRIVES:
        keys = of_drive(*case) | {key: ATTITUDE[key]}
        if keys == of_drive(*case) | {"filter.heading": "free"} and case[0] == "filter":
            continue  # the default
        reported = is_reported(loaded("attitude", keys, case[2]), f"attitude.{key}")
        changes = driven(keys, case[2]) != plain_drive(*case)
        assert changes != reported, case


@pytest.mark.slow
@pytest.mark.parametrize("key", TRAVEL)
def test_a_key_of_the_direction_has_an_effect_on_each_walk_or_is_reported(key: str) -> None:
    for method, lacks in WALKS:
        keys = {"method": method, key: TRAVEL[key]}
        made = loaded("travel_direction", keys, lacks)
        reported = is_reported(made, f"travel_direction.{key}")
        assert (walked(keys, lacks) != plain_walk(method, lacks)) != reported, (method, lacks)
