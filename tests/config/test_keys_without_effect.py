"""A key that nothing reads is reported, with its place; a key that can never be met is an error."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
import yaml

from imucald.config import Config, parse_config
from imucald.core.errors import ConfigError
from imucald.runtime.consumers import consumers_for
from imucald.runtime.output.output_frames import OutputFrames

SIGNALS: dict[str, Any] = {
    "accelerometer": {"x": "A.X", "y": "A.Y", "z": "A.Z"},
    "gyroscope": {"x": "G.X", "y": "G.Y", "z": "G.Z"},
    "magnetometer": {"x": "M.X", "y": "M.Y", "z": "M.Z"},
    "speed": "V.V",
    "steering_wheel_angle": "S.A",
    "brake": "B.B",
    "heading": "H.H",
    "reverse": "R.R",
}


def loaded(changes: dict[str, Any], *without: str):
    """The base with keys, given as "section.part.key", set; without some of its signals."""
    signals = {name: source for name, source in SIGNALS.items() if name not in without}
    data: dict[str, Any] = {"database": "bus.dbc", "signals": signals}
    for path, value in changes.items():
        *parents, last = path.split(".")
        place = data
        for part in parents:
            place = place.setdefault(part, {})
        place[last] = value
    return parse_config(yaml.safe_dump(data))


def warnings_of(changes: dict[str, Any], *without: str) -> str:
    return "\n".join(loaded(changes, *without).idle_keys())


def keys(kind: type[msgspec.Struct], path: str) -> Iterator[tuple[str, Any]]:
    """Every key below a section, with its default."""
    for field in msgspec.structs.fields(kind):
        inner = field.type
        if isinstance(inner, type) and issubclass(inner, msgspec.Struct):
            yield from keys(inner, f"{path}.{field.encode_name}")
        else:
            yield f"{path}.{field.encode_name}", field.default


SECTIONS = ("calibration", "attitude", "travel_direction")
ALL = [
    entry
    for field in msgspec.structs.fields(Config)
    if field.name in SECTIONS
    for entry in keys(field.type, field.name)
]
READ_BY_METHOD_A = ("static", "straight", "target_angle", "method_a")


def written(path: str, default: Any) -> Any:
    """A default as it stands in a file; a key without one gets a number that all such keys take."""
    if path == "calibration.mount":
        return {"roll_deg": 1.0, "pitch_deg": 2.0, "yaw_deg": 3.0, "std_deg": 0.3}
    if path.startswith("calibration.orientation."):
        return "-z"
    if default is None or default is msgspec.NODEFAULT:
        return 0.3
    return list(default) if isinstance(default, tuple) else default


@pytest.mark.parametrize("estimator", ["joint", "published"])
@pytest.mark.parametrize(("path", "default"), ALL, ids=[path for path, _ in ALL])
def test_every_key_is_read_by_the_estimator_or_reported(
    path: str, default: Any, estimator: str
) -> None:
    """All keys, one by one, under both estimators, with every signal there."""
    if path in {"calibration.estimator", "attitude.method"}:
        return
    base = {"calibration.estimator": estimator, "attitude.enabled": True}
    text = warnings_of(base | {"travel_direction.enabled": True, path: written(path, default)})
    part = path.split(".")[1]
    if path in BEHIND_ANOTHER:
        assert text
    elif part in READ_BY_METHOD_A:
        assert bool(text) == (estimator == "joint"), text
        assert (
            not text or f"calibration.{part}: has no effect without 'estimator: published'" in text
        )
    elif path.startswith(("calibration.cross_axis", "calibration.orientation")):
        assert bool(text) == (estimator == "published")
    elif path.startswith("travel_direction.choice.") and not path.endswith(".turn_deg"):
        assert f"{path}: has no effect on the heading with 'method: alternative'" in text
    elif path.startswith("attitude.") and default is not msgspec.NODEFAULT:
        idle = path in IDLE_WITH_FILTER
        assert (f"{path}: has no effect" in text) == idle, text
    else:
        assert not text


BEHIND_ANOTHER = {
    f"calibration.straight.{key}"
    for key in (
        "steering_limit_deg",
        "consistency_window",
        "consistency_range_deg",
        "consistency_mean",
        "min_speed_without_reverse",
    )
}
"""With every signal there another recogniser, or another limit, decides."""


IDLE_WITH_FILTER = {
    "attitude.compensation.rate_time",
    "attitude.compensation.centripetal",
    "attitude.filter.heading_noise_deg",
    "attitude.filter.magnetometer_noise_deg",
    "attitude.filter.declination_deg",
}


def test_the_place_and_the_reason_are_reported() -> None:
    text = (
        "database: bus.dbc\nsignals: {accelerometer: {x: A.X, y: A.Y, z: A.Z}, speed: A.V}\n"
        "calibration:\n  straight: {steering_limit_deg: 0.001}\n"
    )
    (line,) = parse_config(text).idle_keys()
    assert line.startswith(
        "<config>:4: calibration.straight: has no effect without 'estimator: pub"
    )


@pytest.mark.parametrize(
    ("changes", "without", "place"),
    [
        ({"calibration.method_a.to_the_letter": True, "calibration.static.average_stops": True},
         (), "calibration.static.average_stops"),
        ({"calibration.straight.recognise_by": ["yaw_rate"],
          "calibration.straight.steering_limit_deg": 5.0}, (),
         "calibration.straight.steering_limit_deg"),
        ({"calibration.straight.recognise_by": ["steering", "yaw_rate"],
          "calibration.straight.steering_limit_deg": 5.0}, ("steering_wheel_angle",),
         "calibration.straight.steering_limit_deg"),
        ({"calibration.static.standstill_speed": 0.5}, ("speed",),
         "calibration.static.standstill_speed"),
        ({"calibration.method_a.level": False, "calibration.static.average_stops": True}, (),
         "calibration.static.average_stops"),
        ({"calibration.straight.min_speed": 9.0}, ("reverse",), "calibration.straight.min_speed"),
        ({"calibration.straight.yaw_rate_limit_deg_s": 9.0,
          "calibration.method_a.to_the_letter": True}, (),
         "calibration.straight.yaw_rate_limit_deg_s"),
        ({"calibration.straight.yaw_rate_limit_deg_s": 9.0,
          "calibration.straight.lateral_limit": 0.0}, (),
         "calibration.straight.yaw_rate_limit_deg_s"),
        ({"calibration.straight.yaw_rate_limit_deg_s": 9.0}, ("speed",),
         "calibration.straight.yaw_rate_limit_deg_s"),
        ({"calibration.straight.lateral_limit": 0.1}, ("speed",),
         "calibration.straight.lateral_limit"),
        ({"calibration.method_a.to_the_letter": True,
          "calibration.static.threshold_at_zero_speed": [1.0, 1.0, 1.0]}, (),
         "calibration.static.threshold_at_zero_speed"),
        ({"attitude.enabled": True, "attitude.method": "compensation",
          "attitude.compensation.delay": 0.1}, (), "attitude.compensation.delay"),
        ({"attitude.enabled": True, "attitude.method": "compensation",
          "attitude.filter.gyro_noise_deg_s": 0.02}, (), "attitude.filter.gyro_noise_deg_s"),
        ({"attitude.enabled": True, "attitude.compensation.average": 0.5}, ("speed",),
         "attitude.compensation.average"),
        ({"travel_direction.enabled": True, "travel_direction.compass": "counter_clockwise"},
         ("heading",), "travel_direction.compass"),
        ({"travel_direction.enabled": True, "travel_direction.alternative.lead_deg": 90.0},
         ("gyroscope",), "travel_direction.alternative"),
    ],
)  # fmt: skip
def test_what_other_keys_and_missing_signals_idle_is_reported(
    changes: dict[str, Any], without: tuple[str, ...], place: str
) -> None:
    base = {"calibration.estimator": "published"}
    assert f"{place}: has no effect" in warnings_of(base | changes, *without)
    if without:
        assert f"{place}: has no effect" not in warnings_of(base | changes)


@pytest.mark.parametrize(
    ("key", "value", "without", "needs"),
    [
        ("straight.recognise_by", ["steering"], ("steering_wheel_angle",),
         "signals.steering_wheel_angle"),
        ("straight.recognise_by", "all", ("steering_wheel_angle",),
         "signals.steering_wheel_angle"),
        ("straight.recognise_by", "all", ("gyroscope",), "signals.yaw_rate"),
        ("straight.recognise_by", ["yaw_rate"], ("gyroscope", "steering_wheel_angle"),
         "signals.yaw_rate"),
        ("target_angle.sign_from", ["brake"], ("brake",), "signals.brake"),
        ("target_angle.sign_from", ["speed"], ("speed",), "signals.speed"),
    ],
)  # fmt: skip
def test_what_can_never_be_met_is_an_error(
    key: str, value: Any, without: tuple[str, ...], needs: str
) -> None:
    changes = {"calibration.estimator": "published", f"calibration.{key}": value}
    with pytest.raises(ConfigError, match=rf"calibration\.{key}: .*{needs}"):
        loaded(changes, *without)
    assert loaded(changes).config is not None


@pytest.mark.parametrize("forward", ["z", "-z"])
def test_one_axis_that_points_up_and_forward_is_an_error(forward: str) -> None:
    changes = {"calibration.orientation.up": "z", "calibration.orientation.forward": forward}
    with pytest.raises(ConfigError, match=rf"orientation: up: z and .* {forward} name"):
        loaded(changes)
    assert loaded(changes | {"calibration.orientation.forward": "-x"}).config is not None


def test_shipped_and_plain_files_say_nothing() -> None:
    assert not warnings_of({})
    assert len(ALL) > 60


def test_a_heading_that_method_b_does_not_read_is_reported_and_not_asked_for() -> None:
    changes = {
        "attitude.enabled": True,
        "attitude.method": "compensation",
        "attitude.filter.heading": "signal",
    }
    config = loaded(changes, "heading")
    (line,) = config.idle_keys()
    assert "attitude.filter.heading: has no effect" in line
    assert consumers_for(config, OutputFrames(config.config))
