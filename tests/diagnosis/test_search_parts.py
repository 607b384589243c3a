"""What the search holds against a candidate, and which stretches judge what was found."""

from types import SimpleNamespace

import numpy as np
import pytest

from imucald.diagnosis import gain, linear, spectra
from imucald.diagnosis.bent import SAME_SIGNAL, hurdle
from imucald.diagnosis.cause import Variant
from imucald.diagnosis.causes import mount_rotation, mount_shift, sensor_lowpass
from imucald.diagnosis.gain import folds
from imucald.diagnosis.spectra import windows
from imucald.diagnosis.trial import ACCEPT, signal_of


def _level(quiet, loud, name="accel", rate_hz=100.0):
    """A drive whose change from sample to sample rises from standing to driving."""
    return SimpleNamespace(level={name: np.linspace(quiet, loud, 500)}, rates_hz={name: rate_hz})


@pytest.mark.parametrize(
    ("cutoff_hz", "track", "possible"),
    [
        (0.5, _level(0.05, 0.4), False),
        (0.5, _level(0.048, 0.05), True),
        (20.0, _level(0.05, 0.4), True),
        (0.8, _level(0.002, 0.01, "gyro"), False),
        (0.5, _level(0.00267, 0.00296, "gyro"), True),
        (0.8, _level(0.002, 0.01, "accel"), True),
        (0.25, _level(0.001, 0.02, "gyro", 10.0), True),
    ],
    ids=["shaken", "quiet", "shallow", "turning", "own noise", "other sensor", "slow sensor"],
)
def test_a_low_pass_through_which_vibration_came_is_ruled_out(cutoff_hz, track, possible):
    name = next(iter(track.level))
    values = {f"_lowpass.{name}": 1.0 / cutoff_hz}
    assert sensor_lowpass.is_possible(track, values) is possible


def test_a_delay_beside_a_low_pass_of_the_same_signal_must_be_beyond_doubt():
    slow = Variant("sensor_lowpass", "accel", ("_lowpass.accel",))
    late = Variant("signal_delay", "accel", ("accel.delay_s",))
    other = Variant("signal_delay", "gyro", ("gyro.delay_s",))
    scale = Variant("accel_scale", "0", ("accel.scale.0",))
    assert hurdle([slow, late]) == SAME_SIGNAL
    assert hurdle([slow, other]) == ACCEPT
    assert hurdle([slow, scale]) == ACCEPT
    assert signal_of("_lowpass.accel") == signal_of("accel.delay_s") == "accel"


def test_errors_of_the_model_in_two_signals_do_not_cancel():
    S = np.ones((1, 2, 2), dtype=complex) * 4.0 + 1e-6 * np.eye(2)
    loud = np.full((3, 1, 2), 2.0)
    blocks, both = np.arange(3), np.arange(2)
    difference = np.array([1.0, -1.0])
    sure = spectra.Noise(S, loud, np.zeros((3, 1, 2))).matrices(0, blocks, both)
    unsure = spectra.Noise(S, loud, np.full((3, 1, 2), 0.3)).matrices(0, blocks, both)
    assert np.real(difference @ sure[1] @ difference) < 1e-4
    assert np.real(difference @ unsure[1] @ difference) == pytest.approx(2 * 0.3**2, rel=1e-3)
    assert np.real(sure[1][0, 0]) == pytest.approx(16.0, rel=1e-5)


def test_a_turned_sensors_residual_is_compared_in_the_axes_of_the_vehicle():
    rng = np.random.default_rng(4)
    t = np.arange(400) / 10.0
    names = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "yaw_rate")
    shaking = rng.standard_normal((7, 400)) * np.array([1, 1, 1, 5, 5, 0.01, 1])[:, None]
    forward = SimpleNamespace(names=names, track=SimpleNamespace(t=t))
    turn, at = np.array([0.03, -0.05, 0.12]), 17.0
    seen = shaking.copy()
    after = t >= at
    # Small turns one after another, so that no formula of the code under test is used.
    for _ in range(20_000):
        step = -turn / 20_000
        for rows in (slice(0, 3), slice(3, 6)):
            seen[rows][:, after] += np.cross(step, seen[rows][:, after].T).T
    values = dict(zip(mount_shift.KEYS, turn, strict=True)) | {mount_shift.TIME: at}
    back = linear._in_vehicle_axes(forward, seen.copy(), values)
    assert back == pytest.approx(shaking, abs=1e-3)
    whole = dict.fromkeys(mount_rotation.KEYS, 0.0)
    assert linear._in_vehicle_axes(forward, seen.copy(), whole) == pytest.approx(seen)


def _held_out(lengths: list[int]) -> list[np.ndarray]:
    """Weights of the folds of drives with so many grid rows."""
    forwards = [SimpleNamespace(track=SimpleNamespace(t=np.zeros(n))) for n in lengths]
    total = sum(len(windows(n)) for n in lengths)
    found = SimpleNamespace(point=SimpleNamespace(present=np.zeros((total, 1))))
    return folds(SimpleNamespace(forwards=forwards), found)


def test_every_fold_of_one_drive_is_fitted_on_stretches_from_all_over_it():
    used = np.array(_held_out([1500 * 10]))
    assert used.shape[0] == 4
    assert (used == 0.0).any(axis=0).all()  # each stretch is held out once at least
    for quarter in np.array_split(np.arange(used.shape[1]), 4):
        assert used[:, quarter].any(axis=1).all()


@pytest.mark.parametrize("drives", [2, 4, 8])
def test_the_gain_of_a_cause_does_not_depend_on_how_many_drives_there_are(monkeypatch, drives):
    """Each stretch is worth one nat."""
    total = 240
    parts = [np.where(np.arange(total) * drives // total == k, 0.0, 1.0) for k in range(drives)]
    monkeypatch.setattr(gain, "folds", lambda *_: parts)
    evidence = SimpleNamespace(
        fit=lambda *_, fixed=(): SimpleNamespace(x=0.0 if fixed else 1.0),
        held_out=lambda x, held: x * held,
    )
    found = SimpleNamespace(point=SimpleNamespace(evidence=evidence), keys=["a"])
    assert gain.gain_of(SimpleNamespace(), found, ["a"]) == pytest.approx(total)


def test_whole_drives_are_held_out_where_there_are_several():
    first, second = _held_out([600 * 10, 900 * 10])
    n = len(windows(600 * 10))
    assert not first[:n].any()
    assert first[n + 1 : -1].all()
    assert not second[n:].any()
