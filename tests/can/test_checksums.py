"""Checksums against published examples and independent implementations."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import crccheck.crc
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucald.can.dbc.bits import Field
from imucald.can.e2e.checksum_engine import Checksum, ChecksumSpec
from imucald.can.e2e.checksums import (
    crc8_j1850,
    crc16_ccitt,
    e2e_profile_1,
    e2e_profile_2,
    e2e_profile_5,
    e2e_profile_11,
    xor_checksum,
)
from imucald.core.errors import ConfigError

MODES = ("both", "alternating", "low", "nibble")

EXAMPLES: list[tuple[ChecksumSpec, str]] = [
    # AUTOSAR PRS E2E Protocol Specification, "Protocol Examples": data id 0x123, user data zero,
    # the first and the second frame.
    (e2e_profile_1(8, 0x123, "both"), "cc00000000000000"),
    (e2e_profile_1(8, 0x123, "both"), "9101000000000000"),
    (e2e_profile_1(8, 0x123, "alternating"), "ce00000000000000"),
    (e2e_profile_1(8, 0x123, "alternating"), "0201000000000000"),
    (e2e_profile_1(8, 0x123, "low"), "ce00000000000000"),
    (e2e_profile_1(8, 0x123, "low"), "9301000000000000"),
    (e2e_profile_1(8, 0x123, "nibble"), "2a10000000000000"),
    (e2e_profile_1(8, 0x123, "nibble"), "7711000000000000"),
    (e2e_profile_11(8, 0x123, "both"), "cc00000000000000"),
    (e2e_profile_11(8, 0x123, "both"), "9101000000000000"),
    (e2e_profile_11(8, 0x123, "nibble"), "2a10000000000000"),
    (e2e_profile_11(8, 0x123, "nibble"), "7711000000000000"),
    # The same document, profile 5, data id 0x1234: alone, and behind 8 bytes of upper header.
    (e2e_profile_5(8, 0x1234), "1cca000000000000"),
    (e2e_profile_5(8, 0x1234), "cf8d010000000000"),
    (e2e_profile_5(16, 0x1234, 8), "00000000000000002891000000000000"),
    (e2e_profile_5(16, 0x1234, 8), "0000000000000000fbd6010000000000"),
    # Profile 2 (no example in the document): test vectors of the e2e package.
    (e2e_profile_2(8, bytes(16)), "4501000000000000"),
    (e2e_profile_2(8, range(16)), "bc02020304050607"),
    (e2e_profile_2(8, range(16)), "6101020304050607"),
]


def columns(*frames: bytes) -> np.ndarray:
    return np.frombuffer(b"".join(frames), np.uint8).reshape(len(frames), -1)


@pytest.mark.parametrize(("spec", "frame"), EXAMPLES)
def test_published_example_is_right(spec: ChecksumSpec, frame: str) -> None:
    data = bytes.fromhex(frame)
    checksum = Checksum(spec)
    assert checksum.is_right(data)
    assert checksum.are_right(columns(data)).tolist() == [True]


@pytest.mark.parametrize(("spec", "frame"), EXAMPLES)
def test_every_single_wrong_bit_is_seen(spec: ChecksumSpec, frame: str) -> None:
    data = bytes.fromhex(frame)
    checksum = Checksum(spec)
    damaged = []
    for bit in range(8 * len(data)):
        wrong = bytearray(data)
        wrong[bit // 8] ^= 1 << bit % 8
        damaged.append(bytes(wrong))
    assert not any(checksum.is_right(frame) for frame in damaged)
    assert not checksum.are_right(columns(*damaged)).any()


def test_j1850_has_its_catalogue_check_value() -> None:
    # CRC RevEng catalogue, CRC-8/SAE-J1850: check("123456789") = 0x4B
    assert Checksum(crc8_j1850(10, 9)).compute(b"123456789\0") == 0x4B


@settings(deadline=None)
@given(data=st.binary(min_size=8, max_size=8), id_bytes=st.binary(max_size=4))
def test_j1850_with_id_bytes_equals_crccheck(data: bytes, id_bytes: bytes) -> None:
    expected = crccheck.crc.Crc8SaeJ1850.calc(id_bytes + data[:3] + data[4:])
    assert Checksum(crc8_j1850(8, 3, id_bytes)).compute(data) == expected


def test_crc16_ccitt_has_its_catalogue_check_value() -> None:
    # CRC RevEng catalogue, CRC-16/IBM-3740: check("123456789") = 0x29B1
    assert Checksum(crc16_ccitt(11, 9)).compute(b"123456789\0\0") == 0x29B1


@settings(deadline=None)
@given(data=st.binary(min_size=8, max_size=8), id_bytes=st.binary(max_size=4))
def test_xor_is_the_exclusive_or_of_everything_else(data: bytes, id_bytes: bytes) -> None:
    expected = 0
    for byte in data[:7] + id_bytes:
        expected ^= byte
    assert Checksum(xor_checksum(8, 7, id_bytes)).compute(data) == expected


def peer(profile: int) -> tuple[Callable[..., None], Any]:
    e2e = pytest.importorskip("e2e", reason="package autosar-e2e (extra dev) is not installed")
    module = getattr(e2e, f"p{profile:02d}")
    return getattr(module, f"e2e_p{profile:02d}_protect"), module


@settings(deadline=None)
@given(
    frame=st.integers(3, 64).flatmap(lambda n: st.binary(min_size=n, max_size=n)),
    data_id=st.integers(0, 0xFFFF),
    mode=st.sampled_from(MODES),
)
def test_profile_1_equals_an_independent_one(frame: bytes, data_id: int, mode: str) -> None:
    protect, _ = peer(1)
    theirs = bytearray(frame)
    protect(theirs, data_id, data_id_mode=MODES.index(mode), increment_counter=False)
    assert Checksum(e2e_profile_1(len(frame), data_id, mode)).is_right(theirs)  # type: ignore[arg-type]


@settings(deadline=None)
@given(
    frame=st.integers(3, 64).flatmap(lambda n: st.binary(min_size=n, max_size=n)),
    data_ids=st.binary(min_size=16, max_size=16),
)
def test_profile_2_equals_an_independent_one(frame: bytes, data_ids: bytes) -> None:
    protect, _ = peer(2)
    theirs = bytearray(frame)
    protect(theirs, data_ids, increment_counter=False)
    assert Checksum(e2e_profile_2(len(frame), data_ids)).is_right(theirs)


@settings(deadline=None)
@given(
    frame=st.integers(4, 48).flatmap(lambda n: st.binary(min_size=n, max_size=n)),
    data_id=st.integers(0, 0xFFFF),
    data=st.data(),
)
def test_profile_5_equals_an_independent_one(
    frame: bytes, data_id: int, data: st.DataObject
) -> None:
    protect, _ = peer(5)
    offset = data.draw(st.integers(0, len(frame) - 4))
    theirs = bytearray(frame)
    protect(theirs, data_id, offset=offset, increment_counter=False)
    assert Checksum(e2e_profile_5(len(frame), data_id, offset)).is_right(theirs)


@pytest.mark.slow
@settings(deadline=None)
@given(
    frame=st.integers(3, 64).flatmap(lambda n: st.binary(min_size=n, max_size=n)),
    data_id=st.integers(0, 0xFFF),
    nibble=st.booleans(),
    data=st.data(),
)
def test_profile_11_equals_an_independent_one(
    frame: bytes, data_id: int, nibble: bool, data: st.DataObject
) -> None:
    protect, module = peer(11)
    mode = module.E2E_P11_DATAID_NIBBLE if nibble else module.E2E_P11_DATAID_BOTH
    offset = data.draw(st.integers(0, len(frame) - 3))
    theirs = bytearray(frame)
    protect(theirs, data_id, data_id_mode=mode, offset=offset, increment_counter=False)
    spec = e2e_profile_11(len(frame), data_id, "nibble" if nibble else "both", offset)
    assert Checksum(spec).is_right(theirs)


def any_spec(size: int) -> st.SearchStrategy[ChecksumSpec]:
    ids = st.binary(max_size=3)
    data_id = st.integers(0, 0xFFFF)
    return st.one_of(
        st.builds(xor_checksum, st.just(size), st.integers(0, size - 1), ids),
        st.builds(crc8_j1850, st.just(size), st.integers(0, size - 1), ids),
        st.builds(crc16_ccitt, st.just(size), st.integers(0, size - 2), ids),
        st.builds(e2e_profile_1, st.just(size), data_id, st.sampled_from(MODES)),
        st.builds(e2e_profile_2, st.just(size), st.binary(min_size=16, max_size=16)),
        st.builds(e2e_profile_5, st.just(size), data_id),
        st.builds(e2e_profile_11, st.just(size), data_id, st.sampled_from(("both", "nibble"))),
    )


@pytest.mark.slow
@settings(deadline=None)
@given(size=st.integers(3, 64), seed=st.integers(0, 2**32 - 1), data=st.data())
def test_columns_equal_frame_by_frame(size: int, seed: int, data: st.DataObject) -> None:
    checksum = Checksum(data.draw(any_spec(size)))
    frames = np.random.default_rng(seed).integers(0, 256, (20, 64), dtype=np.uint8)
    at = checksum.spec.position
    for row in range(0, 20, 2):  # half of them right
        value = checksum.compute(frames[row].tobytes())
        frames[row, at : at + checksum.spec.width] = list(
            value.to_bytes(checksum.spec.width, "little")
        )
    one_by_one = [f.tobytes() for f in frames]
    assert checksum.compute_columns(frames).tolist() == [checksum.compute(f) for f in one_by_one]
    assert checksum.are_right(frames).tolist() == [checksum.is_right(f) for f in one_by_one]


@pytest.mark.parametrize(
    "build",
    [
        lambda: crc8_j1850(8, 8),
        lambda: crc8_j1850(8, -1),
        lambda: xor_checksum(0, 0),
        lambda: e2e_profile_1(8, 0x10000),
        lambda: e2e_profile_1(8, 1, "middle"),  # type: ignore[arg-type]
        lambda: e2e_profile_1(8, 1, offset=7),
        lambda: e2e_profile_2(8, range(15)),
        lambda: e2e_profile_2(8, [256] * 16),
        lambda: e2e_profile_5(1, 1),
        lambda: e2e_profile_11(8, 1, "low"),
        lambda: ChecksumSpec(8, 0, prefixes=(b"a", b"b"), counter=Field(8, 4, "little_endian")),
    ],
)
def test_a_checksum_that_cannot_be_is_refused(build: Callable[[], ChecksumSpec]) -> None:
    with pytest.raises(ConfigError):
        build()
