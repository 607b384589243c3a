"""A speed that is known now and then: what is learnt from it rests on its means between."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from imucald.core.samples import Series
from imucald.drive import windows as wd
from imucald.drive.speed_knots import known_times, means_between
from imucald.motion.coarse_speed import passages
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimator import JointEstimator, _block
from imucald.mount.joint.evidence import TURN_FITS, Block, Evidence, Solution, force_fits
from imucald.mount.joint.state import OtherSignals, Priors
from imucald.mount.joint.sums import WindowSums
from imucald.simulation import random_model, simulate
from imucald.simulation.imu import gain_matrix
from joint.planar_drive import Sensor, blocks, cross_talk
from mount_settings import joint_settings
from signal_block import block

Array = NDArray[np.float64]
LEVEL_ROADS = Priors(crown=(0.0, 0.002), slope=0.002)
ALL = np.ones(60, dtype=bool)


def test_between_knots_all_signals_keep_their_mean_and_equations_between_them_hold() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=(60, 2))
    x = np.column_stack([x, 0.7 * x[:, 0] - 2.0 * x[:, 1]])
    made = means_between(x, np.array([10.0, 30.0, 45.5]), ALL)
    np.testing.assert_allclose(made[:, 2], 0.7 * made[:, 0] - 2.0 * made[:, 1], atol=1e-12)
    np.testing.assert_allclose(made[10:30], np.tile(x[10:30].mean(axis=0), (20, 1)))
    np.testing.assert_allclose(made.sum(axis=0), x.sum(axis=0))
    assert np.ptp(made[46:, 0]) < 1e-12


def test_a_tick_with_a_knot_of_its_own_stays_as_it_is() -> None:
    x = np.random.default_rng(2).normal(size=(60, 2))
    np.testing.assert_array_equal(means_between(x, np.arange(60) + 0.3, ALL), x)


def test_ticks_that_do_not_count_are_in_no_mean() -> None:
    x, use = np.ones((60, 1)), ALL.copy()
    x[20:24], use[20:24] = 1e6, False
    np.testing.assert_allclose(means_between(x, np.array([5.0, 50.0]), use)[use], 1.0)


def test_the_standstill_of_a_sender_that_is_silent_below_a_speed_is_not_known_at_its_ends() -> None:
    speed = np.concatenate([np.full(20, 1.4), np.zeros(100), np.full(20, 1.4)])
    kept = known_times(np.arange(140) + 0.5, speed, least=1.4)
    assert kept[kept < 20].tolist() == (np.arange(20) + 0.5).tolist()
    assert (kept >= 120).sum() == 20
    inside = kept[(kept > 20) & (kept < 120)]
    assert 20 + 14 < inside.min() < 20 + 35  # at 1 and at 0.4 m/s2
    assert 120 - 35 < inside.max() < 120 - 14
    assert len(known_times(np.arange(140) + 0.5, speed, least=0.02)) == 140


def _with_speed(speed: Array, knots: Array, least: float = 0.0) -> list[Block]:
    """Blocks of a drive with another speed (N,), known at some times (K,) [ticks]."""
    return [
        b._replace(
            speed=speed[64 * k : 64 * (k + 1)],
            knots=knots[(knots >= 64 * k) & (knots < 64 * (k + 1))] - 64 * k,
            least_speed=least,
        )
        for k, b in enumerate(blocks(6.0, Sensor()))
    ]


def _shown(form: str, size: float) -> list[Block]:
    """form: the speed is silent below `size` [m/s], in steps of it, or comes each so many ticks."""
    speed = np.concatenate([b.speed for b in blocks(6.0, Sensor())])
    at = np.arange(len(speed)) + 0.5
    if form == "silent":
        return _with_speed(np.where(speed < size, 0.0, speed), at, size)
    if form == "steps":
        when, values = passages(0.1 * at, size * np.round(speed / size), size)
        return _with_speed(np.interp(0.1 * at, when, values), 10.0 * when)
    sent = at[:: int(size)]
    return _with_speed(np.interp(at, sent, speed[:: int(size)]), sent)


def _solved(drive: list[Block]) -> Solution:
    evidence = Evidence(LEVEL_ROADS)
    for one in drive:
        evidence.add_block(one)
    found = evidence.solve()
    assert found is not None
    return found


@pytest.mark.parametrize(
    ("form", "size"),
    [("silent", 6.0), ("silent", 8.0), ("steps", 1.0), ("steps", 2.0), ("every", 5), ("every", 10)],
)
def test_a_speed_of_which_little_is_shown_costs_little_of_what_bends_tell(
    form: str, size: float
) -> None:
    whole, found = _solved(blocks(6.0, Sensor())), _solved(_shown(form, size))
    left = cross_talk(found.force, np.eye(3))
    assert abs(left[0, 1]) < 4.0 * found.sent().xy
    assert abs(left[1, 0]) < 4.0 * found.sent().yx
    assert found.sent().xy < 1.4 * whole.sent().xy


def test_the_knots_of_a_signal_block_are_those_of_its_speed() -> None:
    given = block()
    given.speed_knots, given.least_speed = np.array([3.5, 40.25]), 1.4
    made = _block(given, OtherSignals())
    assert made.knots.tolist() == [3.5, 40.25]
    assert made.least_speed == 1.4
    assert len(_block(block(), OtherSignals()).knots) == 64


@pytest.mark.parametrize(("apart", "bands"), [(1, 8), (5, 8), (10, 6), (20, 4), (40, 3)])
def test_bands_above_half_the_rate_of_the_known_speeds_are_left_out(apart: int, bands: int) -> None:
    sums = WindowSums(force_fits(OtherSignals()), TURN_FITS)
    shape = 4, len(wd.BINS), len(wd.NAMES)
    spectra = np.random.default_rng(5).normal(size=shape) + 0j
    sums.add_spectra(spectra, np.arange(4), np.full(4, 1.0 / apart))
    assert sums.bands_with_speed == bands


@pytest.mark.slow
def test_what_the_rounding_of_a_seldom_speed_turns_is_within_the_deviation() -> None:
    """Whole km/h every two seconds: the same drive with ten offsets of the rounding."""
    model = random_model(1820002)
    made = simulate(model, 1820002, 8.0)
    samples = {name: one for name, one in made.samples.items() if name != "wheel_speeds"}
    response = gain_matrix(model.accel) @ made.truth.R_vehicle_from_sensor().T
    fine, t = samples["speed"], np.arange(0.3, 480.0, 2.0)
    known = 3.6 * np.interp(t - 0.3, fine.t, fine.values)
    ratios = []
    for offset in np.arange(0.0, 1.0, 0.1):
        samples["speed"] = Series(t, (np.floor(known + offset) + 0.5 - offset) / 3.6 * (known > 1))
        estimator = JointEstimator(joint_settings())
        for row in ticks_from_samples(samples, 0, 4800).tolist():
            estimator.step(row)
        solution = estimator.solution
        assert solution is not None
        ratios.append((solution.force @ response)[0, 1] / solution.sent().xy)
    assert math.sqrt(np.mean(np.square(ratios))) < 1.6
