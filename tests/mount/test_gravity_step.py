"""A step in gravity that the gyroscope did not see."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import GRAVITY
from imucald.mount.gravity_observer import GravityObserver
from imucald.mount.gravity_step import SETTLED, GravityStep
from imucald.mount.signal_blocks import BLOCK_TICKS
from signal_block import block

DEG = math.radians(1.0)


def watched(
    blocks: int,
    moved_at: int,
    moved: np.ndarray,
    seed: int,
    turning: bool = False,
    tracker: GravityObserver | None = None,
    is_good: bool = False,
) -> list[GravityStep | None]:
    """What is found block by block while the road's slope wanders, seen by the gyroscope as well.

    From block `moved_at` on the sensor is turned by the rotation vector `moved` without a pulse.
    """
    rng = np.random.default_rng(seed)
    tracker = tracker or GravityObserver()
    found: list[GravityStep | None] = []
    n = blocks * BLOCK_TICKS
    slope = 0.02 * np.sin(2.0 * np.pi * np.arange(n) / 470.0)
    bank = 0.02 * np.sin(2.0 * np.pi * np.arange(n) / 330.0)
    heading_rate = 0.25 * (np.sin(np.arange(n) / 90.0) > 0.8) if turning else np.zeros(n)
    up = np.stack([slope, bank, np.ones(n)], axis=1)
    rate = np.zeros((n, 3))
    # du/dt = -w x u, so that the vertical moves in the vehicle as slope and bank say
    du = np.gradient(up, 0.1, axis=0)
    rate[:, 0] = du[:, 1] + heading_rate * slope
    rate[:, 1] = -du[:, 0] + heading_rate * bank
    rate[:, 2] = heading_rate
    R_moved = rotation_from_vector(moved)
    for k in range(blocks):
        part = slice(k * BLOCK_TICKS, (k + 1) * BLOCK_TICKS)
        force = GRAVITY * up[part] + 0.05 * rng.standard_normal((BLOCK_TICKS, 3))
        turn = rate[part].copy()
        if k >= moved_at:  # R_vehicle_from_sensor = R_moved: the sensor's axes turned in the car
            force, turn = force @ R_moved, turn @ R_moved
        p = block(0.1 * BLOCK_TICKS * k, force=force, rate=turn)
        tracker.advance(p, np.zeros((BLOCK_TICKS, 3)), np.zeros(3), sure=True)
        found.append(tracker.steps.found(np.eye(3), is_good))
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "degrees"), [(0, 2.0), (0, -2.0), (1, 2.0), (1, -2.0)])
def test_a_step_is_found_within_a_minute_with_axis_sign_and_size(axis, degrees):
    moved = np.zeros(3)
    moved[axis] = degrees * DEG
    found = watched(80, 60, moved, 3)
    assert not any(found[:60])
    step = next(s for s in found[60:70] if s is not None)
    assert step.axis == axis
    assert step.size == pytest.approx(degrees * DEG, rel=0.35)


@pytest.mark.slow
def test_slopes_that_the_gyroscope_sees_are_no_step():
    for seed in range(3):
        assert not any(watched(120, 999, np.zeros(3), seed, turning=True))


def test_a_step_shows_how_long_ago_it_was():
    found = watched(80, 60, np.array([3.0 * DEG, 0.0, 0.0]), 5)
    block_found, step = next((k, s) for k, s in enumerate(found) if s is not None)
    assert abs((block_found + 1 - step.blocks) - 60) <= 1


@pytest.mark.parametrize(
    ("degrees", "is_good", "is_found"),
    [(5.0, True, True), (5.0, False, False), (2.2, True, False)],
)
def test_before_the_drive_has_shown_its_spread_a_step_is_large_and_the_mount_good(
    degrees, is_good, is_found
):
    assert SETTLED > 44
    found = watched(44, 34, np.array([degrees * DEG, 0.0, 0.0]), 5, is_good=is_good)
    assert not any(found[:34])
    assert any(found) == is_found
