"""The forward model predicts what the simulation makes, and each cause changes what it should."""

from functools import cache

import numpy as np
import pytest

from hidden import CAUSES
from imucald.core.errors import EstimateError
from imucald.core.samples import Series
from imucald.diagnosis.cause import catalogue
from imucald.diagnosis.causes.mount_shift import TIME
from imucald.diagnosis.forward import Forward
from imucald.diagnosis.grid import track_from_samples
from imucald.simulation import VehicleModel, simulate

pytestmark = pytest.mark.slow

CLEAN = VehicleModel().with_changes(
    {
        "mount.roll_deg": 8.0,
        "mount.pitch_deg": -11.0,
        "mount.yaw_deg": 130.0,
        "mount.lever_arm_m": [0.6, -0.3, 0.4],
        "road.grade": False,
        "road.bank": False,
        "road.roughness": False,
        "accel.vibration": False,
        "gyro.vibration": False,
        "chassis.tyre_saturation": False,
    }
)
MINUTES, SEED = 6.0, 4

CHANGES = {
    "accel.bias.0": ("accel.bias", [0.2, 0.0, 0.0]),
    "accel.scale.1": ("accel.scale", [0.0, 0.05, 0.0]),
    "accel.cross_axis.2": ("accel.cross_axis", [0.0, 0.0, 0.04, 0.0, 0.0, 0.0]),
    "gyro.bias.2": ("gyro.bias", [0.0, 0.0, 0.01]),
    "gyro.scale.2": ("gyro.scale", [0.0, 0.0, 0.06]),
    "gyro.bias_temperature.0": ("gyro.bias_temperature", [5e-4, 0.0, 0.0]),
    "gyro.g_sensitivity.2": ("gyro.g_sensitivity", [0.0, 0.0, 1e-3]),
    "mount.lever_arm_m.0": ("mount.lever_arm_m", [2.6, -0.3, 0.4]),
    "suspension.squat_gradient": ("suspension.squat_gradient", 0.0095),
    "suspension.dive_gradient": ("suspension.dive_gradient", 0.010),
    "suspension.roll_gradient": ("suspension.roll_gradient", 0.018),
    "steering.offset": ("steering.offset", 0.09),
    "chassis.steering_ratio": ("chassis.steering_ratio", 17.8),
    "chassis.understeer_gradient": ("chassis.understeer_gradient", 0.0055),
    "speed.scale": ("speed.scale", 0.05),
    "yaw_rate.scale": ("yaw_rate.scale", 0.06),
    "yaw_rate.offset": ("yaw_rate.offset", 0.012),
    "speed.delay_s": ("speed.delay_s", 0.15),
    "steering.delay_s": ("steering.delay_s", 0.16),
    "yaw_rate.delay_s": ("yaw_rate.delay_s", 0.16),
    "gyro.delay_s": ("gyro.delay_s", 0.15),
    "lateral_accel.delay_s": ("lateral_accel.delay_s", 0.16),
}
"""Parameter of the forward model: key of the simulation and the value that it gets."""


@cache
def samples(key: str = "", value: str = ""):
    model = CLEAN.with_changes({key: eval(value, {})}) if key else CLEAN
    return simulate(model, SEED, MINUTES).samples


def residual(made, moved=None):
    """RMS residual of each signal, with the forward model at the clean model's values but one."""
    forward = Forward(track_from_samples(made), CLEAN, catalogue())
    values = forward.base() | {TIME: 0.0} | (moved or {})
    left = (forward.measured - forward.predict(values)) * forward.usable
    return dict(zip(forward.names, np.sqrt(np.mean(left**2, axis=1)), strict=True))


def test_without_road_and_vibration_the_residual_is_small_in_every_signal():
    left = residual(samples())
    assert set(left) == {
        "accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "yaw_rate",
        "lateral_accel", "longitudinal_accel",
    }  # fmt: skip
    for name, rms in left.items():
        assert rms < (0.06 if "accel" in name else 0.004), name


@pytest.mark.parametrize("key", CHANGES)
def test_a_changed_parameter_is_seen_and_undone_by_its_value(key):
    name, value = CHANGES[key]
    made = samples(name, repr(value))
    true = value[int(key[-1])] if isinstance(value, list) else value
    clean, seen, undone = residual(samples()), residual(made), residual(made, {key: true})
    shown = [n for n in seen if seen[n] > 1.25 * clean[n]]
    assert shown
    # Where the change shows, the right value brings the residual back.
    left = {n: (undone[n] - clean[n]) / (seen[n] - clean[n]) for n in shown}
    assert min(left.values()) < 0.35, left
    assert max(left.values()) < 0.8, left


def test_every_cause_of_the_list_is_in_the_catalogue_with_words():
    named = {cause.name: cause for cause in catalogue() if not cause.nuisance}
    assert set(named) == set(CAUSES)
    for cause in named.values():
        assert cause.seen_by
        assert cause.sentence


def test_without_yaw_rate_the_gyroscope_stands_in_and_without_both_turns_are_left_out():
    made = dict(samples())
    del made["yaw_rate"]
    names = residual(made)
    assert "gyro_z" not in names
    assert "accel_y" in names
    del made["gyro"]
    assert "accel_y" not in residual(made)


def test_signals_that_are_absent_or_too_short_are_refused_with_their_name():
    made = dict(samples())
    short = {name: Series(s.t[:50], s.values[:50]) for name, s in made.items()}
    with pytest.raises(EstimateError, match="minutes"):
        track_from_samples(short)
    del made["speed"]
    with pytest.raises(EstimateError, match="'speed'"):
        track_from_samples(made)


def test_gaps_and_spoilt_stretches_are_not_used():
    made = dict(samples())
    accel = made["accel"]
    keep = (accel.t < 100.0) | (accel.t > 112.0)
    made["accel"] = Series(accel.t[keep], accel.values[keep])
    track = track_from_samples(made, {"gyro": ((200.0, 210.0),)})
    inside = (track.t > 99.75) & (track.t < 112.25)
    assert not track.usable["accel"][inside].any()
    assert not track.usable["gyro"][(track.t > 199.5) & (track.t < 210.5)].any()
    assert track.usable["gyro"][(track.t > 101.0) & (track.t < 111.0)].any()
