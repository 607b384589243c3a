"""Evidence of sets of causes, against the exact probability of the data."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from imucald.diagnosis.cause import Parameter
from imucald.diagnosis.evidence import LENIENCE, Evidence
from imucald.diagnosis.spectra import Normal

pytestmark = pytest.mark.slow

TOLERANCE, WIDE = 0.1, 3.0


def _problem(seed: int, rows: int = 12, columns: int = 3):
    rng = np.random.default_rng(seed)
    X = rng.standard_normal((rows, columns))
    e = X @ rng.normal(0.0, 1.0, columns) + rng.standard_normal(rows)
    parameters = [
        Parameter(f"p.{i}", "1", TOLERANCE / LENIENCE, WIDE, 0.01) for i in range(columns)
    ]
    normal = Normal((X.T @ X)[None], (X.T @ e)[None], np.array([e @ e]))
    return X, e, parameters, normal


def _exact(X, e, stds, mean):
    covariance = np.eye(len(e)) + X @ np.diag(np.square(stds)) @ X.T
    return multivariate_normal(X @ mean, covariance).logpdf(e)


@given(st.integers(0, 1000), st.sets(st.integers(0, 2)))
def test_log_evidence_differs_between_sets_as_the_exact_probability_does(seed, active):
    X, e, parameters, normal = _problem(seed)
    shift = np.random.default_rng(seed + 1).normal(0.0, 0.1, 3)
    evidence = Evidence(parameters, normal, shift)
    wide = np.where([i in active for i in range(3)], WIDE, TOLERANCE)
    narrow = np.full(3, TOLERANCE)
    said = evidence.fit([f"p.{i}" for i in active]).log_evidence - evidence.fit([]).log_evidence
    # The prior is about the model file's values, which lie at minus the shift.
    true = _exact(X, e, wide, -shift) - _exact(X, e, narrow, -shift)
    assert said == pytest.approx(true, abs=1e-6)


def test_free_parameters_are_fitted_by_least_squares_and_held_ones_are_not():
    X, e, parameters, normal = _problem(5, rows=400)
    evidence = Evidence(parameters, normal, np.zeros(3))
    free = evidence.fit(["p.0", "p.1", "p.2"])
    assert free.x == pytest.approx(np.linalg.lstsq(X, e, rcond=None)[0], abs=2e-3)
    assert np.all(np.abs(evidence.fit([]).x) < np.abs(free.x) + 1e-9)
    assert np.sqrt(np.diag(free.covariance)) == pytest.approx(
        np.sqrt(np.diag(np.linalg.inv(X.T @ X))), rel=0.01
    )


def test_two_columns_alike_are_not_told_apart():
    rng = np.random.default_rng(2)
    x = rng.standard_normal(200)
    X = np.column_stack([x, x])
    e = 1.5 * x + rng.standard_normal(200)
    parameters = [Parameter(f"p.{i}", "1", TOLERANCE, WIDE, 0.01) for i in range(2)]
    evidence = Evidence(
        parameters, Normal((X.T @ X)[None], (X.T @ e)[None], np.array([e @ e])), np.zeros(2)
    )
    first, second = evidence.fit(["p.0"]), evidence.fit(["p.1"])
    assert first.log_evidence == pytest.approx(second.log_evidence)
    assert evidence.fit(["p.0", "p.1"]).log_evidence < first.log_evidence


def test_tempered_data_say_less():
    _, _, parameters, normal = _problem(7, rows=100)
    evidence = Evidence(parameters, normal, np.zeros(3))
    full = evidence.fit(["p.0"]).log_evidence - evidence.fit([]).log_evidence
    less = (
        evidence.fit(["p.0"], temper=4.0).log_evidence - evidence.fit([], temper=4.0).log_evidence
    )
    assert abs(less) < abs(full)
