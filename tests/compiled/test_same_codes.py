"""The kernel of protected frames against Python: the same codes and the same state."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from recorded_calls import needs_kernels

from both_ways import agree
from imucald.can.dbc.bits import Field
from imucald.can.e2e.checksums import (
    E2E_COUNTERS,
    crc8_j1850,
    e2e_profile_1,
    e2e_profile_2,
    e2e_profile_5,
    xor_checksum,
)
from imucald.can.e2e.protection import MessageChecker
from imucald.can.e2e.protection_spec import CounterSpec, ProtectionSpec
from imucald.can.e2e.protector import MessageProtector

pytestmark = [needs_kernels, pytest.mark.slow]

MANY = settings(max_examples=120, deadline=None, suppress_health_check=list(HealthCheck))
SEEDS = given(st.integers(0, 2**32 - 1))


@pytest.mark.parametrize("bits", [31, 32])
def test_frames_that_a_long_counter_says_are_lost(bits: int) -> None:
    most = 1 << bits
    spec = ProtectionSpec(8, CounterSpec(Field(0, bits, "little_endian"), most, most - 1))
    data = np.random.default_rng(bits).integers(0, 256, (200, 8), np.uint8)

    def lost() -> int:
        checker = MessageChecker(spec)
        for part in np.split(data, 4):
            checker.check_columns(np.arange(50.0), part, np.full(50, 8, np.uint8))
        return checker.lost

    assert agree(lost) > 0


COUNTER = CounterSpec(Field(8, 4, "little_endian"), 16, max_jump=2)
SPECS = (
    ProtectionSpec(8, COUNTER, crc8_j1850(8, 0, b"\x02\x00"), 0.01, 10.0, recovery=3),
    ProtectionSpec(8, COUNTER, cycle_time=0.01, recovery=3),
    ProtectionSpec(8, None, xor_checksum(8, 7), 0.01, 3.0, recovery=1),
    ProtectionSpec(5, CounterSpec(Field(37, 3, "big_endian"), 7, max_jump=1), recovery=2),
    ProtectionSpec(8, E2E_COUNTERS[1].at(0), e2e_profile_1(8, 0x123, "alternating"), 0.01, 5.0, 2),
    ProtectionSpec(8, E2E_COUNTERS[2].at(0), e2e_profile_2(8, range(16)), 0.01, 5.0, 2),
    ProtectionSpec(8, E2E_COUNTERS[5].at(0, max_jump=5), e2e_profile_5(8, 0x1234), 0.01, 5.0, 2),
    ProtectionSpec(8, CounterSpec(Field(8, 4, "little_endian"), 15), xor_checksum(8, 7)),
    ProtectionSpec(8, replace(COUNTER, max_jump=1), xor_checksum(8, 7)),
    ProtectionSpec(8, None, xor_checksum(8, 7)),
)


@SEEDS
@MANY
def test_frames_of_a_protected_message(seed: int) -> None:
    rng, draw = np.random.default_rng(seed), random.Random(seed)
    spec = SPECS[seed % len(SPECS)]
    protector, rows, t, now = MessageProtector(spec), [], [], 0.0
    pace = draw.choice([0.01, 0.3])  # slow ones go on long enough for their cycle to be learnt
    for _ in range(draw.randrange(1, 400)):
        frame, kind = bytearray(protector.protect(draw.randbytes(spec.size))), draw.random()
        if kind < 0.05:
            frame[draw.randrange(len(frame))] ^= 1 << draw.randrange(8)
        elif kind < 0.08:
            continue  # lost
        elif kind < 0.1:
            frame = frame[: draw.randrange(len(frame))]
        elif kind < 0.12:
            frame += draw.randbytes(draw.randrange(4))
        copies = 2 if draw.random() < 0.05 else 1
        is_odd = draw.random() < draw.choice([0.02, 0.4])
        now += draw.choice([0.0, 0.001, 1.0, -0.5]) if is_odd and copies == 1 else pace
        rows += [bytes(frame)] * copies
        t += [now] * copies
    width = 8 if max(map(len, rows), default=0) <= 8 else 64
    data = np.zeros((len(rows), width), np.uint8)
    for own, frame in zip(data, rows, strict=True):
        own[: len(frame)] = np.frombuffer(frame, np.uint8)
    length = np.array([len(frame) for frame in rows], np.uint8)
    cuts = sorted(rng.integers(0, len(rows) + 1, 3).tolist())

    def judged() -> object:
        checker, codes, at = MessageChecker(spec), [], 0
        for end in (*cuts, len(rows)):
            codes.append(checker.check_columns(np.array(t[at:end]), data[at:end], length[at:end]))
            at = end
        return codes, checker.accepted, dict(checker.rejected), repr(checker.past)

    agree(judged)
