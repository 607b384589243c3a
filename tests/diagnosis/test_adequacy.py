"""What is left, and whether it is more than air, noise and chance."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from table_rows import left

from imucald.diagnosis.fit.chance import beyond_chance
from imucald.diagnosis.left_over.adequacy import (
    BANDS_HZ,
    MOST_LEFT_MPS2,
    _calm,
    _common,
    cut_offs,
)
from imucald.diagnosis.left_over.remains import DRIVEN
from imucald.diagnosis.result import Kind
from imucald.diagnosis.search.state import State
from imucald.model.model import VehicleModel

BLOCKS, BINS = 40, 20
BAND = np.ones(BINS, dtype=bool)


def noise(rng, *shape):
    return rng.standard_normal(shape) + 1j * rng.standard_normal(shape)


def test_chance_alone_exceeds_its_coherence_at_its_rate():
    """Shared out over the bands: 0.5 % each."""
    rng = np.random.default_rng(1)
    over = 0
    for _ in range(400):
        a, b = noise(rng, BLOCKS, BINS), noise(rng, BLOCKS, BINS)
        share, _, chance = _common(a, b, noise(rng, BLOCKS, BINS, 2), BAND)
        over += share > chance
    assert over <= 8


def test_what_goes_with_steering_is_no_motion_of_its_own():
    rng = np.random.default_rng(2)
    steering = noise(rng, BLOCKS, BINS, 2)
    by_tyres, by_lag = (noise(rng, BINS) for _ in range(2))
    a = steering[:, :, 0] * by_tyres + 0.3 * noise(rng, BLOCKS, BINS)
    b = steering[:, :, 0] * by_lag + 0.3 * noise(rng, BLOCKS, BINS)
    share, _, chance = _common(a, b, steering, BAND)
    assert share < chance


def test_a_push_that_both_feel_is_seen_with_its_size():
    rng = np.random.default_rng(3)
    push = noise(rng, BLOCKS, BINS)
    a = push + 0.5 * noise(rng, BLOCKS, BINS)
    b = 0.1 * push + 0.05 * noise(rng, BLOCKS, BINS)
    share, moved, chance = _common(a, b, noise(rng, BLOCKS, BINS, 2), BAND)
    assert share == pytest.approx((1.0 / 1.25) ** 2, abs=0.1)
    assert share > 5.0 * chance
    # Of the mean square of a row, 2 (1 + 0.25) in each bin.
    assert moved == pytest.approx(np.sqrt(share * 2.5 * BINS), rel=0.1)


def test_air_pushes_with_the_square_of_the_speed_as_far_as_its_eddies_lie_in_the_bands():
    """At 40 m/s they pass more quickly than the bands reach."""
    slow, fast, fastest = (_calm(np.full(100, v)) for v in (10.0, 20.0, 40.0))
    assert fast / slow == pytest.approx(4.0, rel=0.1)
    assert 2.5 < fastest / fast < 3.7
    assert 0.005 < fast < 0.02
    assert pytest.approx(0.18, abs=0.01) == MOST_LEFT_MPS2
    assert BANDS_HZ[-1][1] < 1.0


def test_a_peak_at_the_cut_off_of_a_found_low_pass_swings_not():
    """30 s segments on the grid of 10 Hz: bins of 1/30 Hz; a peak at 0.5 Hz."""
    hz = np.arange(151) / 30.0
    size = np.sqrt(1.0 + 20.0 * np.exp(-0.5 * ((hz - 0.5) / 0.06) ** 2))
    rng = np.random.default_rng(4)
    spectra = {"accel_y": noise(rng, BLOCKS, 151) * size}
    spectra |= {driven: noise(rng, BLOCKS, 151) for driven in DRIVEN}

    def found(**changes):
        changes = {f"{signal}.delay_s": x for signal, x in changes.items()}
        state = State((), VehicleModel(), VehicleModel(), {}, changes=changes)
        of = SimpleNamespace(state=state, spectra=spectra)
        return [s.kind for s in beyond_chance(left(Kind.OSCILLATES, of))]

    assert found() == ["peak"]
    # 0.45 s late may be a second-order low-pass of 0.5 Hz; 0.1 s one of 2.2 Hz.
    assert found(gyro=0.45) == []
    assert found(gyro=0.1) == ["peak"]
    assert found(steering=0.45) == ["peak"]
    assert cut_offs({"gyro.delay_s": 0.01}) == []


def test_what_is_younger_than_stated_lets_the_signals_beside_it_be_low_passed():
    assert "steering" not in {s for s, _, _ in cut_offs({"steering.delay_s": -0.45})}
    assert {"gyro", "yaw_rate"} <= {s for s, _, _ in cut_offs({"steering.delay_s": -0.45})}
    assert {s for s, _, _ in cut_offs({"steering.delay_s": 0.45})} == {"steering"}
