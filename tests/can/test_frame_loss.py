"""Lost frames are no fault, whoever reads the counter; frames that another node puts in are."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.can.dbc.bits import Field
from imucald.can.e2e.checksums import crc8_j1850
from imucald.can.e2e.protection import REASONS, MessageChecker
from imucald.can.e2e.protection_spec import CounterSpec, ProtectionSpec
from imucald.can.e2e.protector import MessageProtector

SIZE, CYCLE = 8, 0.01
SEEDS = range(20)
Drive = tuple[np.ndarray, np.ndarray]
"""Stamps [s] and bytes of frames."""


def spec_of(bits: int = 4, stated: float | None = CYCLE) -> ProtectionSpec:
    counter = CounterSpec(Field(8, bits, "little_endian"), 1 << bits)
    return ProtectionSpec(SIZE, counter, crc8_j1850(SIZE, 0, b"\x02\x00"), stated)


def sent(spec: ProtectionSpec, count: int, seed: int, *, jitter: float = 0.1) -> Drive:
    """Frames of a sound sender; jitter in cycles."""
    rng = np.random.default_rng(seed)
    data = MessageProtector(spec).protect_columns(rng.integers(0, 256, (count, SIZE), np.uint8))
    t = 100.0 + CYCLE * (np.arange(count) + rng.uniform(0.0, jitter, count))
    return np.sort(t), data


def judged(spec: ProtectionSpec, t: np.ndarray, data: np.ndarray) -> tuple[MessageChecker, list]:
    checker = MessageChecker(spec)
    codes = checker.check_columns(t, data, np.full(len(t), SIZE, np.uint8))
    return checker, [REASONS[code] for code in codes]


def lost(rng: np.random.Generator, count: int, share: float, burst: int) -> np.ndarray:
    """Which frames (N,) are lost: so many in a row, and this share of all."""
    starts = np.flatnonzero(rng.random(count) < share / burst)
    gone = np.zeros(count, dtype=bool)
    for start in starts:
        gone[start : start + burst] = True
    gone[0] = gone[-1] = False
    return gone


@pytest.mark.parametrize("stated", [None, CYCLE])
@pytest.mark.parametrize("bits", [2, 4, 8])
@pytest.mark.parametrize("burst", [1, 5])
@pytest.mark.parametrize("share", [0.01, 0.05, 0.1])
def test_lost_frames_cost_themselves_and_are_counted(share, burst, bits, stated) -> None:
    spec = spec_of(bits, stated)
    if burst >= 1 << bits:
        burst = 2
    for seed in range(3):
        t, data = sent(spec, 6000, seed)
        gone = lost(np.random.default_rng(seed), len(t), share, burst)
        checker, verdicts = judged(spec, t[~gone], data[~gone])
        learning = np.count_nonzero(t[~gone] < 105.5)  # a two-bit counter says little by itself
        assert set(verdicts[learning:]) == {""}
        assert verdicts[:learning].count("") >= (0.6 if bits == 2 else 1.0) * learning
        if bits > 2:
            assert 0.85 * gone.sum() <= checker.lost <= gone.sum()


def batches(t: np.ndarray) -> np.ndarray:
    """Stamps of an adapter that hands over each 0.2 s."""
    return np.ceil(t * 5.0) / 5.0


def stalls(t: np.ndarray) -> np.ndarray:
    """A queue that stands for 0.4 s, every 7 s."""
    into = t % 7.0
    return np.where((into > 3.0) & (into < 3.4), t - into + 3.4, t)


def late(t: np.ndarray) -> np.ndarray:
    """20 ms of jitter: two cycles, the order kept."""
    return np.maximum.accumulate(t + np.random.default_rng(1).uniform(0.0, 0.02, len(t)))


@pytest.mark.parametrize("stated", [None, CYCLE])
@pytest.mark.parametrize("share", [0.0, 0.05])
@pytest.mark.parametrize("stamp", [
    batches, stalls, late, np.floor, np.round, lambda t: np.round(t, 2), lambda t: 1.002 * t,
    lambda t: 1.0 + 0.6 * t, lambda t: 1.6 * t, lambda t: np.where(t > 120.0, t + 30.0, t),
])  # fmt: skip
def test_coarse_late_and_held_back_stamps_cost_no_frame(stamp, share, stated) -> None:
    spec = spec_of(stated=stated)
    for seed in range(3):
        t, data = sent(spec, 6000, seed, jitter=0.3)
        kept = ~lost(np.random.default_rng(seed), len(t), share, 1)
        _, verdicts = judged(spec, stamp(t[kept]), data[kept])
        assert set(verdicts) == {""}


@pytest.mark.parametrize("stamp", [np.floor, np.round, batches])
def test_coarse_stamps_cost_no_frame_in_an_hour(stamp) -> None:
    t, data = sent(spec_of(), 360_000, 1, jitter=0.3)
    kept = ~lost(np.random.default_rng(1), len(t), 0.02, 2)
    assert set(judged(spec_of(stated=None), stamp(t[kept]), data[kept])[1]) == {""}


@pytest.mark.parametrize("faster", [2.0, 3.0, 10.0])
def test_a_sender_that_goes_on_faster_is_believed_again_within_a_second(faster) -> None:
    spec = spec_of(stated=None)
    t, data = sent(spec, 6000, 1)
    t = np.where(t > 130.0, 130.0 + (t - 130.0) / faster, t)
    _, verdicts = judged(spec, t, data)
    bad = t[[v != "" for v in verdicts]]
    assert len(bad) == 0 or (bad[0] >= 130.0 and bad[-1] < 131.0)


def test_a_clock_that_is_set_back_loses_no_message_for_good() -> None:
    """Stream time stands until the stamps have caught up."""
    spec = spec_of()
    t, data = sent(spec, 6000, 1)
    t = np.maximum.accumulate(np.where(t > 130.0, t - 3.0, t))
    _, verdicts = judged(spec, t, data)
    assert set(np.array(verdicts)[t > 131.0]) == {""}


def test_repeated_reversed_and_impossible_counters_are_faults() -> None:
    spec = spec_of()
    t, data = sent(spec, 4000, 1)
    for ahead, reason in ((0, "repeated"), (-1, "reversed"), (-3, "reversed"), (6, "jump")):
        order = np.arange(len(t))
        order[3000] = order[2999] + ahead
        _, verdicts = judged(spec, t, data[order])
        assert verdicts[2999:3001] == ["", f"counter_{reason}"]
        assert verdicts[3001] != ""


# ---- frames of another node that knows checksum and counter ----


def spoofed(
    spec: ProtectionSpec, seed: int, *, burst: int, each_s: float, jitter: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A minute of frames, from 30 s on with others put in; the last array: which those are."""
    t, data = sent(spec, 6000, seed, jitter=jitter)
    protector, rng = MessageProtector(spec), np.random.default_rng(seed)
    at = np.arange(130.0 + 0.01 * rng.random(), 159.0, each_s)
    behind = np.unique(np.searchsorted(t, at))
    times, frames = [t], [data]
    for row in behind:
        protector._next = (int(data[row, 1]) & 0xF) + 1 & 0xF
        gap = 0.0003 if burst > 1 else 0.0005
        times.append(t[row] + gap * np.arange(1, burst + 1))
        frames.append(protector.protect_columns(rng.integers(0, 256, (burst, SIZE), np.uint8)))
    when = np.concatenate(times)
    order = np.argsort(when, kind="stable")
    is_other = np.arange(len(when)) >= len(t)
    return when[order], np.concatenate(frames)[order], is_other[order]


@pytest.mark.parametrize("jitter", [0.02, 0.3])
@pytest.mark.parametrize(
    ("burst", "each_s"), [(16, 1.0), (16, 0.28), (8, 0.2), (1, 0.1), (1, 0.04)]
)
def test_frames_put_in_behind_true_ones_do_not_pass(burst, each_s, jitter) -> None:
    passed = total = true = 0
    spec = spec_of()
    for seed in SEEDS:
        t, data, is_other = spoofed(spec, seed, burst=burst, each_s=each_s, jitter=jitter)
        _, verdicts = judged(spec, t, data)
        good = np.array(verdicts) == ""
        assert good[~is_other & (t < 130.0)].all()
        passed += np.count_nonzero(good & is_other)
        total += np.count_nonzero(is_other)
        true += np.count_nonzero(good & ~is_other & (t > 130.0))
        assert np.count_nonzero(good & is_other) * CYCLE <= 2.0
    assert passed <= 0.01 * total
    assert true > 0


@pytest.mark.parametrize("behind", [0.5, 0.9])
@pytest.mark.parametrize("ahead", [1, 2])
def test_of_frames_put_in_before_true_ones_one_passes_and_ends_trust(behind, ahead) -> None:
    """The true one with the same counter, 1 to 5 ms later, shows that there are two senders."""
    spec = spec_of()
    t, data = sent(spec, 18_000, 4, jitter=0.02)
    rows = np.arange(6000, 17_000, 20)
    forged = data[(rows + ahead) % len(data)].copy()
    forged[:, 2:] ^= 0x55
    protector = MessageProtector(spec)
    for row, at in zip(forged, rows, strict=True):
        protector._next = int(data[at + ahead, 1] & 15)
        row[:] = protector.protect_columns(row[None])[0]
    every = np.concatenate([t, t[rows] + behind * CYCLE])
    order = np.argsort(every, kind="stable")
    checker, verdicts = judged(spec, every[order], np.concatenate([data, forged])[order])
    is_forged = (order >= len(t)).tolist()
    good = [a for a, verdict in zip(is_forged, verdicts, strict=True) if not verdict]
    assert sum(good) <= 1
    late = every[order] > t[rows[-1]] + 2.1
    assert set(np.array(verdicts)[late]) == {""}, "trusted again"
    single = MessageChecker(spec)
    frames = zip(every[order], np.concatenate([data, forged])[order], strict=True)
    assert [single.check(at, row.tobytes()) or "" for at, row in frames] == verdicts
    assert single.past == checker.past


@pytest.mark.parametrize("stated", [CYCLE, None])
@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_a_sender_that_forgets_to_count_is_no_second_sender(jitter, stated) -> None:
    """Two senders with one counter are less than a cycle apart."""
    spec = spec_of(stated=stated)
    t, data = sent(spec, 6000, 5, jitter=jitter)
    forgets = np.arange(1000, 6000, 150)
    protector = MessageProtector(spec)
    for i, row in enumerate(data):
        if i in forgets:
            protector._next = int(data[i - 1, 1] & 15)
        row[:] = protector.protect_columns(row[None])[0]
    checker, verdicts = judged(spec, t, data)
    assert np.flatnonzero(np.array(verdicts) == "counter_repeated").tolist() == forgets.tolist()
    assert checker.rejected["untrusted"] == 3 * len(forgets)
    single = MessageChecker(spec)
    frames = zip(t, data, strict=True)
    assert [single.check(at, row.tobytes()) or "" for at, row in frames] == verdicts


@pytest.mark.parametrize("seed", SEEDS)
def test_a_delayed_frame_followed_closely_by_the_next_is_a_normal_thing(seed) -> None:
    spec, rng = spec_of(), np.random.default_rng(seed)
    t, data = sent(spec, 6000, seed)
    slow = rng.random(len(t)) < 0.05
    t[slow] += rng.uniform(0.5, 1.0, slow.sum()) * CYCLE * 0.95
    t = np.maximum.accumulate(t)
    _, verdicts = judged(spec, t, data)
    assert set(verdicts) == {""}


@pytest.mark.parametrize("burst", [8, 12])
@pytest.mark.parametrize("stated", [None, CYCLE])
def test_a_long_hole_is_no_old_frame_before_the_cycle_is_learnt(stated, burst) -> None:
    """A four-bit counter that is eight ahead could be eight behind as well."""
    spec = spec_of(stated=stated)
    for seed in SEEDS:
        t, data = sent(spec, 450, seed)
        kept = np.ones(len(t), dtype=bool)
        for start in np.random.default_rng(seed).integers(3, 60, 5).cumsum() + burst * np.arange(5):
            kept[start : start + burst] = False
        assert set(judged(spec, t[kept], data[kept])[1]) == {""}
    _, verdicts = judged(spec, t[:200], data[np.r_[:150, 147:197]])
    assert verdicts[150] == "counter_reversed"


@pytest.mark.parametrize("each_s", [0.28, 1.0])
@pytest.mark.parametrize(
    ("is_sure", "known_s", "most_s"), [(True, 0.5, 0.7), (True, 4.0, 0.2), (False, 15.0, 0.2)]
)
def test_a_stated_cycle_keeps_others_out_in_the_first_seconds(
    is_sure, known_s, most_s, each_s
) -> None:
    """What may have been held back at the start is a credit: some of the first burst pass on it.

    A cycle that no configuration states is tried first: it keeps nobody out before.
    """
    spec = ProtectionSpec(SIZE, spec_of().counter, spec_of().checksum, CYCLE, 10.0, 3, is_sure)
    t, data, is_other = spoofed(spec, 1, burst=16, each_s=each_s, jitter=0.1)
    kept = t >= 130.0 - known_s
    verdicts = np.array(judged(spec, t[kept], data[kept])[1])
    assert np.count_nonzero((verdicts == "") & is_other[kept]) * CYCLE <= most_s


@pytest.mark.parametrize("factor", [0.1, 0.3, 3.0, 10.0])
def test_a_cycle_of_a_database_that_nobody_keeps_costs_no_frame(factor) -> None:
    spec = ProtectionSpec(
        SIZE, spec_of().counter, spec_of().checksum, factor * CYCLE, 100.0, 3, cycle_is_sure=False
    )
    t, data = sent(spec, 3000, 1)
    assert set(judged(spec, t, data)[1]) == {""}


@pytest.mark.parametrize("bits", [2, 4, 8])
@pytest.mark.parametrize("on_change_hz", [2.0, 20.0])
def test_a_cyclic_sender_that_sends_on_change_as_well_loses_few_frames(bits, on_change_hz) -> None:
    """Its early frames are its own (GenMsgSendType cyclicAndSpontaneous)."""
    spec = spec_of(bits, stated=None)
    for seed in range(5):
        rng = np.random.default_rng(seed)
        cyclic = 100.0 + np.arange(0.0, 600.0, 0.1)
        changes = rng.uniform(160.0, 700.0, int(540.0 * on_change_hz))
        t = np.sort(np.concatenate([cyclic, changes]))
        t = np.maximum.accumulate(t + 0.01 * np.arange(len(t))) - 0.01 * np.arange(len(t))
        data = MessageProtector(spec).protect_columns(
            rng.integers(0, 256, (len(t), SIZE), np.uint8)
        )
        _, verdicts = judged(spec, t, data)
        assert np.mean([v != "" for v in verdicts]) < 0.03


@pytest.mark.parametrize("length", [16, 17, 60])
def test_who_counts_along_does_not_disarm_the_schedule(length) -> None:
    """Bursts of that many frames behind a true one, each 5 s, from 30 s on."""
    spec = spec_of(stated=None)
    for seed in range(5):
        t, data = sent(spec, 6000, seed)
        own = data[:, 1] & 0x0F
        after = np.flatnonzero(t > 130.0)[::500]
        times, rows = [t], [data]
        for k in after:
            values = np.full((16 + length, SIZE), 0xEE, np.uint8)
            made = MessageProtector(spec).protect_columns(values)
            first = (int(own[k]) + 1 - int(made[0, 1] & 0x0F)) % 16
            times.append(t[k] + 0.0003 * np.arange(1, length + 1))
            rows.append(made[first : first + length])
        stamps = np.concatenate(times)
        order = np.argsort(stamps, kind="stable")
        evil = (np.arange(len(stamps)) >= len(t))[order]
        _, verdicts = judged(spec, stamps[order], np.concatenate(rows)[order])
        taken = np.array([v == "" for v in verdicts])
        assert taken[evil].mean() < 0.02
