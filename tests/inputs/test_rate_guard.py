"""How often an input may come, and two senders of one."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.can.e2e.protection import DOUBLED
from imucald.inputs.rate_guard import DUPLICATE, TOO_FAST, RateGuard, Spaced


def sent(hz: float, start: float, stop: float, seed: int = 0) -> np.ndarray:
    """Times of frames with jitter of a third of a cycle."""
    rng = np.random.default_rng(seed)
    t = np.arange(start, stop, 1.0 / hz)
    return np.sort(t + rng.uniform(0.0, 0.33 / hz, len(t)))


def judged(guard: RateGuard, t: np.ndarray, reasons: list[str] | None = None) -> list[str]:
    reasons = reasons or [""] * len(t)
    return [guard.judge(float(x), r) for x, r in zip(t, reasons, strict=True)]


@pytest.mark.parametrize("stated", [None, 0.01, 0.02])
@pytest.mark.parametrize("hz", [1.0, 10.0, 100.0, 200.0])
def test_one_sender_is_let_through_whatever_cycle_is_stated(
    hz: float, stated: float | None
) -> None:
    assert set(judged(RateGuard(stated), sent(hz, 0.3, 60.0))) == {""}


def test_a_stall_and_what_was_held_back_harm_nobody() -> None:
    t = sent(100.0, 0.0, 60.0)
    t[(t > 30.0) & (t < 32.0)] = 32.0
    assert set(judged(RateGuard(0.01, counted=True), t)) == {""}


def test_no_more_than_one_frame_in_0_4_cycles_is_taken() -> None:
    t = np.sort(np.concatenate([sent(100.0, 0.0, 30.0), sent(10_000.0, 20.0, 21.0)]))
    verdicts = judged(RateGuard(0.01), t)
    flood = [reason for x, reason in zip(t, verdicts, strict=True) if 20.0 <= x < 21.0]
    assert flood.count("") == 250
    assert set(flood) == {"", TOO_FAST}


@pytest.mark.parametrize("times", [1.0, 16.0])
def test_a_second_sender_ends_the_trust_until_it_falls_silent(times: float) -> None:
    """Its counter goes on for itself, so that one of both is always out of order."""
    own, other = sent(100.0, 0.0, 60.0), sent(100.0 * times, 20.0, 40.0, 1)
    t = np.concatenate([own, other])
    breaks = np.concatenate([(own > 20.0) & (own < 40.0), np.zeros(len(other), bool)])
    order = np.argsort(t)
    reasons = np.where(breaks, "counter_jump", "")[order].tolist()
    verdicts = np.array(judged(RateGuard(None, counted=True), t[order], reasons))
    t = t[order]
    good = (verdicts == "") | (verdicts == TOO_FAST)
    assert good[t < 20.0].all()
    assert not (verdicts[(t > 25.0) & (t < 40.0)] == "").any()
    assert DUPLICATE in verdicts
    assert (verdicts[t > 47.0] == "").all()


def test_copies_of_frames_are_no_second_sender_whatever_is_lost() -> None:
    """A logger that writes all twice, and a bus that loses one frame in eight."""
    once, twice = sent(100.0, 0.0, 20.0), np.repeat(sent(100.0, 20.0, 40.0), 2)
    reasons = [""] * len(once) + ["counter_jump" if i % 16 == 0 else DOUBLED if i % 2 else ""
                                  for i in range(len(twice))]  # fmt: skip
    t = np.concatenate([once, twice])
    assert judged(RateGuard(None, counted=True), t, reasons) == reasons


def test_a_sender_that_wakes_up_is_no_second_one() -> None:
    t = np.concatenate([sent(10.0, 0.0, 30.0), sent(100.0, 30.0, 60.0)])
    for counted in (True, False):
        assert set(judged(RateGuard(None, counted), t)) == {""}


@pytest.mark.parametrize("seed", range(20))
def test_columns_say_what_single_frames_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.sort(np.concatenate([
        sent(100.0, 0.0, 40.0, seed), sent(float(rng.choice([90.0, 900.0])), 15.0, 25.0, seed + 1)
    ]))  # fmt: skip
    kinds = ["", "", "", "counter_jump", "checksum", DOUBLED]
    reasons = [str(x) for x in rng.choice(kinds, len(t))]
    single, other = RateGuard(0.01, counted=True), RateGuard(0.01, counted=True)
    expected = judged(single, t, reasons)
    got, start = [], 0
    while start < len(t):
        stop = min(len(t), start + int(rng.integers(1, 900)))
        verdicts = np.array(reasons[start:stop], dtype=object)
        by_reason = {r: np.flatnonzero(verdicts == r) for r in set(reasons[start:stop]) - {""}}
        refused = other.judge_columns(t[start:stop], verdicts == "", by_reason)
        for reason, rows in refused.items():
            verdicts[rows] = reason
        got += verdicts.tolist()
        start = stop
    assert got == expected
    assert DUPLICATE in got or TOO_FAST in got or seed % 2 == 0 or len(set(got)) > 1


def test_not_available_is_stated_once_a_cycle_and_jitter_loses_none() -> None:
    regular, flood = Spaced(0.01), Spaced(0.01)
    assert regular.among(sent(100.0, 0.0, 10.0)).all()
    let = flood.among(sent(10_000.0, 0.0, 10.0))
    assert 990 <= let.sum() <= 1060
