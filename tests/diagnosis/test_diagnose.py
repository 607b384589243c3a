"""From samples to verdict, on drives of the second generator with effects hidden in them."""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest

from hidden import Effect, hidden_drive
from imucald.core.errors import EstimateError
from imucald.core.samples import Series
from imucald.diagnosis.diagnose import diagnose
from imucald.diagnosis.result import Diagnosis, Kind
from imucald.model.model import model_from_mapping

MINUTES = 15.0
SEED = 5_000
pytestmark = pytest.mark.slow


@cache
def drive(cause: str = "", size: str = "large", form: str | None = None):
    effects = (Effect(cause, size, form),) if cause else ()
    return hidden_drive(SEED, effects, MINUTES)


@cache
def diagnosed(cause: str = "", size: str = "large", form: str | None = None) -> Diagnosis:
    made = drive(cause, size, form)
    return diagnose([made.samples], model_from_mapping(dict(made.model), "baseline"))


def names(d: Diagnosis) -> set[str]:
    return {c.name for c in d.causes} | {n for group in d.look_alikes for n in group}


def test_an_honest_model_file_is_left_alone():
    d = diagnosed()
    assert d.verdict == "nothing"
    assert d.model_after.with_changes({"leaves": {}}) == d.model_before
    assert not d.recommended


@pytest.mark.parametrize(("cause", "form"), [
    ("accel_bias", None), ("steering_offset", None), ("yaw_rate_scale", None),
    ("signal_delay", "speed"), ("mount_shift", None), ("wheel_speed_scale", None),
    ("saturation", "accel"), ("dropouts", "accel"),
])  # fmt: skip
def test_a_large_effect_is_named(cause, form):
    d = diagnosed(cause, "large", form)
    assert d.verdict in {"found", "ambiguous"}
    assert cause in names(d)
    for one in d.causes:
        if "threshold" in one.evidence:
            assert one.evidence["beyond_tolerance"] > one.evidence["threshold"], one.name


def test_the_value_that_is_reported_is_the_one_that_was_hidden():
    d, true = diagnosed("steering_offset"), drive("steering_offset").parameters["steering.offset"]
    (cause,) = [c for c in d.causes if c.name == "steering_offset"]
    p = cause.parameters["steering.offset"]
    assert p.value == pytest.approx(true, abs=cause.evidence["quantile"] * p.std + p.tolerance)
    assert d.model_after.steering.offset == pytest.approx(p.value)


def test_the_written_file_alone_brings_what_is_reported():
    """The extended file, put to the test by itself, starts where the page said that it ends."""
    d = diagnosed("steering_offset")
    assert d.recommended
    again = diagnose([drive("steering_offset").samples], d.model_after)
    assert "steering_offset" not in names(again)
    for name, s in again.signals.items():
        assert s.rms_before == pytest.approx(d.signals[name].rms_after, rel=0.01)
    gained = d.signals["yaw_rate"]
    assert gained.rms_after < 0.6 * gained.rms_before


def test_a_second_log_is_held_to_what_the_file_says_of_itself():
    after = diagnosed("steering_offset").model_after
    assert 0.0 < after.known_to["steering.offset"] <= 0.0123


def test_a_value_that_cannot_be_is_unknown_and_not_named():
    """A speed that reads a third too much beside right wheels is no tyre."""
    made = drive()
    samples = dict(made.samples)
    samples["speed"] = Series(samples["speed"].t, 1.33 * samples["speed"].values)
    d = diagnose([samples], model_from_mapping(dict(made.model), "baseline"))
    assert "wheel_speed_scale" not in {c.name for c in d.causes}
    assert d.verdict == "unknown"


def test_a_wrong_sign_is_stated_first_and_nothing_is_fitted_to_it():
    made = drive()
    samples = dict(made.samples)
    samples["yaw_rate"] = Series(samples["yaw_rate"].t, -samples["yaw_rate"].values)
    d = diagnose([samples], model_from_mapping(dict(made.model), "baseline"))
    assert d.verdict == "unknown"
    assert d.causes == ()
    assert {s.kind for s in d.structure} == {Kind.GOES_AGAINST}


@pytest.mark.parametrize("cause", ["trailer_sway", "sloshing_load"])
def test_what_the_catalogue_lacks_is_unknown(cause):
    d = diagnosed(cause)
    assert d.verdict == "unknown"
    assert any(s.signal in {"accel_y", "yaw_rate"} for s in d.structure)


def test_a_time_limit_ends_in_an_honest_verdict():
    made = drive("accel_bias")
    d = diagnose([made.samples], model_from_mapping(dict(made.model), "b"), limit_s=0.0)
    assert not d.complete
    assert "time limit" in " ".join(d.notes)
    assert {c.name for c in d.causes} == set()


def test_the_time_that_is_allowed_goes_by_the_hours_of_driving(monkeypatch):
    monkeypatch.setattr("imucald.diagnosis.diagnose.LIMIT_S_PER_H", 0.0)
    monkeypatch.setattr("imucald.diagnosis.diagnose.LEAST_LIMIT_S", 0.0)
    made = drive("accel_bias")
    model = model_from_mapping(dict(made.model), "b")
    assert not diagnose([made.samples], model).complete
    monkeypatch.setattr("imucald.diagnosis.diagnose.LIMIT_S_PER_H", 1e6)
    assert diagnose([made.samples], model).complete


def test_the_json_is_plain_and_progress_shows_what_it_does():
    told = []
    made = drive("dropouts", "large", "accel")
    d = diagnose([made.samples], model_from_mapping(dict(made.model), "b"),
                 lambda share, text: told.append((share, text)))  # fmt: skip
    result = json.loads(json.dumps(d.as_json(), allow_nan=False))
    assert set(result) >= {"verdict", "causes", "likely", "look_alikes", "signals", "gain",
                           "structure", "candidates", "notes", "complete"}  # fmt: skip
    shares = [share for share, _ in told]
    assert shares == sorted(shares)
    assert len({text for _, text in told}) >= 6
    for picture in d.pictures:
        assert len(picture.measured) == len(picture.predicted_after) == len(picture.t)


@pytest.mark.parametrize("absent", ["accel", "speed"])
def test_what_is_needed_is_named(absent):
    made = drive()
    samples = {k: v for k, v in made.samples.items() if k != absent}
    with pytest.raises(EstimateError, match=absent):
        diagnose([samples], model_from_mapping(dict(made.model), "b"))


def test_less_than_a_minute_is_refused():
    made = drive()
    short = {k: Series(s.t[s.t < 40.0], s.values[s.t < 40.0]) for k, s in made.samples.items()}
    with pytest.raises(EstimateError, match="at least 45 s"):
        diagnose([short], model_from_mapping(dict(made.model), "b"))


def test_without_a_gyroscope_no_scale_and_no_bias_is_named():
    made = drive("accel_scale")
    samples = {k: v for k, v in made.samples.items() if k not in {"gyro", "yaw_rate"}}
    d = diagnose([samples], model_from_mapping(dict(made.model), "b"))
    assert not {"accel_scale", "wheel_speed_scale", "accel_bias"} & names(d)
    assert any("There is no gyroscope" in note for note in d.notes)


def test_several_drives_are_one_vehicle():
    first, second = drive(), hidden_drive(SEED + 1, (), 6.0)
    base = model_from_mapping(dict(first.model), "b")
    d = diagnose([first.samples, dict(first.samples)], base)
    assert d.duration_s == pytest.approx(2 * diagnosed().duration_s, rel=0.01)
    assert np.isfinite(second.t[-1])


def test_gusts_on_the_sensor_alone_are_unknown_and_no_fit_is_believed():
    made = drive("steering_offset")
    samples, rng = dict(made.samples), np.random.default_rng(3)
    t = samples["accel"].t
    seconds = np.arange(int(t[-1]) + 2)
    push = np.interp(t, seconds, rng.normal(0.0, 0.5, len(seconds)))
    sideways = made.R_vehicle_from_sensor[1]
    samples["accel"] = Series(t, samples["accel"].values + push[:, None] * sideways)
    d = diagnose([samples], model_from_mapping(dict(made.model), "b"))
    assert d.verdict == "unknown"
    assert Kind.TOO_MUCH in {s.kind for s in d.structure}
    assert not d.causes
    assert not d.recommended
    assert d.model_after == d.model_before
    assert not d.likely
    outcomes = {c.name: c.outcome for c in d.candidates}
    assert outcomes["steering_offset"] == "not ruled out"


def test_a_sensitivity_to_the_force_is_no_zero_error_besides():
    """At rest it reads one g as a rate: that is the same cause, told once."""
    d = diagnosed("g_sensitivity")
    assert "g_sensitivity" in names(d)
    assert "gyro_bias" not in {c.name for c in d.causes}


@pytest.mark.parametrize("seed", [160_040, 160_041])
def test_three_elements_of_a_gain_are_one_cause_and_no_zero_error(seed):
    made = hidden_drive(seed, (Effect("accel_cross_axis", "large"),), 12.0)
    true = {k: x for k, x in made.truth["accel_cross_axis"].items() if abs(x) > 0.05}
    assert len(true) == 3
    d = diagnose([made.samples], model_from_mapping(dict(made.model), "baseline"))
    (cause,) = d.causes
    assert cause.name == "accel_cross_axis"
    found = {k: p.value for k, p in cause.parameters.items()}
    assert set(true) <= set(found)
    assert found == pytest.approx({k: true.get(k, 0.0) for k in found}, abs=0.02)


def test_what_falls_leaves_its_place_to_what_explains_as_much():
    """A zero of 0.25 m/s^2, taken for a gain of one axis at first, which did not stand at the end:
    then nothing was reported, with 2,000 nats unexplained."""
    made = hidden_drive(1_341_502, (Effect("accel_bias", "medium"),), 20.0)
    d = diagnose([made.samples], model_from_mapping(dict(made.model), "baseline"))
    assert "accel_bias" in {c.name for c in d.causes}.union(*d.look_alikes)


def test_a_ratio_that_is_a_third_lower_is_plausible():
    """By the slope at the stated one it would be half of it."""
    made = drive()
    true = made.parameters["chassis.steering_ratio"]
    model = model_from_mapping(dict(made.model), "baseline")
    d = diagnose([made.samples], model.with_changes({"chassis.steering_ratio": 1.5 * true}))
    (cause,) = d.causes
    assert cause.name == "steering_ratio"
    assert cause.parameters["chassis.steering_ratio"].value == pytest.approx(true, rel=0.05)
