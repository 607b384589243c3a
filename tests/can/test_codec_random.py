"""Random messages: equal to cantools, and the same one by one as in columns."""

from __future__ import annotations

import math
import random

import cantools.database
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from imucald.can.dbc.database import load_database_text
from imucald.can.dbc.decode import compile_decode
from imucald.can.dbc.encode import compile_encode
from random_messages import cantools_message, random_dbc

FRAMES = 24


def payloads(rng: random.Random, size: int) -> list[bytes]:
    """Random frames, and the ones with all bits equal."""
    return [b"\0" * size, b"\xff" * size] + [rng.randbytes(size) for _ in range(FRAMES - 2)]


def as_columns(frames: list[bytes]) -> tuple[np.ndarray, np.ndarray]:
    width = 8 if max(map(len, frames)) <= 8 else 64
    data = np.zeros((len(frames), width), np.uint8)
    for row, frame in enumerate(frames):
        data[row, : len(frame)] = list(frame)
    return data, np.array([len(f) for f in frames], np.uint8)


def bits(value: float | None) -> bytes | None:
    """A double's bits; one NaN stands for all, None for None."""
    if value is None:
        return None
    assert type(value) is float
    return b"nan" if math.isnan(value) else np.float64(value).tobytes()


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(rng=st.randoms(use_true_random=False), multiplexed=st.booleans())
def test_decoding_equals_cantools_and_columns_equal_single_frames(
    rng: random.Random, multiplexed: bool
) -> None:
    text = random_dbc(rng, multiplexed)
    theirs = cantools_message(text)
    message = load_database_text(text, "dbc").message("M")
    names = list(message.signals)
    rng.shuffle(names)
    plan = compile_decode(message, names)
    frames = payloads(rng, message.length)
    decoded = plan.decode_columns(*as_columns(frames))
    assert decoded.ok.all()
    for row, frame in enumerate(frames):
        ours = plan.decode(frame)
        raw = plan.decode_raw(frame)
        assert [bits(v) for v in plan.scale(raw)] == [bits(v) for v in ours]
        for i, value in enumerate(ours):
            present = decoded.present[i]
            assert (value is not None) == (present is None or bool(present[row]))
            column = decoded.values[i][row]
            assert bits(column.item()) == (b"nan" if value is None else bits(value))
            if value is not None:
                in_column = decoded.raw[i][row].item()
                assert raw[i] == in_column or math.isnan(in_column)
        found = {n: v for n, v in zip(names, ours, strict=True) if v is not None}
        try:
            expected = theirs.decode_simple(frame, decode_choices=False)
        except cantools.database.DecodeError:
            continue  # a multiplexer value that the message does not know: ours leaves it out
        assert {n: bits(v) for n, v in found.items()} == {
            n: bits(float(v)) for n, v in expected.items()
        }


@pytest.mark.slow
@settings(max_examples=60, deadline=None)
@given(rng=st.randoms(use_true_random=False))
def test_a_plan_of_some_signals_gives_what_the_plan_of_all_gives(rng: random.Random) -> None:
    message = load_database_text(random_dbc(rng, multiplexed=True), "dbc").message("M")
    names = list(message.signals)
    some = [n for n in names if rng.random() < 0.4]
    whole, part = compile_decode(message, names), compile_decode(message, some)
    for frame in payloads(rng, message.length):
        every = dict(zip(names, whole.decode(frame), strict=True))
        assert [bits(v) for v in part.decode(frame)] == [bits(every[n]) for n in some]


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(rng=st.randoms(use_true_random=False))
def test_encoding_equals_cantools_and_columns_equal_single_frames(rng: random.Random) -> None:
    text = random_dbc(rng, multiplexed=False)
    theirs = cantools_message(text)
    message = load_database_text(text, "dbc").message("M")
    names = list(message.signals)
    assume(names)
    plan = compile_encode(message, names)
    decode = compile_decode(message, names)
    rows: list[list[float]] = []
    for frame in payloads(rng, message.length):
        values = [float(v or 0.0) for v in decode.decode(frame)]
        for i, name in enumerate(names):
            signal = message.signals[name]
            if not math.isfinite(values[i]):
                values[i] = rng.uniform(-100.0, 100.0)
            elif not signal.is_float and signal.length <= 32:
                values[i] += signal.scale * rng.choice((0.0, 0.0, 0.3, -0.3, 0.49))
            elif signal.length > 53:
                values[i] = math.nextafter(values[i], 0.0)  # the bound itself is no double
        rows.append(values)
    rows = [row for row in rows if _fits(theirs, names, row)]
    expected = [
        theirs.encode(dict(zip(names, row, strict=True)), strict=False).hex() for row in rows
    ]
    assert [plan.encode(row).hex() for row in rows] == expected
    columns = plan.encode_columns([np.array([r[i] for r in rows]) for i in range(len(names))])
    assert [c.tobytes().hex() for c in columns] == expected


def _fits(theirs: cantools.database.Message, names: list[str], row: list[float]) -> bool:
    for name, value in zip(names, row, strict=True):
        signal = theirs.get_signal_by_name(name)
        raw = signal.scaled_to_raw(value)
        if signal.is_float:
            largest = {16: 65504.0, 32: 3.4e38, 64: 1.7e308}[signal.length]
            if not abs(raw) <= largest:
                return False
            continue
        low = -(1 << signal.length - 1) if signal.is_signed else 0
        if not low <= raw < low + (1 << signal.length):
            return False
    return True


@settings(max_examples=60, deadline=None)
@given(rng=st.randoms(use_true_random=False), data=st.data())
def test_whatever_is_encoded_comes_back_within_half_a_step(
    rng: random.Random, data: st.DataObject
) -> None:
    message = load_database_text(random_dbc(rng, multiplexed=False), "dbc").message("M")
    names = [n for n, s in message.signals.items() if not s.is_float and s.length <= 48]
    encode, decode = compile_encode(message, names), compile_decode(message, names)
    values = []
    for name in names:
        signal = message.signals[name]
        ends = sorted(
            signal.scale * raw + signal.offset for raw in (0, 2 ** (signal.length - 1) - 1)
        )
        values.append(data.draw(st.floats(*map(float, ends))))
    for name, value, back in zip(names, values, decode.decode(encode.encode(values)), strict=True):
        assert back is not None
        step = abs(message.signals[name].scale)
        assert abs(back - value) <= 0.5 * step + 1e-9 * abs(value)
