"""Where bits lie: every position and length, one frame as in columns."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.can.dbc.bits import (
    field_at,
    read_bits,
    read_column,
    signed_column,
    words_of,
    write_bits,
    write_column,
)

SIZE = 16


def drawn(start: int, length: int, is_big: bool) -> list[int]:
    """Bit numbers of a signal, least significant first, walked as the DBC's picture shows them."""
    if not is_big:
        return list(range(start, start + length))
    bits = []
    bit = start
    for _ in range(length):
        bits.append(bit)
        bit = bit + 15 if bit % 8 == 0 else bit - 1
    return bits[::-1]


@pytest.mark.parametrize("is_big", [False, True])
def test_every_position_and_length_is_read_and_written_the_same(is_big: bool) -> None:
    rng = np.random.default_rng(4)
    order = "big_endian" if is_big else "little_endian"
    for start in range(8 * SIZE):
        for length in (1, 2, 7, 8, 9, 31, 32, 33, 57, 58, 63, 64):
            bits = drawn(start, length, is_big)
            if max(bits) >= 8 * SIZE:
                continue
            frames = rng.integers(0, 256, (2, SIZE), dtype=np.uint8)
            field = field_at(start, length, order)  # type: ignore[arg-type]
            truth = [
                sum((int(f[b // 8]) >> b % 8 & 1) << i for i, b in enumerate(bits)) for f in frames
            ]
            assert field.end_byte == max(bits) // 8 + 1
            assert [read_bits(f.tobytes(), field) for f in frames] == truth
            assert read_column(words_of(frames, field.byte_order), field).tolist() == truth
            out = np.zeros((2, SIZE), np.uint8)
            write_column(out, field, np.array(truth, np.uint64))
            for frame, value, written in zip(frames, truth, out, strict=True):
                payload = bytearray(frame.tobytes())
                write_bits(payload, field, 0)
                assert payload == bytes(
                    x & ~y & 0xFF for x, y in zip(frame.tobytes(), mask(bits), strict=True)
                )
                write_bits(payload, field, value)
                assert payload == frame.tobytes()
                assert written.tobytes() == bytes(
                    x & y for x, y in zip(frame.tobytes(), mask(bits), strict=True)
                )


def mask(bits: list[int]) -> bytes:
    out = bytearray(SIZE)
    for bit in bits:
        out[bit // 8] |= 1 << bit % 8
    return bytes(out)


@pytest.mark.parametrize("length", [1, 2, 12, 31, 32, 33, 63, 64])
def test_signed_columns_are_in_twos_complement(length: int) -> None:
    top = 1 << length - 1
    values = [0, top - 1, top, 2 * top - 1]
    expected = [0, top - 1, -top, -1]
    assert signed_column(np.array(values, np.uint64), length).tolist() == expected


def test_a_width_that_is_no_multiple_of_eight_is_padded() -> None:
    frames = np.arange(10, dtype=np.uint8).reshape(2, 5)
    field = field_at(32, 8, "little_endian")
    assert read_column(words_of(frames, "little_endian"), field).tolist() == [4, 9]
