"""Errors that sources of evidence have in common by the road that they were found on."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.mount.fusion import CommonCovariance, fuse
from imucald.mount.road_segments import AngleEvidence, AngleFit, ScoreSeries, apart

SEGMENTS = 40


def series(kind: str, angles: np.ndarray) -> ScoreSeries:
    """Segments of equal information that say these angles [rad]."""
    information = np.full(len(angles), 100.0)
    score = information * angles
    value, total = float(angles.mean()), float(information.sum())
    left = score - information * value
    fit = AngleFit(left, information[:, None], np.array([[1.0 / total]]), value)
    return ScoreSeries(kind, score, information, fit)


def test_what_two_sources_see_alike_is_not_in_their_difference():
    rng = np.random.default_rng(1)
    found, stated = [], []
    for _ in range(300):
        road = 0.05 * rng.standard_normal(SEGMENTS)
        one = series("roll_turn", road + 0.004 * rng.standard_normal(SEGMENTS))
        other = series("roll_axis", road + 0.003 * rng.standard_normal(SEGMENTS))
        difference = apart(one, other)
        assert difference is not None
        found.append(difference.value)
        stated.append(difference.variance)
    assert np.mean(np.square(found)) == pytest.approx(0.005**2 / SEGMENTS, rel=0.25)
    assert np.mean(stated) == pytest.approx(np.mean(np.square(found)), rel=0.35)


def test_of_one_segment_no_difference_is_told():
    angles = np.array([0.01])
    assert apart(series("roll_turn", angles), series("roll_axis", 0.0 * angles)) is None
    assert apart(series("roll_turn", angles), ScoreSeries("roll_axis", angles, angles)) is None


def test_the_slope_that_gravity_and_the_axis_of_turning_share_is_counted_once():
    """Turns are a part of the road: their mean slope errs by the whole road's and by their own."""
    rng = np.random.default_rng(2)
    slopes = 0.02 * rng.standard_normal((4000, 50))
    gravity, axis = slopes.mean(axis=1), slopes[:, :10].mean(axis=1)
    sources = {
        "pitch_gravity": AngleEvidence(0.0, float(gravity.var()), 0.0, float(gravity.var())),
        "pitch_axis": AngleEvidence(0.0, float(axis.var()), 0.0),
    }
    sharing = CommonCovariance(())
    V = sharing.covariance(sources, list(sources))
    assert V[0, 1] == pytest.approx(float(np.cov(gravity, axis)[0, 1]), rel=0.1)
    apart_ = {**sources, "pitch_gravity": AngleEvidence(0.0, float(gravity.var()), 0.0)}
    assert fuse(sources, sharing).variance[1] > 1.15 * fuse(apart_, sharing).variance[1]
    assert np.linalg.eigvalsh(V).min() > 0.0


def test_a_better_axis_shares_no_more_than_it_errs_by():
    sources = {
        "roll_gravity": AngleEvidence(0.0, 0.01**2, 0.0, 0.008**2),
        "roll_axis": AngleEvidence(0.0, 0.004**2, 0.0),
    }
    V = CommonCovariance(()).covariance(sources, list(sources))
    assert V[0, 1] == pytest.approx(0.004**2)
    assert np.linalg.eigvalsh(V).min() > 0.0
