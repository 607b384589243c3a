"""Force and rate as one sample, and what its covariance is made of."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.api.columns import HISTORY_COLUMNS, Columns, columns_from, corrected_columns
from imucald.api.files.imu_samples import joined, mounts_of

RANDOM = np.random.default_rng(1)
NAMES = ("xx", "xy", "xz", "yy", "yz", "zz")


def table(kind: str, t: np.ndarray, values: np.ndarray) -> Columns:
    quality = np.full(len(t), 3)
    return columns_from(corrected_columns(kind), [t, t * 1e6, *values.T, quality])


def history(t: list[float], covariances: list[np.ndarray]) -> Columns:
    """Covariances [deg^2]; all else is not known."""
    rows = []
    for at, P in zip(t, covariances, strict=True):
        known = {f"cov_{n}_deg2": P["xyz".index(n[0]), "xyz".index(n[1])] for n in NAMES}
        known |= {"t_s": at, "time": 0, "state": "fine", "usable": True}
        rows.append([known.get(c.name, np.nan) for c in HISTORY_COLUMNS])
    return columns_from(HISTORY_COLUMNS, list(map(list, zip(*rows, strict=True))))


def test_the_noise_is_that_of_the_samples_whatever_the_drive_does():
    t = np.arange(0.0, 60.0, 0.01)
    drive = np.stack([np.sin(t), 2.0 * np.cos(0.7 * t), 9.81 + 0.1 * t], axis=1)
    noise = RANDOM.normal(0.0, [0.02, 0.05, 0.1], (len(t), 3))
    (samples,) = joined(table("accel", t, drive + noise), None, np.zeros((0, 10)))
    found = samples.force_covariance[0].reshape(3, 3)
    assert np.sqrt(np.diag(found)) == pytest.approx([0.02, 0.05, 0.1], rel=0.05)
    assert np.isnan(samples.rate).all()


def test_the_covariance_is_what_turns_of_that_covariance_make_of_the_vector():
    root = RANDOM.normal(0.0, 1.0, (3, 3))
    P = root @ root.T  # [deg^2]
    t = np.arange(0.0, 2.0, 0.01)
    force = np.array([1.5, -2.0, 9.81])
    turns = np.radians(RANDOM.multivariate_normal(np.zeros(3), P, 200_000))
    expected = np.cov(np.cross(turns, force).T)
    mounts = mounts_of(history([0.0, 1.0], [np.zeros((3, 3)), P]))
    (samples,) = joined(table("accel", t, np.tile(force, (len(t), 1))), None, mounts)
    assert not samples.force_covariance[50].any(), "the row of before holds"
    found = samples.force_covariance[150].reshape(3, 3)
    assert found == pytest.approx(expected, abs=0.01 * np.abs(expected).max())


def test_each_force_has_the_nearest_rate_and_none_that_is_far_away():
    t = np.arange(0.0, 1.0, 0.01)
    rate_t = np.concatenate([t[:30] + 0.004, t[60:] - 0.003])
    rates = np.stack([rate_t, -rate_t, 0.0 * rate_t], axis=1)
    force = np.tile([0.0, 0.0, 9.81], (len(t), 1))
    force[5, 1] = np.nan
    tables = table("accel", t, force), table("gyro", rate_t, rates)
    (samples,) = joined(*tables, np.zeros((0, 10)))
    assert len(samples.times) == len(t) - 1, "a force that is not known is no sample"
    assert samples.rate[10, 0] == pytest.approx(0.114)
    assert samples.rate[80, 0] == pytest.approx(0.807)
    assert np.isnan(samples.rate[44]).all()
    assert samples.times[10] == 110_000
