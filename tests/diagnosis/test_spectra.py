"""Whitened normal equations: right estimates with the right spread, in coloured noise."""

import numpy as np
import pytest

from imucald.diagnosis import spectra
from imucald.diagnosis.cause import Parameter
from imucald.diagnosis.evidence import Evidence

ROWS = 6000


def _coloured(rng, shape):
    white = rng.standard_normal(shape)
    x = np.zeros(shape)
    for k in range(1, shape[-1]):
        x[..., k] = 0.9 * x[..., k - 1] + white[..., k]
    return x


def _fit(column, residual, usable=None):
    """Estimate of the one parameter, and its standard deviation."""
    usable = np.ones(residual.shape, dtype=bool) if usable is None else usable
    stack = np.stack([column, residual])
    blocks = spectra.transform(stack, usable, 1.8)
    left = blocks.values[..., 1]
    columns = spectra.Blocks(blocks.values[..., :1], blocks.present, blocks.start)
    loud = np.ones((len(left), len(spectra.bands(left.shape[1])), left.shape[2]))
    S = spectra.cross_spectra(left, blocks.present, loud)
    noise = spectra.Noise(S, loud, 0.01 * loud)
    normal = spectra.normal_equations(columns, left, noise)
    parameter = Parameter("p.0", "1", 1.0, 1e6, 0.1)
    fit = Evidence([parameter], normal, np.zeros(1)).fit(["p.0"])
    return float(fit.x[0]), float(np.sqrt(fit.covariance[0, 0])), (columns, left, noise)


def test_estimates_scatter_as_their_standard_deviation_says():
    z = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        column = _coloured(rng, (2, ROWS))
        value, std, _ = _fit(column, 0.05 * column + 3.0 * _coloured(rng, (2, ROWS)))
        z.append((value - 0.05) / std)
    assert abs(float(np.mean(z))) < 0.6
    assert 0.6 < float(np.std(z)) < 1.4


def test_noise_common_to_two_signals_is_taken_off():
    rng = np.random.default_rng(3)
    column = np.stack([_coloured(rng, (ROWS,)), np.zeros(ROWS)])
    common = 5.0 * _coloured(rng, (ROWS,))
    own = 0.3 * rng.standard_normal((2, ROWS))
    _, both, _ = _fit(column, np.stack([common, common]) + own)
    _, alone, _ = _fit(column[:1], (common + own[0])[None])
    assert both < 0.6 * alone


def test_rows_that_are_not_usable_do_not_count():
    rng = np.random.default_rng(4)
    column = _coloured(rng, (1, ROWS))
    residual = 0.5 * column + 0.1 * rng.standard_normal((1, ROWS))
    usable = np.ones((1, ROWS), dtype=bool)
    usable[:, 1000:1400] = False
    residual[:, 1000:1400] = 1e4
    value, _, _ = _fit(column, residual, usable)
    assert value == pytest.approx(0.5, abs=0.02)


def test_a_signal_that_is_absent_weighs_nothing():
    rng = np.random.default_rng(5)
    column = _coloured(rng, (2, ROWS))
    residual = 0.5 * column + 0.1 * rng.standard_normal((2, ROWS))
    usable = np.ones((2, ROWS), dtype=bool)
    usable[1] = False
    residual[1] += 7.0 * column[1]
    value, _, (_, _, _) = _fit(column, residual, usable)
    assert value == pytest.approx(0.5, abs=0.02)


def test_weighted_residual_gives_the_score_of_the_normal_equations():
    rng = np.random.default_rng(6)
    column = _coloured(rng, (2, ROWS))
    _, _, (columns, left, noise) = _fit(column, 0.2 * column + _coloured(rng, (2, ROWS)))
    normal = spectra.normal_equations(columns, left, noise)
    weighed = spectra.weighted(left, columns.present, noise)
    score = np.real(np.vdot(weighed, columns.values[..., 0]))
    assert score == pytest.approx(float(normal.score.sum()), rel=1e-3)
    assert np.real(np.vdot(weighed, left)) == pytest.approx(float(normal.square.sum()), rel=1e-3)


def test_loud_stretches_count_less():
    rng = np.random.default_rng(8)
    column = _coloured(rng, (1, ROWS))
    noise = _coloured(rng, (1, ROWS))
    noise[:, : ROWS // 2] *= 8.0
    blocks = spectra.transform(np.stack([column, noise]), np.ones((1, ROWS), dtype=bool), 1.8)
    left = blocks.values[..., 1]
    S = spectra.cross_spectra(left, blocks.present)
    loud = spectra.loudness(left, blocks.present, S)
    half = len(loud) // 2
    assert loud[: half - 1].mean() > 2.0 * loud[half + 1 :].mean()
