"""A drift of roll beside roads that lean: the road itself says how far its lean goes on."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from imucald.mount.creep import BELIEVED, Creep, SegmentSeries, creep

Array = NDArray[np.float64]

STATED = np.radians(1.1)
"""What a segment's lean is taken for by itself."""
TIMES = 3.6
"""By how much more the mean over all is stated to vary, before any data."""
SEGMENTS = 28
"""Twelve minutes of driving."""
CHANCE = 0.5
"""Probability of creep before any data."""
DRAWS = 200


def road(rng: np.random.Generator, std: float, goes_on: float) -> Array:
    """Leans of segments [rad] of that spread; goes_on: correlation of neighbours."""
    lean = np.zeros(SEGMENTS)
    value = rng.standard_normal()
    for k in range(SEGMENTS):
        lean[k] = std * value
        value = goes_on * value + np.sqrt(1.0 - goes_on**2) * rng.standard_normal()
    return lean


def found(lean: Array, rate: float, shifts: int = 0) -> Creep:
    """rate: of the mount [rad/segment]. shifts: found before."""
    value = lean + rate * (np.arange(SEGMENTS) + 0.5)
    known = np.full(SEGMENTS, 1.0 / STATED**2)
    mean = float(value.mean())
    own = TIMES * STATED**2 / SEGMENTS
    series = SegmentSeries("roll_gravity", known * (value - mean), known, own)
    fit = creep([series], CHANCE, shifts)
    assert fit is not None
    return fit


def probabilities(std: float, goes_on: float, rate: float) -> Array:
    rng = np.random.default_rng(1)
    return np.array(
        [found(road(rng, np.radians(std), goes_on), rate).probability[0] for _ in range(DRAWS)]
    )


RATE = np.radians(18.0 / 140.0)
"""18 deg/h."""


def test_on_even_roads_a_creeping_roll_is_found_that_hilly_roads_hide() -> None:
    even, hilly = probabilities(0.5, 0.2, RATE), probabilities(1.6, 0.2, RATE)
    assert np.mean(even > BELIEVED) > 0.95
    assert np.median(hilly) < BELIEVED


@pytest.mark.parametrize(("std", "goes_on"), [(0.2, 0.0), (0.8, 0.2), (1.1, 0.0), (1.1, 0.7)])
def test_no_road_is_taken_for_a_creeping_mount(std: float, goes_on: float) -> None:
    assert np.mean(probabilities(std, goes_on, 0.0) > BELIEVED) < 0.02


@pytest.mark.parametrize(("std", "goes_on"), [(0.8, 0.2), (1.1, 0.5)])
def test_the_interval_holds_while_it_is_open_whether_the_mount_creeps(
    std: float, goes_on: float
) -> None:
    rng = np.random.default_rng(2)
    held = 0
    for _ in range(DRAWS):
        lean = road(rng, np.radians(std), goes_on)
        fit = found(lean, RATE)
        # of the constant that is served, which is the mean over the drive
        true = RATE * (0.5 * SEGMENTS + 0.5) - float(lean.mean())
        own = TIMES * STATED**2 / SEGMENTS
        held += abs(true - fit.level[0]) <= 3.0 * np.sqrt(fit.variance[0] + own)
    assert held / DRAWS > 0.98


def test_shifts_speak_for_a_creeping_mount_however_many_a_loose_sensor_makes() -> None:
    lean = road(np.random.default_rng(3), np.radians(1.1), 0.0)
    few, many = found(lean, 0.0, 2), found(lean, 0.0, 2000)
    assert found(lean, 0.0).probability[0] < few.probability[0] < many.probability[0]
    assert np.isfinite(many.level).all()
    assert np.isfinite(many.variance).all()
