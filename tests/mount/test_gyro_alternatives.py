"""How many blocks it takes to accuse the gyroscope of another sign or another order of axes."""

from __future__ import annotations

import numpy as np

from imucald.mount.log_ratios import HELD, TRIED, LogRatios

AGAINST = np.full(len(TRIED) - 1, -100.0)
FOR = -AGAINST


def after(blocks: int) -> LogRatios:
    """A long sound drive, and then so many blocks that speak for another sign with all they have.

    Each counts for little in the sum over the whole drive, which has that drive against it.
    """
    found = LogRatios(len(FOR))
    for _ in range(20):
        found.add_ratios(FOR)
    assert found.sum == HELD
    for _ in range(blocks):
        found.add_ratios(AGAINST)
    return found


def test_three_blocks_accuse_of_no_turn_in_mid_drive_and_four_do():
    assert not after(3).is_accused
    assert after(4).is_accused


def test_blocks_that_speak_for_the_axes_as_they_are_take_back_what_some_said_against():
    found = after(3)
    for ratios in (FOR, FOR, FOR, AGAINST, AGAINST, AGAINST):
        found.add_ratios(ratios)
    assert not found.is_accused


def test_what_is_forgotten_accuses_of_nothing_more():
    found = after(4)
    assert found.is_accused
    found.forget()
    assert not found.is_accused
    for _ in range(3):
        found.add_ratios(AGAINST)
    assert not found.is_accused
