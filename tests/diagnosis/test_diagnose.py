"""Effects hidden by the second generator are found; where there is none, nothing is said."""

import math
from dataclasses import replace

import numpy as np
import pytest

from hidden import CAUSES, OUTSIDE, Effect, hidden_drive
from imucald.core.errors import EstimateError
from imucald.diagnosis.cause import Cause, Parameter, catalogue
from imucald.diagnosis.diagnose import diagnose
from imucald.diagnosis.result import GOES_AGAINST, Structure
from imucald.diagnosis.roads import find_roads
from imucald.diagnosis.verdict import verdict_of
from imucald.model.model import model_from_mapping
from imucald.simulation import load_model

pytestmark = pytest.mark.slow

MINUTES = 16.0
FIRST_SEED = 800_000


def _diagnosed(seed, *effects, minutes=MINUTES):
    drive = hidden_drive(seed, effects, minutes)
    return drive, diagnose([drive.samples], model_from_mapping(dict(drive.model), "baseline"))


def _names(diagnosis):
    return [cause.name for cause in diagnosis.causes]


@pytest.mark.parametrize("cause", CAUSES)
def test_a_large_hidden_effect_is_named(cause):
    seed = FIRST_SEED + CAUSES.index(cause)
    drive, diagnosis = _diagnosed(seed, Effect(cause, "large"))
    alike = {name for names in diagnosis.look_alikes if cause in names for name in names}
    assert cause in _names(diagnosis) or alike & set(_names(diagnosis))
    assert diagnosis.verdict in ("found", "ambiguous")
    for found in diagnosis.causes:
        if found.name != cause:
            continue
        for key, estimate in found.parameters.items():
            true = drive.parameters.get(key)
            if true is not None and cause not in ("mount_rotation", "mount_shift"):
                assert abs(estimate.value - true) < 6.0 * estimate.std + 1e-9, key
    touched = {signal for found in diagnosis.causes for signal in found.signals}
    for name in touched & set(diagnosis.signals):
        residual = diagnosis.signals[name]
        assert residual.rms_after < 1.2 * residual.noise_floor, name


def test_what_is_faulty_is_in_the_residual_before_and_not_in_the_one_after():
    _, diagnosis = _diagnosed(FIRST_SEED + 330, Effect("saturation", "large"))
    (cause,) = diagnosis.causes
    worst = max((diagnosis.signals[s] for s in cause.signals), key=lambda s: s.rms_before)
    assert worst.rms_before > 1.3 * worst.noise_floor
    assert worst.rms_after < 1.1 * worst.noise_floor


@pytest.mark.parametrize("seed", range(FIRST_SEED + 100, FIRST_SEED + 104))
def test_a_drive_that_the_model_describes_gives_nothing(seed):
    _, diagnosis = _diagnosed(seed)
    assert diagnosis.verdict == "nothing"
    assert diagnosis.causes == ()
    assert diagnosis.gain.held_out_log_likelihood == 0.0
    assert diagnosis.model_after == diagnosis.model_before


@pytest.mark.parametrize("effect", OUTSIDE)
def test_what_the_catalogue_lacks_is_unknown_and_shown(effect):
    _, diagnosis = _diagnosed(FIRST_SEED + 200 + OUTSIDE.index(effect), Effect(effect, "large"))
    assert diagnosis.verdict == "unknown" or diagnosis.structure
    assert diagnosis.structure


def test_two_effects_are_both_named_and_the_extended_model_holds_both(tmp_path):
    drive, diagnosis = _diagnosed(
        FIRST_SEED + 300, Effect("steering_offset", "large"), Effect("squat_dive", "large")
    )
    assert set(_names(diagnosis)) == {"steering_offset", "squat_dive"}
    path = tmp_path / "extended.yaml"
    path.write_text(diagnosis.model_after.to_yaml(), encoding="utf-8")
    model = load_model(path)
    assert model.steering.offset == pytest.approx(drive.parameters["steering.offset"], rel=0.1)
    assert model.suspension.squat_gradient == pytest.approx(
        drive.parameters["suspension.squat_gradient"], rel=0.1
    )
    touched = diagnosis.signals["yaw_rate"]
    assert touched.rms_after < 0.5 * touched.rms_before
    assert touched.rms_after < 1.15 * touched.noise_floor
    assert diagnosis.gain.interval[0] > 0.0


def test_several_drives_of_one_vehicle_serve_as_held_out_data():
    effect = Effect("steering_ratio", "large", None)
    drives = [hidden_drive(FIRST_SEED + 310, (effect,), minutes) for minutes in (8.0, 9.0)]
    model = model_from_mapping(dict(drives[0].model), "baseline")
    diagnosis = diagnose([drive.samples for drive in drives], model)
    assert _names(diagnosis) == ["steering_ratio"]
    assert diagnosis.duration_s == pytest.approx(17.0 * 60.0, rel=0.02)


def test_progress_moves_on_and_the_json_is_plain():
    drive = hidden_drive(FIRST_SEED + 320, (Effect("yaw_rate_scale", "large"),), 10.0)
    steps = []
    diagnosis = diagnose(
        [drive.samples],
        model_from_mapping(dict(drive.model), "baseline"),
        lambda share, text: steps.append((share, text)),
    )
    shares = [share for share, _ in steps]
    assert shares == sorted(shares)
    assert any("yaw_rate_scale" in text for _, text in steps)
    said = diagnosis.as_json()

    def finite(x):
        if isinstance(x, dict):
            return all(finite(v) for v in x.values())
        if isinstance(x, list):
            return all(finite(v) for v in x)
        return not isinstance(x, float) or math.isfinite(x)

    assert finite(said)
    assert said["verdict"] == "found"
    assert {"value", "std", "unit"} == set(next(iter(said["causes"][0]["parameters"].values())))


def test_no_drive_is_refused():
    drive = hidden_drive(FIRST_SEED + 330, (), 2.0)
    with pytest.raises(EstimateError):
        diagnose([], model_from_mapping(dict(drive.model), "baseline"))


def test_a_new_module_in_the_folder_is_a_candidate(tmp_path, monkeypatch):
    from imucald.diagnosis import causes

    (tmp_path / "squeak.py").write_text(
        "from imucald.diagnosis.cause import Cause, Parameter\n"
        "class Squeak(Cause):\n"
        "    name = 'squeak'\n"
        "    parameters = (Parameter('_squeak', 'm/s^2', 0.01, 0.2, 0.01),)\n"
        "    signals = ('accel_z',)\n"
        "    def offset(self, s, p):\n"
        "        s.accel[2] += p['_squeak']\n",
        encoding="utf-8",
    )
    monkeypatch.setattr(causes, "__path__", [*causes.__path__, str(tmp_path)])
    catalogue.cache_clear()
    try:
        found = {cause.name: cause for cause in catalogue()}
    finally:
        catalogue.cache_clear()
    assert isinstance(found["squeak"], Cause)
    assert isinstance(found["squeak"].parameters[0], Parameter)


def test_a_rough_road_is_not_taken_for_a_shift_as_well():
    _, diagnosis = _diagnosed(900_036, Effect("road_grade", "large"), minutes=21.4)
    assert _names(diagnosis) == ["road_grade"]


def test_the_road_is_measured_where_both_sensors_see_it():
    from imucald.diagnosis.causes.mount_shift import TIME
    from imucald.diagnosis.forward import Forward
    from imucald.diagnosis.grid import track_from_samples

    drive = hidden_drive(FIRST_SEED + 340, (Effect("road_bank", "medium"),), MINUTES)
    model = model_from_mapping(dict(drive.model), "baseline")
    forward = Forward(track_from_samples(drive.samples), model, catalogue())
    roads = {r.cause: r for r in find_roads([forward], forward.base() | {TIME: 0.0})}
    assert roads["road_bank"].rms == pytest.approx(drive.parameters["road.bank_rms"], rel=0.15)
    assert roads["road_grade"].rms == pytest.approx(drive.parameters["road.grade_rms"], rel=0.25)
    assert roads["road_bank"].score > 10.0
    assert roads["road_grade"].score < 0.0


LEFT = Structure("accel_y", "bursts", 9.0, "it bursts")


@pytest.mark.parametrize(
    ("scores", "sets", "structure", "verdict"),
    [
        ({}, [], [], "nothing"),
        ({}, [], [LEFT], "unknown"),
        ({"a": 9.0}, [], [LEFT], "found"),
        ({"a": 9.0}, [("a", "b")], [], "ambiguous"),
        ({"a": 9.0}, [], [replace(LEFT, kind=GOES_AGAINST)], "unknown"),
    ],
)
def test_verdicts(scores, sets, structure, verdict):
    assert verdict_of(scores, sets, structure) == verdict


def test_a_standing_vehicle_is_refused_with_the_reason():
    drive = hidden_drive(FIRST_SEED + 350, (), 4.0)
    still = dict(drive.samples)
    for name in ("speed", "steering", "yaw_rate"):
        series = still[name]
        still[name] = type(series)(series.t, np.zeros_like(series.values))
    with pytest.raises(EstimateError, match="s of driving"):
        diagnose([still], model_from_mapping(dict(drive.model), "baseline"))


@pytest.mark.parametrize("signal", ["yaw_rate", "gyro"])
def test_a_wrong_sign_is_unknown_and_told_and_no_parameter_is_fitted_to_it(signal):
    drive = hidden_drive(FIRST_SEED + 351, (), 8.0)
    turned = drive.samples[signal]
    samples = {**drive.samples, signal: type(turned)(turned.t, -turned.values)}
    diagnosis = diagnose([samples], model_from_mapping(dict(drive.model), "baseline"))
    assert diagnosis.verdict == "unknown"
    assert diagnosis.causes == ()
    assert {s.kind for s in diagnosis.structure} == {GOES_AGAINST}
    assert "gyro_z" in {s.signal for s in diagnosis.structure}
    assert all("sign" in s.text for s in diagnosis.structure)


@pytest.mark.parametrize(
    "change", [{"speed.scale": -1.0}, {"accel.bias": (1e9, 0.0, 0.0)},
               {"mount.lever_arm_m": (1e160, 0.0, 0.0)}]
)  # fmt: skip
def test_a_model_that_predicts_what_cannot_be_is_refused(change):
    drive = hidden_drive(FIRST_SEED + 352, (), 4.0)
    model = model_from_mapping(dict(drive.model), "baseline").with_changes(change)
    with pytest.raises(EstimateError, match="the model file predicts"):
        diagnose([drive.samples], model)


def test_what_the_daemon_cannot_take_out_is_a_note_and_the_diagnosis_is_kept():
    drive = hidden_drive(FIRST_SEED + 353, (Effect("steering_offset", "large"),), 10.0)
    model = model_from_mapping(dict(drive.model), "baseline")
    steep = model.with_changes({"suspension.roll_gradient": 0.07, "suspension.body_roll": True})
    diagnosis = diagnose([drive.samples], steep)
    assert diagnosis.causes
    assert diagnosis.gain.mount_error_deg_before is None
    assert any("roll_gradient" in note for note in diagnosis.notes)


def test_a_drive_too_short_to_hold_anything_out_has_no_gain():
    drive = hidden_drive(FIRST_SEED + 354, (Effect("steering_offset", "large"),), 2.5)
    diagnosis = diagnose([drive.samples], model_from_mapping(dict(drive.model), "baseline"))
    assert "steering_offset" in _names(diagnosis)
    said = diagnosis.as_json()
    assert said["gain"]["held_out_log_likelihood"] is None
    assert said["causes"][0]["gain"]["held_out_log_likelihood"] is None
    assert any("min of driving" in note for note in diagnosis.notes)
