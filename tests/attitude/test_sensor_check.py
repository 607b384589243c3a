"""The sensor check: rests found, zero errors and scales recovered."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np
import pytest
from benchmarks.six_positions import find_rests, six_parameters
from scipy.spatial.transform import Rotation

from imucald.attitude.sensor_check import rest_errors
from imucald.core.errors import EstimateError

G = 9.80665
XSENS = Path(__file__).parents[3] / "shared" / "data" / "static_xsens" / "accelerometer.txt.gz"


def test_errors_at_rest_as_the_text_has_them():
    assert rest_errors((0.1, 0.2, 0.3), (0.05, -0.02, G + 0.1), True) == (
        (0.1, 0.2, 0.3),
        pytest.approx((0.05, -0.02, 0.1)),
    )


def test_off_the_level_only_the_size_shows():
    up = Rotation.from_euler("xy", [0.2, -0.1]).apply([0.0, 0.0, G + 0.1])
    _, error = rest_errors((0.0, 0.0, 0.0), tuple(up), False)
    assert np.subtract(up, error) == pytest.approx(up * G / (G + 0.1))


@pytest.mark.parametrize("is_level", [False, True])
@pytest.mark.parametrize("size", [0.0, 0.2, 4.85, 15.0, math.nan])
def test_errors_of_a_broken_accelerometer_are_not_believed(size, is_level):
    assert not rest_errors((0.0, 0.0, 0.0), (0.0, 0.0, size), is_level).is_believable


def test_errors_of_a_sensor_that_works_are_believed():
    assert rest_errors((0.02, 0.0, -0.05), (0.3, -0.2, G + 0.5), False).is_believable
    assert not rest_errors((0.0, 0.0, 0.2), (0.0, 0.0, G), False).is_believable


def test_rests_are_the_quiet_stretches():
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 60.0, 0.01)
    moving = ((t > 10) & (t < 15)) | ((t > 40) & (t < 50))
    values = rng.normal(0.0, 1.0, (len(t), 3)) * np.where(moving, 50.0, 1.0)[:, None]
    rests = find_rests(t, values, threshold=3.0)
    assert len(rests.times) == 3
    assert rests.times == pytest.approx(np.array([[0, 10], [15, 40], [50, 60]]), abs=0.6)


def test_rests_need_arrays_that_fit():
    with pytest.raises(EstimateError, match="rests need"):
        find_rests([0.0, 1.0], [[1.0, 2.0]], 1.0)
    assert len(find_rests([], np.zeros((0, 3)), 1.0).times) == 0


def test_six_parameters_are_recovered():
    rng = np.random.default_rng(3)
    bias, scale = np.array([33000.0, 32700.0, 33400.0]), np.array([0.0024, 0.00245, 0.00238])
    up = Rotation.random(20, rng=rng).apply([0.0, 0.0, G])
    fit = six_parameters(up / scale + bias + rng.normal(0.0, 0.5, up.shape))
    assert fit.bias == pytest.approx(bias, abs=2.0)
    assert fit.scale == pytest.approx(scale, rel=1e-3)
    assert fit.residual < 0.003


def test_positions_in_one_plane_are_refused():
    angles = np.linspace(0.0, 6.0, 20)
    flat = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(20)]) * G
    with pytest.raises(EstimateError, match="too much alike"):
        six_parameters(flat)
    with pytest.raises(EstimateError, match="at least 6"):
        six_parameters(flat[:4])


@pytest.mark.skipif(not XSENS.exists(), reason="measured data is not here")
def test_the_xsens_turns_out_as_its_publishers_have_it():
    with gzip.open(XSENS, "rt") as file:
        raw = np.loadtxt(file)
    rests = find_rests(raw[:, 0], raw[:, 1:], threshold=12.0)
    fit = six_parameters(rests.means)
    assert fit.bias == pytest.approx([33122.0, 33280.0, 32372.0], abs=5.0)
    assert fit.scale == pytest.approx([0.00242] * 3, rel=0.005)
    assert fit.residual == pytest.approx(0.033, abs=0.002)
