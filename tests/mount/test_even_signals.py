"""Signals of a block on the even grid of ticks."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.samples import GRAVITY
from imucald.motion import ticks as tk
from imucald.motion.ticks import empty_rows
from imucald.mount.even_signals import bridged
from imucald.mount.signal_blocks import BLOCK_TICKS, LAG, SignalBlock, SignalBlockMaker
from mount_settings import joint_settings

TICKS = 20 * BLOCK_TICKS
RNG = np.random.default_rng


def drive() -> np.ndarray:
    """Ticks of a drive whose signals all come, none of them twice the same."""
    rng = RNG(3)
    rows = empty_rows(TICKS)
    rows[:, tk.T] = 0.1 * (np.arange(TICKS) + 1)
    for count in (tk.ACCEL, tk.GYRO, tk.SPEED, tk.STEERING, tk.YAW_RATE, tk.LATERAL_ACCEL):
        rows[:, count.n] = 5
    rows[:, tk.WHEEL_SPREAD.n] = 5
    for sensor in (tk.ACCEL, tk.GYRO, tk.SPEED):
        rows[:, sensor.age] = 0.05 + 0.01 * rng.random(TICKS)
    rows[:, tk.ACCEL.x : tk.ACCEL.max_z + 1] = 0.3 * rng.standard_normal((TICKS, 12))
    rows[:, tk.ACCEL.z] += GRAVITY
    rows[:, tk.GYRO.x : tk.GYRO.z + 1] = 0.02 * rng.standard_normal((TICKS, 3))
    rows[:, tk.SPEED.mean] = 15.0 + 0.3 * rng.standard_normal(TICKS)
    for signal, size in ((tk.STEERING, 0.1), (tk.YAW_RATE, 0.02), (tk.LATERAL_ACCEL, 0.3)):
        rows[:, signal.mean] = size * rng.standard_normal(TICKS)
    rows[:, tk.WHEEL_SPREAD.mean] = 0.1 * rng.random(TICKS)
    return rows


def blocks_of(rows: np.ndarray) -> list[SignalBlock]:
    maker = SignalBlockMaker(joint_settings())
    return [maker.block() for row in rows.tolist() if maker.push(row)]


def test_a_block_says_of_a_ramp_what_it_was_at_the_middle_of_each_tick() -> None:
    rows = drive()
    slope = np.array([0.02, -0.01, 0.005])
    rows[:, tk.ACCEL.x : tk.ACCEL.z + 1] = slope * (rows[:, tk.T] - rows[:, tk.ACCEL.age])[:, None]
    rows[:, tk.ACCEL.z] += GRAVITY
    rows[:, tk.SPEED.mean] = 10.0 + 0.05 * (rows[:, tk.T] - rows[:, tk.SPEED.age])
    found = blocks_of(rows)[1:]
    assert len(found) > 15
    for b, block in enumerate(found, 1):
        middle = 0.1 * (np.arange(BLOCK_TICKS) + b * BLOCK_TICKS - LAG) + 0.05
        np.testing.assert_allclose(block.t, middle + 0.05, atol=1e-9)
        np.testing.assert_allclose(
            block.force, slope * middle[:, None] + [0.0, 0.0, GRAVITY], atol=1e-9
        )
        np.testing.assert_allclose(block.speed, 10.0 + 0.05 * middle, atol=1e-9)
        np.testing.assert_allclose(block.accel, 0.05, atol=1e-6)
        assert block.learn.all()


def test_a_tick_that_a_long_hole_cuts_keeps_its_own_samples() -> None:
    """Their mean lies where they are, up to half a tick from the middle."""
    times = np.array([0.05, 0.15, 0.22, 0.88, 0.95, 1.05])  # none from 0.24 to 0.86 s
    at = 0.05 + 0.1 * np.arange(11)
    out, ok = bridged(at, times, times, 0.35)
    assert ok.tolist() == [True, True, True, *5 * [False], True, True, True]
    assert np.abs(out[ok] - at[ok]).max() < 1e-12


def test_nothing_is_bridged_before_the_first_sample_and_over_long_holes() -> None:
    times = np.array([1.0, 1.1, 2.0])
    at = np.array([0.5, 0.95, 1.05, 1.5, 1.95, 2.05, 2.5])
    values = np.column_stack([times, 2.0 * times])
    for of in (values, values[:, 0]):
        out, ok = bridged(at, times, of, 0.35)
        assert ok.tolist() == [False, True, True, False, False, True, False]
        assert out.reshape(len(at), -1)[2, 0] == pytest.approx(1.05)
