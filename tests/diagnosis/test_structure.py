"""Structure that no cause explains is found, and an honest residual has none."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from hidden import OUTSIDE_SIGNALS, Effect, hidden_drive
from imucald.diagnosis.cause import catalogue
from imucald.diagnosis.forward import Forward
from imucald.diagnosis.grid import GRID_HZ, track_from_samples
from imucald.diagnosis.search import Search
from imucald.diagnosis.spectra import transform
from imucald.diagnosis.structure import _bursts, _humps, _pushes, find_structure
from imucald.diagnosis.structure_guard import standing
from imucald.diagnosis.structure_spectra import Spectra
from imucald.model.model import VehicleModel, model_from_mapping

pytestmark = pytest.mark.slow

NAMES = ("accel_x", "accel_y", "gyro_x", "gyro_z", "yaw_rate", "lateral_accel")
MINUTES = 20
TOP_HZ = 1.8


def noise(rng, low, high, rms):
    """Noise in a band of frequencies [Hz]."""
    n = round(MINUTES * 60 * GRID_HZ)
    sos = butter(2, (low, high), "bandpass", fs=GRID_HZ, output="sos")
    x = sosfilt(sos, rng.standard_normal(n))
    return rms * x / x.std()


def red_noise(rng):
    """Residuals as roads and sensors leave them: smooth spectra, each signal its own."""
    n = round(MINUTES * 60 * GRID_HZ)
    white = rng.standard_normal((len(NAMES), n))
    return white + 2.0 * sosfilt(butter(1, 0.3, fs=GRID_HZ, output="sos"), white)


def spectra_of(residual, predicted=None):
    usable = np.ones(residual.shape, dtype=bool)
    predicted = 0.0 * residual if predicted is None else predicted
    blocks = transform(np.stack([residual, predicted]), usable, TOP_HZ)
    return Spectra(NAMES, blocks.values[..., 0], blocks.values[..., 1], blocks.present)


FORWARD = SimpleNamespace(
    model=VehicleModel(),
    track=SimpleNamespace(top_hz=TOP_HZ, t=np.arange(MINUTES * 60 * GRID_HZ) / GRID_HZ),
)


@pytest.mark.parametrize("seed", range(8))
def test_smooth_residuals_have_no_structure(seed):
    spectra = spectra_of(red_noise(np.random.default_rng(seed)))
    assert not _humps(spectra, [FORWARD])
    assert not _pushes(spectra, set())
    assert not _bursts(spectra, [FORWARD])


def test_a_sway_is_told_in_the_signals_that_it_moves():
    rng = np.random.default_rng(1)
    residual, sway = red_noise(rng), noise(rng, 0.57, 0.63, 1.2)
    for name in ("gyro_x", "yaw_rate", "lateral_accel"):
        residual[NAMES.index(name)] += sway
    found = _humps(spectra_of(residual), [FORWARD])
    assert {s.signal for s in found} == {"gyro_x", "yaw_rate", "lateral_accel"}
    assert all("0.6" in s.text or "0.5" in s.text for s in found)


def test_a_push_moves_yaw_rate_and_lateral_acceleration_together():
    rng = np.random.default_rng(2)
    residual, gusts = red_noise(rng), noise(rng, 0.05, 0.8, 8.0)
    alone = residual.copy()
    for name in ("yaw_rate", "lateral_accel"):
        residual[NAMES.index(name)] += gusts
    assert {s.signal for s in _pushes(spectra_of(residual), set())} >= {"yaw_rate", "lateral_accel"}
    # What stays in one signal is a sensor's.
    alone[NAMES.index("yaw_rate")] += gusts
    assert not _pushes(spectra_of(alone), set())
    # What the gyroscope shows against the yaw rate is the yaw rate's own error.
    residual[NAMES.index("gyro_z")] -= gusts
    assert not _pushes(spectra_of(residual), set())


def test_a_push_within_what_the_model_may_be_wrong_by_is_not_told():
    rng = np.random.default_rng(3)
    residual, left = red_noise(rng), noise(rng, 0.2, 0.8, 4.0)
    for name in ("yaw_rate", "lateral_accel"):
        residual[NAMES.index(name)] += left
    driven = np.zeros_like(residual)
    driven[NAMES.index("yaw_rate")] = 20.0 * left
    assert _pushes(spectra_of(residual), set())
    assert not _pushes(spectra_of(residual, driven), set())


def test_one_odd_stretch_is_told_with_its_time():
    residual = red_noise(np.random.default_rng(4))
    residual[0, 6000:6300] *= 40.0
    (found,) = _bursts(spectra_of(residual), [FORWARD])
    assert found.signal == "accel_x"
    seconds = float(found.text.split("around ")[1].split(" s")[0])
    assert 575.0 < seconds < 660.0


def searched(seed, effect):
    drive = hidden_drive(seed, [effect], 14.0)
    causes = catalogue()
    forward = Forward(
        track_from_samples(drive.samples), model_from_mapping(drive.model, "baseline"), causes
    )
    search = Search([forward], causes, [c for c in causes if not c.nuisance], lambda _: None)
    return search, search.run()


@pytest.mark.parametrize("effect", ["trailer_sway", "vibration_rectification"])
def test_an_effect_outside_the_catalogue_is_told_and_no_cause_stands_beside_it(effect):
    search, found = searched(53_000, Effect(effect, "medium"))
    structure = find_structure(search, found)
    assert {s.signal for s in structure} & set(OUTSIDE_SIGNALS[effect])
    assert not standing(search, found, structure)
