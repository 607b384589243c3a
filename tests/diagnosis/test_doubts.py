"""What something else that was found may make is not named beside it."""

from __future__ import annotations

import numpy as np
import pytest

from hidden import Effect, hidden_drive
from imucald.core.samples import Samples, Series
from imucald.diagnosis.cause_keys import mount_of, with_shifts
from imucald.diagnosis.diagnose import diagnose
from imucald.diagnosis.doubts import doubt, unexplained
from imucald.diagnosis.fit.blocks import EQUATIONS
from imucald.diagnosis.fit.intervals import Estimate
from imucald.diagnosis.fit.score import Hypothesis
from imucald.diagnosis.outcome import signals_of
from imucald.diagnosis.result import Diagnosis, Kind, Structure
from imucald.diagnosis.search.search import search, unsettle
from imucald.diagnosis.search.shift import FittedShift
from imucald.diagnosis.search.state import State, shift_steps
from imucald.diagnosis.search.trials import Trial
from imucald.diagnosis.signals import drive_of
from imucald.model.model import VehicleModel, model_from_mapping

SEED = 160_031
MINUTES = 12.0


def diagnosed(change=None, *effects: str) -> Diagnosis:
    made = hidden_drive(SEED, tuple(Effect(e, "large") for e in effects), MINUTES)
    samples: Samples = made.samples if change is None else change(dict(made.samples))
    return diagnose([samples], model_from_mapping(dict(made.model), "b"))


def clipped(samples: dict[str, Series]) -> dict[str, Series]:
    accel = samples["accel"]
    x = accel.values.copy()
    middle = np.median(x, axis=0)
    axis = int(np.argmin(np.abs(middle)))
    reach = float(np.quantile(np.abs(x[:, axis] - middle[axis]), 0.98))
    x[:, axis] = np.clip(x[:, axis], middle[axis] - reach, middle[axis] + reach)
    return {**samples, "accel": Series(accel.t, x)}


def names(d: Diagnosis) -> set[str]:
    return {c.name for c in d.causes}


@pytest.mark.slow
def test_a_gain_of_a_sensor_that_is_clipped_is_not_ruled_out():
    whole = diagnosed(None, "accel_scale")
    assert {"accel_scale", "accel_bias"} & (
        names(whole) | {n for s in whole.look_alikes for n in s}
    )
    d = diagnosed(clipped, "accel_scale")
    assert "saturation" in names(d)
    assert not {"accel_scale", "accel_bias"} & (names(d) | {c.name for c in d.likely})
    assert {c.outcome for c in d.candidates if c.name in ("accel_scale", "accel_bias")} >= {
        "not ruled out"
    }


@pytest.mark.slow
def test_stamps_that_run_off_are_no_delay_besides():
    def running(samples: dict[str, Series]) -> dict[str, Series]:
        made = dict(samples)
        for name in ("accel", "gyro"):
            t = samples[name].t
            made[name] = Series(t[0] + (t - t[0]) * (1.0 + 2e-3), samples[name].values)
        return made

    d = diagnosed(running)
    assert "clock_drift" in names(d)
    assert not {"signal_delay", "delay_rate"} & (names(d) | {c.name for c in d.likely})


def with_a_drift(pull: float, nats: float = 20.0) -> tuple[State, Trial]:
    one = np.ones(1)
    e = Estimate(one, 0.1 * one, 3.0, pull, 0.0 * one)
    h = Hypothesis("accel_bias_drift", ("accel.bias.x",), pattern=np.ones(4))
    range_of = np.array([[-1.0, 1.0]])
    drift = Trial(h, e, np.ones(4), nats, 0.1 * one, range_of, 8.0, 2.0, 0.1 * one, np.arange(4))
    model = VehicleModel()
    return State((), model, model, {}, changes={"accel.bias.x": 0.3}, named=[drift]), drift


def test_a_drift_that_is_doubted_is_not_ruled_out_and_moves_nothing():
    state, drift = with_a_drift(5.0)
    unsettle(state, [drift].__contains__)
    assert state.named == []
    assert state.doubtful == [drift]
    assert state.changes == {"accel.bias.x": 0.3}


@pytest.mark.parametrize("kind", [Kind.GOES_WITH_ANOTHER, Kind.UNEVEN])
def test_beside_anything_that_is_left_no_fit_names_a_cause(kind):
    state, drift = with_a_drift(5.0)
    doubt(state, [Structure("accel_x", kind, 2.0, "", "speed.scale")], [])
    assert state.named == []
    assert state.doubtful == [drift]


@pytest.mark.parametrize(
    ("kind", "stands"), [(Kind.WANDERS, True), (Kind.GOES_WITH_ANOTHER, False)]
)
def test_a_moved_mount_is_not_ruled_out_beside_what_no_turn_leaves(kind, stands):
    """After a turn by 10 deg zeros and gains seem to wander: it is followed to first order."""
    model, one = VehicleModel(), np.ones(3)
    shift = FittedShift("step", 300.0, 0.1 * one, 0.01 * one, 3.0, one, 50.0, 270.0, 300.0)
    state = State((), model, with_shifts(model, shift_steps(shift)), {}, shift=shift)
    doubt(state, [Structure("accel_x", kind, 2.0, "", "accel.bias.x")], [])
    assert (state.shift is shift) == stands
    assert (state.doubtful_shift is shift) != stands
    assert bool(state.model.mount.shifts) == stands


@pytest.mark.parametrize("kind", [None, Kind.WANDERS])
def test_what_is_only_likely_stands_where_nothing_is_left(kind):
    state, drift = with_a_drift(5.0)
    state.named, state.likely = [], [drift]
    left = [] if kind is None else [Structure("accel_x", kind, 2.0, "", "speed.scale")]
    doubt(state, left, [])
    stands = kind is None
    assert (state.likely == [drift], state.doubtful == [drift]) == (stands, not stands)


@pytest.mark.parametrize(("wanders", "stands"), [("speed.scale", True), ("accel.bias.x", False)])
def test_beside_a_wander_stands_what_is_not_of_the_same_parameter(wanders, stands):
    state, drift = with_a_drift(5.0)
    doubt(state, [Structure("accel_x", Kind.WANDERS, 2.0, "", wanders)], [])
    assert (state.named == [drift]) == stands


@pytest.mark.parametrize(("nats", "stands"), [(52.0, False), (54.0, True)])
@pytest.mark.parametrize("pull", [5.0, 8.0])
def test_beside_what_cannot_be_stands_what_is_named_without_all_that_it_explains(
    pull, nats, stands
):
    """Both on data that no fit saw: sqrt(20) + sqrt(8), which it takes to name it, is sqrt(53.3).
    How far the fit is pulled in sample is no measure of it."""
    state, drift = with_a_drift(pull, nats)
    state.implausible.append(with_a_drift(pull)[1])
    doubt(state, [Structure("accel_x", Kind.NOT_PLAUSIBLE, 2.0, "")], [])
    assert (state.named == [drift]) == stands


@pytest.mark.slow
def test_what_is_certain_of_the_speed_stays_certain_where_the_accelerometer_is_unexplained():
    """The wheels show 1.5 % less than the speed, and the sensor swings as nothing explains."""

    def wrong(samples: dict[str, Series]) -> dict[str, Series]:
        accel, wheels = samples["accel"], samples["wheel_speeds"]
        swings = np.sin(0.7 * accel.t) * np.sin(0.013 * accel.t)
        loose = accel.values + np.outer(swings, [0.6, 0.7, 0.0])
        return {
            **samples,
            "accel": Series(accel.t, loose),
            "wheel_speeds": Series(wheels.t, 0.985 * wheels.values),
        }

    d = diagnosed(wrong)
    scale = next(c for c in d.causes if c.name == "wheels_against_speed")
    p = scale.parameters["wheel_speeds.scale"]
    assert p.value - p.stated == pytest.approx(-0.015, abs=0.002)
    assert names(d) == {"wheels_against_speed"}
    assert d.verdict == d.signals["accel_y"].verdict == "unknown"
    assert d.signals["speed"].verdict in ("found", "ambiguous")
    assert d.signals["yaw_rate"].verdict == "nothing"


@pytest.mark.parametrize(
    ("signal", "rest"),
    [
        ("accel_y", {"speed"}),
        ("gyro", {"speed", "lateral_accel", "longitudinal_accel"}),
        ("speed", {"accel_z", "gyro_x", "gyro_y", "gyro_z", "lateral_accel",
                   "longitudinal_accel"}),
        ("steering", set(EQUATIONS) - {"yaw_rate"}),
    ],
)  # fmt: skip
def test_what_is_unexplained_leaves_the_equations_that_do_not_take_it(signal, rest):
    assert set(EQUATIONS) - unexplained([Structure(signal, Kind.UNEVEN, 2.0, "")]) == rest


@pytest.mark.slow
def test_a_cause_that_other_equations_show_by_themselves_stands_beside_an_unexplained_speed():
    made = hidden_drive(SEED, (Effect("gyro_bias", "large"),), MINUTES)
    samples = {k: s for k, s in made.samples.items() if k in ("accel", "gyro", "speed")}
    model = model_from_mapping(dict(made.model), "b")
    state = State([drive_of(samples)], model, model, {})
    search(state, lambda _: None, lambda: False)
    assert {t.hypothesis.name for t in state.named} == {"gyro_bias"}
    assert signals_of(state.table, ["gyro.bias.x"]) == ("accel_x", "accel_y")
    true = mount_of(model) @ [made.truth["gyro_bias"][f"gyro.bias.{i}"] for i in range(3)]
    doubt(state, [Structure("speed", Kind.GOES_WITH_ANOTHER, 2.0, "")], [])
    assert {t.hypothesis.name for t in state.named} == {"gyro_bias"}
    assert [state.model.gyro.bias @ mount_of(model)[i] for i in (0, 1)] == pytest.approx(
        true[:2], abs=1e-3
    )
    assert "gyro.bias.z" not in state.changes, "only forces show it"
