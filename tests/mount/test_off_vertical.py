"""Gravity off the vertical: a block says so only where the turns in it are known."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.samples import GRAVITY
from imucald.motion.ticks import TICK_S
from imucald.mount.off_vertical_limit import is_off_vertical
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlock

LEVEL = np.eye(3)


def block(rate_known: bool, yaw_rate_known: bool, stands: bool) -> SignalBlock:
    """A block with 0.6 g to the left."""

    def all_of(flag: bool) -> np.ndarray:
        return np.full(BLOCK_TICKS, flag)

    zero = np.zeros(BLOCK_TICKS)
    return SignalBlock(
        t=np.arange(BLOCK_TICKS) * TICK_S,
        force=np.tile([0.0, 0.6 * GRAVITY, GRAVITY], (BLOCK_TICKS, 1)),
        rate=np.zeros((BLOCK_TICKS, 3)), speed=zero if stands else zero + 15.0, accel=zero,
        yaw_rate=zero, ok_force=all_of(True), ok_rate=all_of(rate_known), ok_speed=all_of(True),
        ok_yaw=all_of(yaw_rate_known), rest=all_of(stands), learn=all_of(True), steering=zero,
        ok_steering=all_of(False), had_rate=all_of(rate_known), gyro_bias=np.zeros(3),
    )  # fmt: skip


def test_a_hard_bend_that_no_signal_shows_is_no_lean():
    bend = block(rate_known=False, yaw_rate_known=False, stands=False)
    assert not is_off_vertical(bend, LEVEL, np.zeros(BLOCK_TICKS))


@pytest.mark.parametrize(
    ("rate_known", "yaw_rate_known", "stands"),
    [(True, False, False), (False, True, False), (False, False, True)],
)
def test_the_same_force_without_a_turn_is_lean(rate_known, yaw_rate_known, stands):
    leaning = block(rate_known, yaw_rate_known, stands)
    assert is_off_vertical(leaning, LEVEL, np.zeros(BLOCK_TICKS))


def test_the_force_of_a_bend_that_is_shown_is_no_lean():
    bend = block(rate_known=True, yaw_rate_known=False, stands=False)
    assert not is_off_vertical(bend, LEVEL, np.full(BLOCK_TICKS, 0.6 * GRAVITY))
