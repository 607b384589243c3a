"""No argument makes a kernel crash, or write where it may not: it refuses, or it returns."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from recorded_calls import Arguments, calls, copied, needs_kernels

from imucald.core import compiled

pytestmark = [needs_kernels, pytest.mark.slow]

NAMES = sorted(compiled.Kernels.ARGUMENTS)
REFUSALS = (ValueError, TypeError, BufferError, OverflowError, ctypes.ArgumentError)
MARGIN = 64
"""Bytes before and behind each array that no kernel may touch."""
GUARD = 0xA5
CRC_BYTES, CRC_POSITION, CRC_WIDTH = 8, 9, 10
"""Places in the numbers of `judge_frames`."""
WHOLE = (-(2**63), -(2**31), -1, 0, 1, 7, 64, 2**31, 2**62, 2**63 - 1)
NUMBERS = (float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e300, -1e300, 5e-324)


def test_every_kernel_is_called_in_a_replay() -> None:
    assert sorted(calls()) == NAMES


def guarded(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A copy row by row with margins around it, and the bytes of both."""
    whole = np.full(x.nbytes + 2 * MARGIN, GUARD, np.uint8)
    inside = whole[MARGIN : MARGIN + x.nbytes].view(x.dtype).reshape(x.shape)
    inside[...] = x
    return inside, whole


def call(name: str, arguments: Arguments) -> Any:
    """Call a kernel with guards around all arrays; what it returned, or None where it refused."""
    margins, given = [], []
    for x in arguments:
        inside = x
        if isinstance(x, np.ndarray) and x.flags.c_contiguous and x.flags.writeable:
            inside, whole = guarded(x)
            margins.append(whole)
        given.append(inside)
    try:
        found = getattr(compiled.kernels, name)(*given)
    except REFUSALS:
        found = None
    for whole in margins:
        assert (whole[:MARGIN] == GUARD).all()
        assert (whole[-MARGIN:] == GUARD).all()
    return found


def unfit(x: np.ndarray) -> Iterator[Any]:
    """What is no array of that kind and shape."""
    yield from (None, "text", 3.5, [1.0, 2.0], object(), x[None])
    yield np.zeros(x.shape, np.float32 if x.dtype == np.float64 else np.float64)
    yield np.zeros((0,) * (x.ndim + 1), x.dtype)
    if x.dtype.itemsize > 1:
        yield b"bytes" * 64
        yield x.astype(x.dtype.newbyteorder())


def test_what_is_no_array_of_the_kind_is_refused() -> None:
    for name in NAMES:
        arguments = calls()[name][0]
        for k, x in enumerate(arguments):
            if not isinstance(x, np.ndarray):
                continue
            for other in unfit(x):
                changed = (*copied(arguments[:k]), other, *copied(arguments[k + 1 :]))
                with pytest.raises(REFUSALS):
                    pytest.fail(f"{name}({k}): {getattr(compiled.kernels, name)(*changed)}")


@pytest.mark.parametrize("name", NAMES)
def test_an_array_of_another_length_is_refused_or_taken(name: str) -> None:
    for arguments in calls()[name]:
        for k, x in enumerate(arguments):
            if not isinstance(x, np.ndarray):
                continue
            for axis in range(x.ndim):
                for shape in (0, 1, x.shape[axis] - 1, x.shape[axis] + 1, 3 * x.shape[axis] + 5):
                    if shape < 0:
                        continue
                    other = np.resize(x, [*x.shape[:axis], shape, *x.shape[axis + 1 :]])
                    call(name, (*arguments[:k], other, *arguments[k + 1 :]))


@pytest.mark.parametrize("name", NAMES)
def test_a_strided_array_gives_the_same(name: str) -> None:
    for arguments in calls()[name]:
        expected = copied(arguments)
        found = getattr(compiled.kernels, name)(*expected)
        given = []
        for x in copied(arguments):
            wide = x
            if isinstance(x, np.ndarray) and x.ndim:
                wide = np.repeat(x, 2, axis=-1)[..., ::2]
                wide.flags.writeable = False
            given.append(wide)
        try:
            assert getattr(compiled.kernels, name)(*given) == found
        except REFUSALS:
            continue  # what is written to must lie row by row
        for one, other in zip(given, expected, strict=True):
            if isinstance(one, np.ndarray):
                assert one.tobytes() == other.tobytes()


@pytest.mark.parametrize("name", NAMES)
def test_no_numbers_lead_beyond_an_array(name: str) -> None:
    rng = np.random.default_rng(sum(map(ord, name)))
    for arguments in calls()[name]:
        for k, x in enumerate(arguments):
            for other in worse(rng, x):
                call(name, (*arguments[:k], other, *arguments[k + 1 :]))


def worse(rng: np.random.Generator, x: Any) -> Iterator[Any]:
    """Numbers of the same kind that nobody should hand over."""
    if isinstance(x, float):
        yield from NUMBERS
    elif isinstance(x, int | np.integer):
        yield from WHOLE
    elif x.dtype.kind in "fc":
        yield from (np.full_like(x, number) for number in NUMBERS)
        yield rng.choice(np.array(NUMBERS), x.shape).astype(x.dtype)
        yield np.where(rng.random(x.shape) < 0.1, np.nan, x)
        yield 1e12 * x
    elif x.dtype == np.bool_:
        yield np.zeros_like(x)
        yield np.ones_like(x)
        yield np.full(x.shape, 255, np.uint8).view(np.bool_)
    else:
        low, high = np.iinfo(x.dtype).min, np.iinfo(x.dtype).max
        every = [n for n in WHOLE if low <= n <= high]
        yield from (np.full_like(x, number) for number in every)
        yield rng.choice(np.array(every, x.dtype), x.shape)
        yield rng.integers(low, high, x.shape, x.dtype, endpoint=True)
        yield np.where(rng.random(x.shape) < 0.05, rng.choice(np.array(every, x.dtype)), x)


def test_several_arguments_at_once_are_borne() -> None:
    rng = np.random.default_rng(1)
    for name in NAMES:
        for arguments in calls()[name]:
            for _ in range(30):
                changed = tuple(
                    rng.choice(np.array([*worse(rng, x)], dtype=object))
                    if not isinstance(x, np.ndarray) and rng.random() < 0.3
                    else _one_of(rng, x)
                    for x in arguments
                )
                call(name, changed)


def _one_of(rng: np.random.Generator, x: Any) -> Any:
    if not isinstance(x, np.ndarray) or rng.random() < 0.7:
        return x
    every = list(worse(rng, x))
    return every[int(rng.integers(len(every)))]


@pytest.mark.parametrize("width", [1, 2])
@pytest.mark.parametrize("covered", [-(2**63), 1 - 2**63, -1, 0, 65])
def test_a_checksum_over_no_bytes_of_a_frame_is_refused(covered: int, width: int) -> None:
    t, data, length, spec, *rest = copied(calls()["judge_frames"][0])
    spec[CRC_BYTES], spec[CRC_POSITION], spec[CRC_WIDTH] = covered, 2**40, width
    with pytest.raises(ValueError, match="numbers beyond the arrays of judge_frames"):
        compiled.kernels.judge_frames(t, data, length, spec, *rest)


def test_what_is_written_to_must_be_writable() -> None:
    for name in NAMES:
        arguments = copied(calls()[name][0])
        getattr(compiled.kernels, name)(*arguments)  # as it is it does
        for x in arguments:
            if isinstance(x, np.ndarray):
                x.flags.writeable = False
        with pytest.raises(REFUSALS):
            getattr(compiled.kernels, name)(*arguments)
