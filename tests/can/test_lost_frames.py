"""How many frames are told to be lost, of messages whose times are known."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.can.dbc.database import load_database_text
from imucald.can.lost_frames import lost_share

DATABASE = load_database_text(
    'VERSION ""\nNS_ :\nBS_:\nBU_: CAR\n'
    'BO_ 16 AXES: 4 CAR\n SG_ Axis M : 0|8@1+ (1,0) [0|0] "" CAR\n'
    + "".join(f' SG_ A{k} m{k} : 8|16@1- (1,0) [0|0] "" CAR\n' for k in range(1, 7))
    + 'BO_ 17 PLAIN: 4 CAR\n SG_ B : 0|8@1+ (1,0) [0|0] "" CAR\n',
    "dbc",
)


def test_six_axes_in_six_frames_one_after_the_other_are_no_loss():
    t = (0.01 * np.arange(1000)[:, None] + 0.0009 * np.arange(6)).ravel()
    assert lost_share(np.diff(t), DATABASE.message("AXES")) is None


@pytest.mark.parametrize("message", [DATABASE.message("PLAIN"), None])
def test_of_a_message_in_cycles_what_is_missing_is_lost(message):
    t = 0.01 * np.delete(np.arange(1000), np.arange(5, 1000, 10))
    assert lost_share(np.diff(t), message) == pytest.approx(0.1, abs=0.002)


def test_a_hole_of_some_tenths_of_a_second_is_loss_and_one_of_a_minute_is_not():
    t = 0.01 * np.arange(20_000)
    kept = np.ones(len(t), dtype=bool)
    for first in range(100, 20_000, 1000):
        kept[first : first + 50] = False
    assert lost_share(np.diff(t[kept])) == pytest.approx(0.05, abs=0.003)
    assert lost_share(np.diff(np.concatenate([t, t + 260.0]))) == 0.0


@pytest.mark.parametrize("share", [0.0, 0.1])
@pytest.mark.parametrize("clock_s", [1.0 / 64.0, 0.01, 1.0 / 60.0])
@pytest.mark.parametrize("cycle", [0.01, 0.02, 0.05, 0.1])
def test_stamps_of_a_coarse_clock_are_no_loss_and_hide_none(clock_s, cycle, share):
    """As a reader spreads them: up to one step of the clock late, and in order."""
    rng = np.random.default_rng(3)
    t = cycle * np.arange(4000) + 0.003
    kept = rng.random(len(t)) >= share
    t, share = t[kept], 1.0 - np.mean(kept)
    known = lost_share(np.diff(np.maximum.accumulate(t + clock_s * rng.random(len(t)))))
    assert known is None or known == pytest.approx(share, abs=0.015)
    assert known is not None or cycle <= 2.0 * clock_s


@pytest.mark.parametrize("clock_s", [1.0 / 64.0, 1.0 / 60.0])
@pytest.mark.parametrize("cycle", [0.02, 0.03, 0.05])
def test_stamps_that_are_rounded_down_to_a_coarse_clock_are_no_loss(clock_s, cycle):
    """Most stamps of a cycle of 20 ms are one step of 1/64 s apart: 22 % were said to be lost."""
    t = cycle * np.arange(4000) + 0.003
    known = lost_share(np.diff(np.floor(t / clock_s) * clock_s))
    assert known is None or known == pytest.approx(0.0, abs=0.001)
    assert known is not None or cycle <= 2.0 * clock_s


@pytest.mark.parametrize("scatter", [0.1, 0.2, 0.4])
def test_answers_to_requests_that_follow_one_another_are_no_loss(scatter):
    """Each request follows the answer before it, so that no clock says when a frame is due."""
    rng = np.random.default_rng(4)
    assert lost_share(0.1 * np.exp(scatter * rng.standard_normal(2000))) is None


def test_frames_that_come_twice_do_not_halve_the_cycle():
    t = 0.5 * np.arange(4000.0)
    twice = np.sort(np.concatenate([t, t[::300] + 0.01]))
    assert lost_share(np.diff(twice)) == pytest.approx(0.0, abs=0.001)


@pytest.mark.parametrize("apart", [2e-5, 8e-5])
def test_frames_that_an_adapter_hands_over_in_batches_are_no_loss(apart):
    place = np.arange(4000)
    t = 0.01 * (place // 10 * 10 + 9) + apart * (place % 10)
    assert lost_share(np.diff(t)) is None
