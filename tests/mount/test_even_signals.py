"""Blocks of signals that are worked out many at once."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
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


Edit = Callable[[np.ndarray], None]
PART = slice(300, 420)


def held(columns: tk.AccelColumns | tk.GyroColumns) -> Edit:
    """A sensor that repeats itself."""

    def edit(rows: np.ndarray) -> None:
        rows[PART, columns.x : columns.z + 1] = rows[PART.start, columns.x : columns.z + 1]

    return edit


def put(values: float, *columns: int, part: slice = PART) -> Edit:
    """Columns that have another value for a while."""

    def edit(rows: np.ndarray) -> None:
        rows[part, columns] = values

    return edit


def absent(columns: tuple[int, ...]) -> Edit:
    """A signal that never comes."""

    def edit(rows: np.ndarray) -> None:
        rows[:, list(columns)] = empty_rows(1)[0, list(columns)]

    return edit


def holes(rows: np.ndarray) -> None:
    for columns in (tk.ACCEL, tk.GYRO, tk.SPEED, tk.STEERING, tk.YAW_RATE, tk.LATERAL_ACCEL):
        at = RNG(columns.n).integers(0, TICKS, 12)
        rows[np.ix_(at, list(columns))] = empty_rows(1)[0, list(columns)]


def coarse(rows: np.ndarray) -> None:
    rows[:, tk.SPEED.mean] = np.round(rows[:, tk.SPEED.mean])
    rows[:, tk.YAW_RATE.mean] = np.round(rows[:, tk.YAW_RATE.mean], 2)


def standing(rows: np.ndarray) -> None:
    rows[PART, tk.SPEED.mean] = 0.0
    rows[PART, tk.ACCEL.x : tk.ACCEL.z + 1] = (0.0, 0.0, GRAVITY)
    rows[PART, tk.ACCEL.x] += 0.001 * np.arange(120)


def creeping(rows: np.ndarray) -> None:
    rows[PART, tk.SPEED.mean] = 0.2 + 0.001 * np.arange(120)
    rows[PART, tk.ACCEL.x : tk.ACCEL.z + 1] *= 0.01
    rows[PART, tk.ACCEL.z] += 0.99 * GRAVITY
    rows[PART, tk.GYRO.x : tk.GYRO.z + 1] *= 0.01


def reverse(rows: np.ndarray) -> None:
    rows[:, tk.REVERSE] = 0.0
    rows[PART, tk.REVERSE] = 1.0


def impossible(rows: np.ndarray) -> None:
    rows[[310, 500], tk.ACCEL.x] = 1e6
    rows[700, tk.SPEED.mean] = np.nan


def old_samples(rows: np.ndarray) -> None:
    rows[::2, tk.GYRO.age] = 0.1
    rows[1::3, tk.GYRO.age] = -0.02


UNUSUAL: dict[str, Edit] = {
    "nothing": lambda _: None,
    "stuck force": held(tk.ACCEL),
    "stuck rate": held(tk.GYRO),
    "stuck speed": put(14.0, tk.SPEED.mean),
    "slipping": put(5.0, tk.WHEEL_SPREAD.mean),
    "turning": put(5.0, tk.YAW_RATE.mean),
    "rejected": put(2.0, tk.ACCEL.bad, part=slice(300, 301)),
    "no yaw rate": absent(tk.YAW_RATE),
    "no steering": absent(tk.STEERING),
    "no gyroscope": absent(tk.GYRO),
    "no speed": absent(tk.SPEED),
    "holes": holes,
    "coarse": coarse,
    "standing": standing,
    "creeping": creeping,
    "reverse": reverse,
    "impossible": impossible,
    "old samples": old_samples,
}


def blocks_of(rows: np.ndarray, sizes: list[int]) -> list[tuple[SignalBlock, dict[str, int]]]:
    """Blocks, each with what had been counted; sizes: so many ticks are expected at a time."""
    maker, found, k = SignalBlockMaker(joint_settings()), [], 0
    for n in sizes:
        maker.expect(rows[k : k + n])
        for row in rows[k : k + n].tolist():
            if maker.push(row):
                found.append((maker.block(), dict(maker.health.counts) | maker.stuck))
        k += n
    assert k == len(rows)
    return found


@pytest.mark.parametrize("kind", UNUSUAL)
def test_blocks_that_were_expected_are_those_that_were_not_bit_for_bit(kind: str) -> None:
    rows = drive()
    UNUSUAL[kind](rows)
    alone = blocks_of(rows, [1] * TICKS)
    sizes = [700, 3, 400, TICKS - 1103]
    for (one, counted), (other, too) in zip(alone, blocks_of(rows, sizes), strict=True):
        assert counted == too
        assert one.sided.keys() == other.sided.keys()
        for signal, (values, known) in one.sided.items():
            assert np.array_equal(values, other.sided[signal][0])
            assert np.array_equal(known, other.sided[signal][1])
        for name, value in msgspec.structs.asdict(one).items():
            assert name == "sided" or np.array_equal(value, getattr(other, name)), name


def test_ticks_after_a_gap_are_not_those_that_were_expected() -> None:
    rows = drive()
    later = rows + 0.0
    later[:, tk.ACCEL.x] += 1.0
    maker = SignalBlockMaker(joint_settings())
    maker.expect(rows)
    maker.restart()
    found = []
    for row in later[:200].tolist():
        if maker.push(row):
            found.append(maker.block())
    sent = later[BLOCK_TICKS - LAG : 2 * BLOCK_TICKS - LAG, tk.ACCEL.x : tk.ACCEL.z + 1]
    np.testing.assert_allclose(found[1].force.mean(axis=0), sent.mean(axis=0), atol=0.03)


def test_a_block_says_of_a_ramp_what_it_was_at_the_middle_of_each_tick() -> None:
    rows = drive()
    slope = np.array([0.02, -0.01, 0.005])
    rows[:, tk.ACCEL.x : tk.ACCEL.z + 1] = slope * (rows[:, tk.T] - rows[:, tk.ACCEL.age])[:, None]
    rows[:, tk.ACCEL.z] += GRAVITY
    rows[:, tk.SPEED.mean] = 10.0 + 0.05 * (rows[:, tk.T] - rows[:, tk.SPEED.age])
    found = blocks_of(rows, [TICKS])[1:]
    assert len(found) > 15
    for b, (block, _) in enumerate(found, 1):
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
