"""Checks of incoming messages: each fault, the recovery, columns equal to frame by frame."""

from __future__ import annotations

import random
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace

from imucald.can.dbc.bits import Field, field_at
from imucald.can.dbc.message import Signal
from imucald.can.e2e.checksum_engine import ChecksumSpec
from imucald.can.e2e.checksums import (
    E2E_COUNTERS,
    crc8_j1850,
    e2e_profile_1,
    e2e_profile_2,
    e2e_profile_5,
    e2e_profile_11,
    xor_checksum,
)
from imucald.can.e2e.protection import REASONS, MessageChecker
from imucald.can.e2e.protection_spec import CounterSpec, ProtectionSpec, counter_of
from imucald.can.e2e.protector import MessageProtector
from imucald.core.errors import ConfigError, EncodeError

CYCLE = 0.01
SIZE = 8
COUNTER = CounterSpec(Field(8, 4, "little_endian"), 16, max_jump=2)
PROTECTED = ProtectionSpec(SIZE, COUNTER, crc8_j1850(SIZE, 0, b"\x02\x00"), CYCLE, 10.0, recovery=3)
COUNTED = ProtectionSpec(SIZE, COUNTER, cycle_time=CYCLE, recovery=3)


def frames(spec: ProtectionSpec, count: int, seed: int = 1) -> list[bytes]:
    """Frames of a sound sender."""
    rng = random.Random(seed)
    protector = MessageProtector(spec)
    return [protector.protect(rng.randbytes(spec.size)) for _ in range(count)]


def judge(checker: MessageChecker, received: Sequence[bytes], t: float = 0.0) -> list[str]:
    """Verdicts ("" is good) of frames that come in at the cycle time."""
    return [checker.check(t + i * CYCLE, frame) or "" for i, frame in enumerate(received)]


def counted(spec: ProtectionSpec, values: Sequence[int]) -> list[bytes]:
    """Frames with the counter values given."""
    assert spec.checksum is None
    return [bytes([0, value, 0, 0, 0, 0, 0, 0]) for value in values]


def test_a_sound_sender_is_trusted_from_the_first_frame() -> None:
    checker = MessageChecker(PROTECTED)
    assert judge(checker, frames(PROTECTED, 100)) == [""] * 100
    assert checker.accepted == 100
    assert checker.rejected == {}
    assert checker.lost == 0


def test_one_damaged_frame_is_one_fault_and_three_distrusted_frames() -> None:
    checker = MessageChecker(PROTECTED)
    received = frames(PROTECTED, 10)
    received[3] = received[3][:5] + bytes([received[3][5] ^ 1]) + received[3][6:]
    assert judge(checker, received) == ["", "", "", "checksum"] + ["untrusted"] * 3 + [""] * 3
    assert checker.rejected == {"checksum": 1, "untrusted": 3}
    assert checker.accepted == 6
    assert checker.lost == 0  # it was not lost, it was refused


def test_a_short_frame_is_one_fault() -> None:
    checker = MessageChecker(PROTECTED)
    received = frames(PROTECTED, 8)
    received[2] = received[2][:7]
    assert judge(checker, received) == ["", "", "short_frame"] + ["untrusted"] * 3 + ["", ""]


@pytest.mark.parametrize(
    ("size", "good", "bad"),
    [(8, {8}, {9, 12, 64}), (6, {6}, {7, 8, 64}), (16, {16}, {20, 64}), (13, {13, 16}, {20, 64})],
)
def test_with_a_checksum_a_frame_is_as_long_as_its_message(size, good, bad) -> None:
    """CAN FD carries 13 bytes in a frame of 16; AUTOSAR's E2E profiles check the length."""
    spec = ProtectionSpec(size, COUNTER, crc8_j1850(size, 0, b"\x02\x00"), recovery=0)
    for length in sorted(good | bad):
        received = [frame + bytes(length - size) for frame in frames(spec, 2)]
        one, columns = MessageChecker(spec), MessageChecker(spec)
        reason = "" if length in good else "long_frame"
        assert judge(one, received) == [reason] * 2
        data = np.zeros((2, 64), np.uint8)
        data[:, :length] = [list(frame) for frame in received]
        codes = columns.check_columns(np.zeros(2), data, np.full(2, length, np.uint8))
        assert [REASONS[code] for code in codes] == [reason] * 2
        assert one.rejected == columns.rejected


def test_without_a_checksum_a_longer_frame_is_taken() -> None:
    spec = ProtectionSpec(SIZE, COUNTER, recovery=0)
    received = [frame + bytes(4) for frame in frames(spec, 3)]
    assert judge(MessageChecker(spec), received) == [""] * 3


def test_a_second_fault_starts_the_wait_anew() -> None:
    checker = MessageChecker(PROTECTED)
    received = frames(PROTECTED, 12)
    for bad in (2, 4):
        received[bad] = bytes(SIZE)
    expected = ["", "", "checksum", "untrusted", "checksum"] + ["untrusted"] * 3 + [""] * 4
    assert judge(checker, received) == expected


def test_lost_frames_are_counted_while_few_and_a_fault_when_many() -> None:
    checker = MessageChecker(COUNTED)
    verdicts = judge(checker, counted(COUNTED, [0, 1, 3, 4, 8, 9, 10, 11, 12]))
    assert verdicts == ["", "", "", "", "counter_jump", *["untrusted"] * 3, ""]
    assert checker.lost == 1


def test_a_counter_that_stands_still_is_stuck_or_sent_again() -> None:
    checker = MessageChecker(COUNTED)
    verdicts = judge(checker, counted(COUNTED, [5, 6, 6, 6, 7, 8, 9, 10]))
    expected = ["", "", "counter_repeated", "counter_repeated", *["untrusted"] * 3, ""]
    assert verdicts == expected


@pytest.mark.parametrize("spec", [PROTECTED, COUNTED])
def test_a_frame_that_comes_twice_at_one_stamp_counts_once_and_as_doubled(spec) -> None:
    sound = frames(spec, 20)
    checker = MessageChecker(spec)
    verdicts = [checker.check(i // 2 * CYCLE, sound[i // 2]) or "" for i in range(40)]
    assert verdicts == ["", "doubled"] * 20
    assert checker.rejected == {"doubled": 20}
    assert checker.accepted == 20
    assert checker.lost == 0


def test_only_one_copy_with_every_bit_at_the_same_stamp_is_a_doubled_frame() -> None:
    one, other = counted(COUNTED, [6])[0], bytes([1, 6, 0, 0, 0, 0, 0, 0])
    for t, again in ((1e-6, one), (0.0, other), (0.0, one + b"\0")):
        checker = MessageChecker(COUNTED)
        assert [checker.check(0.0, one), checker.check(t, again)] == [None, "counter_repeated"]
    checker = MessageChecker(COUNTED)
    verdicts = [checker.check(0.0, one) or "" for _ in range(6)]
    assert verdicts == ["", "doubled", *["counter_repeated"] * 4]


def test_copies_neither_end_nor_prolong_the_distrust_after_a_fault() -> None:
    checker = MessageChecker(COUNTED)
    sent = [(i, value) for i, value in enumerate([0, 9, 10, 11, 12, 13]) for _ in range(2)]
    verdicts = [checker.check(i * CYCLE, counted(COUNTED, [v])[0]) or "" for i, v in sent]
    assert verdicts[::2] == ["", "counter_jump", *["untrusted"] * 3, ""]
    assert verdicts[1::2] == ["doubled"] * 6


def test_without_a_counter_the_next_frame_may_look_the_same() -> None:
    checker = MessageChecker(replace(COUNTED, counter=None))
    assert [checker.check(0.0, bytes(SIZE)) for _ in range(3)] == [None] * 3


def test_a_counter_that_goes_back_is_an_old_frame() -> None:
    checker = MessageChecker(COUNTED)
    verdicts = judge(checker, counted(COUNTED, [5, 6, 5, 6, 7, 8, 9]))
    assert verdicts == ["", "", "counter_reversed", *["untrusted"] * 3, ""]


def test_the_counter_wraps_at_its_modulus_and_no_value_beyond_is_taken() -> None:
    spec = ProtectionSpec(SIZE, CounterSpec(Field(8, 4, "little_endian"), 15, 1), recovery=0)
    checker = MessageChecker(spec)
    verdicts = judge(checker, counted(spec, [12, 13, 14, 0, 1, 15, 2, 3]))
    assert verdicts == ["", "", "", "", "", "counter_invalid", "", ""]


def test_frames_with_an_impossible_counter_are_missing_like_damaged_ones() -> None:
    spec = ProtectionSpec(SIZE, CounterSpec(Field(8, 8, "little_endian"), 20, 1), recovery=0)
    values = [7, 200, 200, 200, 11, 12]
    one, many = MessageChecker(spec), MessageChecker(spec)
    expected = ["", *["counter_invalid"] * 3, "", ""]
    received = counted(spec, values)
    assert judge(one, received) == expected
    data, length = as_columns(received)
    times = CYCLE * np.arange(6)
    codes = [*many.check_columns(times[:3], data[:3], length[:3])]
    codes += [*many.check_columns(times[3:], data[3:], length[3:])]
    assert [REASONS[c] for c in codes] == expected


def test_frames_known_to_be_missing_widen_the_step() -> None:
    """Eight damaged frames in a row, then a sound one: eight faults, not nine."""
    checker = MessageChecker(PROTECTED)
    received = frames(PROTECTED, 40)
    for i in range(10, 18):
        received[i] = bytes(SIZE)
    verdicts = judge(checker, received)
    assert verdicts[10:18] == ["checksum"] * 8
    assert verdicts[18:21] == ["untrusted"] * 3
    assert verdicts[21:] == [""] * 19
    for i in range(22, 38):  # a whole turn of the counter is missing
        received[i] = bytes(SIZE)
    checker = MessageChecker(replace(PROTECTED, cycle_time=None))
    assert checker.check(0.0, received[21]) is None
    assert judge(checker, received[22:], CYCLE)[-2:] == ["untrusted"] * 2
    assert "counter_repeated" not in checker.rejected


@pytest.mark.parametrize("resumes", range(16))
def test_silence_beyond_the_time_out_starts_the_counter_anew_and_costs_nothing(resumes) -> None:
    received = frames(PROTECTED, 60)
    goes_on = 1 <= (resumes - 2) % 16 <= 2  # the counter, by no more than is allowed
    for pause, is_good in ((0.11, True), (0.09, goes_on)):
        checker = MessageChecker(PROTECTED)
        assert judge(checker, received[:3]) == ["", "", ""]
        verdicts = judge(checker, received[16 + resumes : 20 + resumes], 2 * CYCLE + pause)
        assert verdicts[0].startswith("" if is_good else "counter")
        assert verdicts[1:] == ([""] if is_good else ["untrusted"]) * 3


def test_damaged_frames_do_not_break_a_silence() -> None:
    checker = MessageChecker(PROTECTED)
    received = frames(PROTECTED, 30)
    verdicts = judge(checker, received[:2] + [bytes(SIZE)] * 12 + received[25:])
    assert verdicts[:14] == ["", ""] + ["checksum"] * 12
    assert verdicts[14:17] == ["untrusted"] * 3


def test_a_clock_that_goes_back_is_no_silence() -> None:
    checker = MessageChecker(PROTECTED)
    received = frames(PROTECTED, 3)
    times = (1000.0, 5.0, 5.01)
    assert [checker.check(t, f) for t, f in zip(times, received, strict=True)] == [None] * 3


def test_without_any_protection_only_the_length_is_judged() -> None:
    checker = MessageChecker(ProtectionSpec(4, recovery=0))
    assert [checker.check(1e3 * i, bytes(i)) for i in range(7)] == ["short_frame"] * 4 + [None] * 3


def test_a_message_is_not_another_one_with_the_same_bytes() -> None:
    """The identifier bytes keep a frame of another message out."""
    other = ProtectionSpec(SIZE, COUNTER, crc8_j1850(SIZE, 0, b"\x03\x00"), CYCLE)
    assert judge(MessageChecker(PROTECTED), frames(other, 5)) == ["checksum"] * 5


def test_a_counter_lies_where_its_signal_lies() -> None:
    signal = Signal("ALIVE", 13, 6, "big_endian")
    spec = ProtectionSpec(2, counter_of(signal), recovery=0)
    payload = MessageProtector(spec)
    sent = [payload.protect(b"\xff\xff") for _ in range(3)]
    assert [f.hex() for f in sent] == ["ffc0", "ffc1", "ffc2"]
    checker = MessageChecker(spec)
    assert [checker.check(0.0, f) for f in sent] == [None] * 3
    assert checker.check(CYCLE, sent[2]) == "counter_repeated"


@pytest.mark.parametrize(
    "build",
    [
        lambda: ProtectionSpec(65),
        lambda: counter_of(Signal("ALIVE", 0, 57, "little_endian")),
        lambda: ProtectionSpec(1, COUNTER),
        lambda: ProtectionSpec(4, checksum=crc8_j1850(8, 7)),
        lambda: ProtectionSpec(8, recovery=-1),
        lambda: ProtectionSpec(8, cycle_time=0.0),
        lambda: ProtectionSpec(8, cycle_time=float("nan")),
        lambda: CounterSpec(Field(0, 4, "little_endian"), 17),
        lambda: CounterSpec(Field(0, 4, "little_endian"), 1),
        lambda: CounterSpec(Field(0, 4, "little_endian"), 16, 16),
        lambda: CounterSpec(Field(0, 4, "little_endian"), 16, 0),
    ],
)
def test_a_protection_that_cannot_be_is_refused(build: object) -> None:
    with pytest.raises(ConfigError):
        build()  # type: ignore[operator]


# ---- columns ----


def specs() -> st.SearchStrategy[ProtectionSpec]:
    modes = st.sampled_from(("both", "alternating", "low", "nibble"))
    profile_1 = st.builds(e2e_profile_1, st.just(8), st.integers(0, 0xFFFF), modes)
    pairs: list[st.SearchStrategy[tuple[CounterSpec | None, ChecksumSpec | None]]] = [
        st.just((None, None)),
        st.just((CounterSpec(Field(8, 8, "little_endian"), 11), None)),
        st.just((COUNTER, None)),
        st.tuples(st.just(E2E_COUNTERS[1].at(0)), profile_1),
        st.just((E2E_COUNTERS[2].at(0), e2e_profile_2(8, range(16)))),
        st.just((E2E_COUNTERS[5].at(0, max_jump=5), e2e_profile_5(8, 0x1234))),
        st.just((E2E_COUNTERS[11].at(0), e2e_profile_11(8, 0x123))),
        st.just((None, xor_checksum(6, 5))),
        st.just((CounterSpec(field_at(63, 3, "big_endian"), 7, 1), crc8_j1850(8, 0))),
    ]
    return st.builds(
        lambda pair, cycle, timeout, recovery: ProtectionSpec(8, *pair, cycle, timeout, recovery),
        st.one_of(pairs),
        st.sampled_from((None, CYCLE)),
        st.sampled_from((2.5, 10.0)),
        st.sampled_from((0, 1, 3)),
    )


def troubled(
    spec: ProtectionSpec, rng: random.Random, count: int, rate: float
) -> tuple[np.ndarray, list[bytes]]:
    """Times and frames of a sender with every kind of fault, each frame with odds `rate`."""
    received: list[bytes] = []
    times: list[float] = []
    t = 100.0
    sound = frames(spec, count, rng.randrange(1 << 30))
    for i, sent in enumerate(sound):
        t += CYCLE * rng.uniform(0.8, 1.2)
        frame = sent
        if rng.random() >= rate:
            received.append(frame)
            times.append(t)
            continue
        kind = rng.randrange(9)
        if kind == 0:
            frame = frame[: rng.randrange(8)]
        elif kind == 1:
            frame = bytes([frame[0] ^ rng.randrange(1, 256)]) + frame[1:]
        elif kind == 2:
            frame = rng.randbytes(rng.randrange(65))
        elif kind == 3:
            frame = sound[max(0, i - rng.randrange(1, 4))]
        elif kind == 4:
            t += CYCLE * rng.uniform(1.0, 30.0)
        elif kind == 5:
            t -= CYCLE * rng.uniform(0.0, 5.0)
        elif kind == 6:
            more = rng.randrange(1, 4)  # twice, or more often
            received += [frame] * more
            times += [t] * more
        elif kind == 7:
            frame = received[-1] if received else frame  # what it follows, at another time
        else:
            continue  # lost
        received.append(frame)
        times.append(t)
    return np.array(times), received


def as_columns(received: list[bytes]) -> tuple[np.ndarray, np.ndarray]:
    data = np.zeros((len(received), 64), np.uint8)
    for row, frame in enumerate(received):
        data[row, : len(frame)] = list(frame)
    return data, np.array([len(f) for f in received], np.uint8)


def state(checker: MessageChecker) -> tuple[object, ...]:
    return checker.accepted, checker.rejected, repr(checker.past)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(
    spec=specs(),
    seed=st.integers(0, 2**32 - 1),
    rate=st.sampled_from((0.0, 0.02, 0.3, 0.9)),
)
def test_columns_in_any_pieces_equal_frame_by_frame(
    spec: ProtectionSpec, seed: int, rate: float
) -> None:
    rng = random.Random(seed)
    times, received = troubled(spec, rng, 120, rate)
    data, length = as_columns(received)
    one, many, mixed = MessageChecker(spec), MessageChecker(spec), MessageChecker(spec)
    expected = [one.check(t, f) or "" for t, f in zip(times.tolist(), received, strict=True)]
    assert [REASONS[c] for c in many.check_columns(times, data, length)] == expected
    assert state(many) == state(one)
    found: list[str] = []
    at = 0
    while at < len(received):
        end = at + rng.randrange(30)
        if rng.random() < 0.3:
            end = at + 1
            found += [mixed.check(times[at].item(), received[at]) or ""] if end else []
        else:
            width = 8 if length[at:end].max(initial=0) <= 8 else 64
            codes = mixed.check_columns(times[at:end], data[at:end, :width], length[at:end])
            found += [REASONS[c] for c in codes]
        at = end
    assert found == expected
    assert state(mixed) == state(one)


@pytest.mark.parametrize("spec", [PROTECTED, COUNTED, ProtectionSpec(8, recovery=0)])
def test_a_hundred_thousand_random_frames_are_each_counted(spec: ProtectionSpec) -> None:
    rng = np.random.default_rng(5)
    count = 120_000
    data = rng.integers(0, 256, (count, 64), dtype=np.uint8)
    length = rng.integers(0, 65, count).astype(np.uint8)
    data[np.arange(64) >= length[:, None]] = 0
    times = np.cumsum(rng.exponential(CYCLE, count))
    checker, one = MessageChecker(spec), MessageChecker(spec)
    codes = checker.check_columns(times, data, length)
    assert checker.accepted + sum(checker.rejected.values()) == count
    assert checker.accepted == np.count_nonzero(codes == 0)
    some = 20_000
    for t, row, n, code in zip(times[:some], data[:some], length, codes, strict=False):
        assert (one.check(t.item(), row[:n].tobytes()) or "") == REASONS[code]
    if spec.checksum is not None:
        assert checker.accepted < 0.005 * count  # 1 of 256 passes the checksum, and few the rest


# ---- output ----


@settings(deadline=None)
@given(spec=specs(), seed=st.integers(0, 2**32 - 1))
def test_protected_columns_equal_frame_by_frame_and_pass_their_guard(
    spec: ProtectionSpec, seed: int
) -> None:
    rng = random.Random(seed)
    payloads = [rng.randbytes(8) for _ in range(40)]
    one, many = MessageProtector(spec), MessageProtector(spec)
    expected = [one.protect(p) for p in payloads]
    data = np.frombuffer(b"".join(payloads), np.uint8).reshape(-1, 8)
    found = [*many.protect_columns(data[:17]), *many.protect_columns(data[17:])]
    assert [f.tobytes() for f in found] == expected
    assert many.protect(payloads[0]) == one.protect(payloads[0])
    assert judge(MessageChecker(spec), expected) == [""] * 40


def test_a_frame_too_short_for_its_protection_is_refused() -> None:
    with pytest.raises(EncodeError):
        MessageProtector(PROTECTED).protect(bytes(7))
    with pytest.raises(EncodeError):
        MessageProtector(PROTECTED).protect_columns(np.zeros((2, 7), np.uint8))
