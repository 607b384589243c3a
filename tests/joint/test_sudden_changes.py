"""Sudden changes: a sensor that is turned, and a zero that steps, on drives in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import GRAVITY
from imucald.mount.joint.evidence import Block, Evidence
from imucald.mount.joint.state import Priors
from imucald.mount.joint.sudden_changes import SuddenChange
from joint.planar_drive import ROTATION, Array, Sensor, blocks

LEVEL_ROADS = Priors(crown=(0.0, 0.002), slope=0.002)
AT, TICKS = 60, 64
PULSE = 5
"""Ticks within which a sensor turns, where the gyroscope feels it."""


def steps(made: list[Block]) -> list[SuddenChange | None]:
    """What is found after each block from `AT` on."""
    evidence, found = Evidence(LEVEL_ROADS), []
    for k, block in enumerate(made):
        evidence.add_block(block)
        evidence.solve_when_due()
        if k >= AT:
            found.append(evidence.sudden_change())
    return found


def certain(found: list[SuddenChange | None]) -> list[SuddenChange]:
    return [one for one in found if one is not None and one.is_certain]


def decided(found: list[SuddenChange | None]) -> SuddenChange:
    return next(one for one in certain(found) if one.is_decided)


def driven(bends: float = 1.0, seed: int = 0) -> list[Block]:
    return blocks(8.0, Sensor(), seed=seed, bends=bends)


def turned(made: list[Block], vector: Array, is_felt: bool) -> list[Block]:
    """The sensor is turned by a rotation vector in vehicle axes [rad] before block `AT`."""
    R = ROTATION.T @ rotation_from_vector(vector).T @ ROTATION
    out = []
    for k, b in enumerate(made):
        if k < AT:
            out.append(b)
            continue
        rate = b.rate @ R.T
        if is_felt and k == AT:
            rate[:PULSE] += ROTATION.T @ vector / (0.1 * PULSE)
        out.append(b._replace(force=b.force @ R.T, rate=rate))
    return out


def stepped(made: list[Block], zero: Array, until: int = 999) -> list[Block]:
    """The zero changes by (3,) in vehicle axes [m/s^2] at block `AT`, until another one."""
    off = ROTATION.T @ zero
    return [b._replace(force=b.force + off) if AT <= k < until else b for k, b in enumerate(made)]


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize(("degrees", "is_felt"), [(3.0, False), (-6.0, False), (-10.0, True)])
def test_a_turn_is_found_within_a_minute_with_axis_sign_and_size(
    axis: int, degrees: float, is_felt: bool
) -> None:
    vector = np.radians(degrees) * np.eye(3)[axis]
    found = steps(turned(driven(), vector, is_felt))
    step = decided(found[:10])
    assert step.is_turn
    until_then = next(k for k, one in enumerate(found) if one is step)
    off = np.abs(step.size - vector)
    assert off[axis] < 0.25 * abs(vector[axis])
    assert off.max() < np.radians(1.2)
    assert abs(step.blocks - until_then - 1) <= 1


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("size", [0.4, -1.0])
def test_a_step_of_a_zero_is_found_within_a_minute_with_its_size(axis: int, size: float) -> None:
    zero = size * np.eye(3)[axis]
    step = decided(steps(stepped(driven(), zero))[:10])
    assert not step.is_turn
    np.testing.assert_allclose(step.size, zero, atol=0.15 * abs(size))
    assert step.level == pytest.approx(GRAVITY, abs=0.05)


@pytest.mark.parametrize("seed", range(4))
def test_a_sound_drive_has_none(seed: int) -> None:
    found = [one for one in steps(driven(seed=seed)) if one is not None]
    assert max(one.log_odds for one in found) < -5.0


@pytest.mark.parametrize("is_turn", [True, False])
def test_without_a_bend_the_question_stays_open_or_is_decided_right_and_the_onset_is_kept(
    is_turn: bool,
) -> None:
    made = driven()[:AT] + driven(bends=0.0)[AT:]
    if is_turn:
        made = turned(made, np.array([0.06, 0.0, 0.0]), is_felt=False)
    else:
        made = stepped(made, np.array([0.0, 0.6, 0.0]))
    found = steps(made)
    assert len(found) > 12
    assert len(certain(found)) >= len(found) - 3
    assert not any(one.is_decided for one in certain(found[:4]))
    assert not any(one.is_decided and one.is_turn != is_turn for one in certain(found))
    last = found[-1]
    assert last is not None
    assert abs(last.blocks - len(found)) <= 2


def test_a_gyroscope_that_sends_seldom_lets_the_vertical_walk_and_makes_no_step() -> None:
    rng = np.random.default_rng(2)
    walk = 0.01**2 * np.eye(3)  # the angle, 0.6 deg a root second

    def shaken(is_stated: bool) -> list[Block]:
        return [
            b._replace(
                rate=b.rate + 0.01 * rng.standard_normal(b.rate.shape) / np.sqrt(0.1) * (k >= AT),
                rate_walk=walk if is_stated else np.zeros((3, 3)),
            )
            for k, b in enumerate(driven())
        ]

    assert certain(steps(shaken(is_stated=False))), "nothing is tested otherwise"
    assert not certain(steps(shaken(is_stated=True)))


def test_time_that_jumps_hides_no_turn() -> None:
    made = turned(driven(), np.array([0.0, 0.08, 0.0]), is_felt=False)
    evidence, found = Evidence(LEVEL_ROADS), []
    for k, block in enumerate(made):
        if k == AT:
            evidence.gap()
        evidence.add_block(block)
        evidence.solve_when_due()
        found.append(evidence.sudden_change())
    assert any(one.is_turn for one in certain(found[AT:]))
