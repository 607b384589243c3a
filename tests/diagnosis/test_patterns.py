"""Values that are held, and residuals that depend on their own signal."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dct
from scipy.stats import binom

from imucald.core.samples import Series
from imucald.diagnosis.direct.held_values import held_values
from imucald.diagnosis.fit.chance import beyond_chance
from imucald.diagnosis.left_over.patterns import (
    LARGE,
    SHAKEN_S,
    SHAPES,
    ShapeRows,
    _asked,
    _gram,
    _shapes,
)
from imucald.diagnosis.signals import STEP_S, drive_of

SECONDS = 300.0
BLOCKS, ROWS = 40, 64
TOP_HZ = 1.0
"""Where the equations' band ends."""


def drive(dead=0.0, lsb=0.0005, noise=0.01):
    """A gyroscope that shows no rate below `dead` [rad/s], in steps of `lsb`."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, SECONDS, 0.01)
    slow = np.column_stack([0.1 * np.sin(t / k) for k in (3.0, 5.0, 7.0)])
    gyro = slow + noise * rng.standard_normal((len(t), 3))
    gyro = np.sign(gyro) * np.maximum(np.abs(gyro) - dead, 0.0)
    accel = rng.standard_normal((len(t), 3))
    accel[:, 2] += 9.81
    at = np.arange(0.0, SECONDS, 0.1)
    return drive_of(
        {
            "accel": Series(t, np.round(accel / 0.01) * 0.01),
            "gyro": Series(t, np.round(gyro / lsb) * lsb),
            "speed": Series(at, 15.0 + np.sin(at)),
        }
    )


def test_a_dead_zone_is_a_value_that_is_held():
    found = held_values([drive(dead=0.03)])
    assert {s.signal for s in found} == {"gyro_x", "gyro_y", "gyro_z"}
    assert all("0 rad/s" in s.text for s in found)


@pytest.mark.parametrize(("lsb", "noise"), [(0.0005, 0.01), (0.02, 0.004)])
def test_a_sound_sensor_holds_no_value_nor_does_a_coarse_one(lsb, noise):
    assert held_values([drive(lsb=lsb, noise=noise)]) == []


def left_over(kind: str, size: float, seed: int = 5, blocks: int = BLOCKS, rows: int = ROWS,
              quiet: int = 0, gain: float = 0.0):  # fmt: skip
    """Blocks of a residual of unit noise with a shape in it. Truth by its own formula.

    turning: of a yaw rate of its own [rad/s], of either sign. quiet: last blocks in which the
    signal hardly moves. gain: share of the signal itself that is left beside the shape.
    """
    rng = np.random.default_rng(seed)
    n = blocks * rows
    x = np.convolve(rng.standard_normal(n + 8), np.ones(9) / 3.0, "valid")
    x[n - quiet * rows :] *= 0.05
    held, state, large = np.zeros(n), 0.0, np.std(x)
    for k in range(n):
        state = float(np.sign(x[k])) if abs(x[k]) > large else state
        held[k] = state
    one_sided = np.where(x > 0.0, np.gradient(x, 0.1), 0.0)
    rate = np.convolve(
        np.random.default_rng(seed + 100).standard_normal(n + 20), np.ones(21), "valid"
    )
    amount = np.gradient(np.abs(0.02 * rate), 0.1)
    made = {"line": x, "memory": held, "bent": np.tanh(2.0 * x), "late on one side": one_sided,
            "uneven gain": np.abs(x), "turning": amount,
            "late": np.append(x[:1], x[:-1]) - x,
            "low pass": np.convolve(x, np.ones(5) / 5.0, "same") - x,
            "turning to one side": np.gradient(0.02 * rate, 0.1)}[kind]  # fmt: skip
    y = 0.05 * rng.standard_normal(n) + size * made + gain * x
    of_signal, shaken = _shapes(x, TOP_HZ), rng.random((n, len(SHAKEN_S)))
    every = np.concatenate([of_signal, shaken, amount[:, None]], axis=1)
    shapes = every.reshape(blocks, rows, -1)
    tilt = np.ones((blocks, rows, 1))
    # Blocks are handed over transformed; time in a block counts where parts of it are told apart.
    count = int(2.0 * rows * STEP_S * TOP_HZ)
    y, shapes, tilt = (dct(part, type=2, axis=1, norm="ortho")[:, :count]
                       for part in (y.reshape(blocks, rows), shapes, tilt))  # fmt: skip
    return _gram([ShapeRows(y, shapes, tilt, rows)])


def patterns_of(name, gram):
    return beyond_chance(list(_asked(name, gram)))


@pytest.mark.parametrize("kind", ["memory", "bent", "late on one side"])
def test_what_depends_on_its_own_signal_is_seen(kind):
    gram = left_over(kind, 0.15)
    found = patterns_of("accel_x", gram)
    assert len(found) == 1
    assert found[0].signal == "accel_x"


@pytest.mark.parametrize("seed", range(6))
def test_what_is_linear_in_its_signal_is_no_pattern(seed):
    gram = left_over("line", 0.3, seed)
    assert patterns_of("accel_x", gram) == []


def test_a_speed_that_goes_with_the_amount_of_turning_is_seen_whatever_its_zero_may_be():
    gram = left_over("turning", -0.75)
    found = patterns_of("accel_x", gram)
    assert [s.signal for s in found] == ["accel_x"]
    assert "how much the vehicle turns" in found[0].text


@pytest.mark.parametrize(
    ("kind", "metres"), [("turning", -0.2), ("turning to one side", -0.75), ("line", 0.3)]
)
def test_a_speed_of_a_point_beside_the_middle_does_not_go_with_the_amount(kind, metres):
    """0.2 m: no more than that point is known to. To one side: the signed rate, which is odd."""
    gram = left_over(kind, metres)
    assert not any("turns" in s.text for s in patterns_of("accel_x", gram))


def test_less_than_a_correct_zero_may_be_is_not_reported():
    gram = left_over("memory", 0.02)
    assert patterns_of("accel_x", gram) == []


def chances(kind, size, seeds, *sizes):
    """(seeds, shapes)"""
    return np.array(
        [[q.p for q in _asked("accel_x", left_over(kind, size, s, *sizes))] for s in range(seeds)]
    )


def most_by_chance(seeds, p):
    """Share of seeds below p that one of all shapes passes in one run of a hundred (binomial)."""
    return binom.isf(0.01 / len(SHAPES), seeds, p) / seeds


@pytest.mark.parametrize("kind", ["line", "late", "low pass"])
def test_of_what_is_linear_chances_are_no_smaller_than_they_say(kind):
    """Of each shape but for chance of the count, and of all together: a gain, a delay of 0.1 s, a
    mean over 0.5 s."""
    p = chances(kind, 0.3, 60)
    assert p.shape[1] == len(SHAPES)
    assert np.mean(p < 0.05) < 0.05
    assert np.mean(p < 0.05, axis=0).max() <= most_by_chance(60, 0.05)


@pytest.mark.parametrize("kind", ["line", "memory"])
def test_a_gain_that_is_off_changes_no_chance(kind):
    """Neither of what is not there nor of what is: 3 % of it beside a gain of 30 %."""
    without, beside = (
        [q.p for q in _asked("accel_x", left_over(kind, 0.03, gain=gain))] for gain in (0.0, 0.3)
    )
    assert beside == pytest.approx(without, rel=1e-6)


@pytest.mark.parametrize("quiet", [0, 6])
def test_of_few_blocks_chances_are_no_smaller_than_they_say(quiet):
    """Nine blocks of 20 s, also where three of them hold all that there is to know."""
    p = chances("line", 0.3, 60, 9, 200, quiet)
    assert np.mean(p < 0.05) < 0.05
    assert np.mean(p < 0.05, axis=0).max() <= most_by_chance(60, 0.05)
    assert np.mean(p < 0.002) < 0.002


def test_of_few_blocks_what_depends_on_its_own_signal_is_seen():
    assert patterns_of("accel_x", left_over("memory", 0.15, 5, 9, 200)) != []


@pytest.mark.parametrize(("share", "seen"), [(0.08, True), (0.01, False)])
def test_a_gain_that_differs_between_the_sides_is_held_against_what_a_gain_may_be(share, seen):
    """Of a signal of rms 1; 8 % of its amount is 0.05 about its mean, below a zero's 0.06."""
    found = patterns_of("accel_x", left_over("uneven gain", share, 5, 120))
    assert any("positive and negative values" in s.text for s in found) == seen


def test_memory_is_that_of_the_last_large_value():
    x = np.array([0.0, 0.1, 3.0, 0.1, -0.1, -3.0, -0.1, 0.2] * 4)
    memory = _shapes(x, 4.0)[:, -len(LARGE) :]
    assert memory[3, 1] == 1.0
    assert memory[7, 1] == -1.0
