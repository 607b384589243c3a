"""A tilt while the vehicle stands: a gyroscope that felt it tells a turn from a stepped zero."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import GRAVITY
from imucald.mount.hand_moves import HandMove, HandMoves
from imucald.mount.mount_changes import _may_be_zero
from imucald.mount.signal_blocks import BLOCK_S, BLOCK_TICKS
from signal_block import block

PULSE = 5


def found(degrees: float, is_felt: bool) -> HandMove | None:
    """What a stop shows in whose fourth block the sensor rolls within half a second."""
    rng, detector = np.random.default_rng(3), HandMoves()
    turn = np.array([np.radians(degrees), 0.0, 0.0])
    for k in range(8):
        R = rotation_from_vector(turn) if k >= 3 else np.eye(3)
        force = np.tile([0.0, 0.0, GRAVITY], (BLOCK_TICKS, 1)) @ R
        rate = 0.001 * rng.standard_normal((BLOCK_TICKS, 3))
        if is_felt and k == 3:
            rate[:PULSE] += turn / (0.1 * PULSE)
        force = force + 0.02 * rng.standard_normal(force.shape)
        rest, still = np.ones(BLOCK_TICKS, dtype=bool), np.zeros(BLOCK_TICKS)
        p = block(BLOCK_S * k, force=force, rate=rate, speed=still, rest=rest)
        change = detector.while_standing(p, np.eye(3))
        if change is not None:
            return change
    return None


@pytest.mark.parametrize("degrees", [6.0, -12.0])
def test_a_tilt_that_the_gyroscope_felt_is_no_zero(degrees: float) -> None:
    change = found(degrees, is_felt=True)
    assert change is not None
    assert change.axis == 0
    assert np.degrees(change.size) == pytest.approx(degrees, abs=0.5)
    assert change.is_felt
    assert not _may_be_zero(change)


@pytest.mark.parametrize(("degrees", "may_be"), [(6.0, True), (-12.0, True), (30.0, False)])
def test_a_tilt_that_nothing_felt_may_be_a_zero_unless_it_is_too_large(
    degrees: float, may_be: bool
) -> None:
    change = found(degrees, is_felt=False)
    assert change is not None
    assert not change.is_felt
    assert _may_be_zero(change) is may_be
