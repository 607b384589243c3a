"""The check on protected frames that come in: length, checksum, counter, silence.

A frame that fails is dropped whole, with one counted reason. After a fault the next `recovery`
good frames are dropped too ("untrusted"). One frame at a time (`check`) and columns
(`check_columns`) give the same reasons and leave the same state, in any mixture. What only
concerns one signal (not available, implausible) is judged in `quantities`.

The order of judgement: "short_frame", "long_frame" (only where there is a checksum: such frames
have the length that their profile states, or the next that CAN FD can carry), "checksum" (with the
data id), "counter_invalid": such a frame says nothing, and its counter is not read. Then "timeout":
the first good frame after a silence, which starts the counter again. Then the counter against that
of the last good frame: "counter_repeated" (stuck, or a frame sent again), "counter_reversed" (back
by no more than the window: an old frame), "counter_jump" (more lost than allowed). Frames dropped
for a wrong checksum or length are known to be missing and widen the allowed step, so that one
damaged frame is one fault.

"doubled" goes before "timeout" and what the counter says: the frame before once more, every bit and
the time stamp. No bus carries two frames at once, so a gateway or a logger has made a copy; it is
dropped and says nothing of the sender. A third one is "counter_repeated". Only a counter shows a
copy: without one the next frame may well look the same.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.can.dbc.bits import Columns, read_bits, read_column, words_of
from imucald.can.e2e.checksum_engine import Checksum
from imucald.can.e2e.compiled_protection import CompiledJudge, Past
from imucald.can.e2e.protection_spec import ProtectionSpec
from imucald.core import compiled

REASONS = (
    "",
    "short_frame",
    "long_frame",
    "checksum",
    "counter_invalid",
    "timeout",
    "counter_repeated",
    "counter_reversed",
    "counter_jump",
    "untrusted",
    "doubled",
)
"""Text of each reason code; code 0 is an accepted frame."""

OK, SHORT, LONG, CHECKSUM, INVALID, TIMEOUT, REPEATED, REVERSED, JUMP, UNTRUSTED, COPY = range(11)

DOUBLED = REASONS[COPY]


class MessageChecker:
    """Judges the frames of one message, in order. The very first good frame is trusted."""

    reasons = REASONS
    """Text of the codes that `check_columns` gives."""

    def __init__(self, spec: ProtectionSpec) -> None:
        self.spec = spec
        self._size, self._longest = spec.size, spec.longest
        self._checksum = None if spec.checksum is None else Checksum(spec.checksum)
        self._compiled = CompiledJudge(spec, self._checksum)
        self._counter = spec.counter
        self._timeout = spec.timeout
        self._counts = [0] * len(REASONS)
        self._last_t: float | None = None
        self._last_counter: int | None = None
        self._last_data = b""  # of the last frame that was good in itself, if its counter was new
        self._missed = 0  # frames known to be missing since the last good one
        self._distrust = 0  # good frames still to be dropped
        self.lost = 0
        """Frames that the counter shows to be lost, within what is allowed."""

    @property
    def accepted(self) -> int:
        """Frames accepted so far."""
        return self._counts[OK]

    @property
    def rejected(self) -> dict[str, int]:
        """Frames dropped so far, by reason; only reasons that occurred."""
        return {REASONS[i]: n for i, n in enumerate(self._counts) if i != OK and n}

    def check(self, t: float, data: bytes | bytearray) -> str | None:
        """Judge one frame received at `t` [s]: None where it is good, else the reason."""
        code = OK
        if len(data) < self._size:
            code = SHORT
        elif len(data) > self._longest:
            code = LONG
        elif self._checksum is not None and not self._checksum.is_right(data):
            code = CHECKSUM
        else:
            counter = self._counter
            value = None if counter is None else read_bits(data, counter.field)
            if value is not None and counter is not None and value >= counter.modulus:
                code = INVALID
            elif value is not None and t == self._last_t and data == self._last_data:
                self._counts[COPY] += 1
                self._last_data = b""
                return DOUBLED
            else:
                if value is not None:
                    self._last_data = b"" if value == self._last_counter else bytes(data)
                if self._timeout is not None or value is not None:
                    code = self._sequence(t, value)
                self._last_t = t
                self._missed = 0
                if code == OK and self._distrust:
                    self._distrust -= 1
                    self._counts[UNTRUSTED] += 1
                    return REASONS[UNTRUSTED]
        self._counts[code] += 1
        if code == OK:
            return None
        self._distrust = self.spec.recovery
        if code <= INVALID:
            self._missed += 1
        return REASONS[code]

    def _sequence(self, t: float, value: int | None) -> int:
        """Time-out and counter of a frame that is good in itself."""
        last, self._last_counter = self._last_counter, value
        missed, last_t = self._missed, self._last_t
        if self._timeout is not None and last_t is not None and t - last_t > self._timeout:
            return TIMEOUT
        counter = self._counter
        if counter is None or value is None or last is None:
            return OK
        modulus = counter.modulus
        step = (value - last) % modulus
        allowed = counter.max_jump + missed
        if (step or modulus) <= allowed:
            lost = (step or modulus) - 1 - missed
            if lost > 0:
                self.lost += lost
            return OK
        if step == 0:
            return REPEATED
        return REVERSED if step >= modulus - counter.max_jump else JUMP

    def check_columns(
        self, t: NDArray[np.float64], data: Columns, length: NDArray[np.uint8]
    ) -> NDArray[np.uint8]:
        """Judge (N,) frames in order: t [s], data (N, W), length; reason codes (N,), 0 is good."""
        count = len(length)
        codes = np.zeros(count, np.uint8)
        if count == 0:
            return codes
        if compiled.kernels is not None and self._compiled.can_judge:
            codes = self._judge_compiled(compiled.kernels, t, data, length)
            self._count(codes)
            return codes
        counters = self._judge_each(codes, data, length)
        copies = None if counters is None else self._copies(codes, counters, t, data, length)
        if counters is not None and copies is not None:
            kept = ~copies
            rest = codes[kept]
            self._judge_in_order(rest, t[kept], counters[kept])
            codes[kept], codes[copies] = rest, COPY
        else:
            self._judge_in_order(codes, t, counters)
        self._count(codes)
        return codes

    def _count(self, codes: NDArray[np.uint8]) -> None:
        if not codes.any():
            self._counts[OK] += len(codes)
            return
        found = np.bincount(codes, minlength=len(REASONS)).tolist()
        self._counts = [a + b for a, b in zip(self._counts, found, strict=True)]

    def _judge_compiled(
        self,
        kernels: compiled.Kernels,
        t: NDArray[np.float64],
        data: Columns,
        length: NDArray[np.uint8],
    ) -> NDArray[np.uint8]:
        past = Past(
            self._last_t,
            self._last_counter,
            self._last_data,
            self._missed,
            self._distrust,
            self.lost,
        )
        codes, past = self._compiled.judge(kernels, past, t, data, length)
        self._last_t, self._last_counter, self._last_data = past.t, past.counter, past.data
        self._missed, self._distrust, self.lost = past.missed, past.distrust, past.lost
        return codes

    def _copies(
        self,
        codes: NDArray[np.uint8],
        counters: NDArray[np.int64],
        t: NDArray[np.float64],
        data: Columns,
        length: NDArray[np.uint8],
    ) -> NDArray[np.bool_] | None:
        """Which frames (N,) are copies; None: none. The last frame is remembered."""
        good = np.flatnonzero(codes == OK)
        if not len(good):
            return None
        before = -1 if self._last_counter is None else self._last_counter
        is_new = _differences(counters[good], before) != 0
        since = _differences(t[good], math.nan if self._last_t is None else self._last_t)
        final, last = int(good[-1]), self._last_data
        self._last_data = data[final, : length[final]].tobytes() if is_new[-1] else b""
        if not (since == 0.0).any():
            return None
        again = repeated_rows(data[good], length[good], last)
        again &= since == 0.0
        again[1:] &= is_new[:-1]
        copies = np.zeros(len(codes), dtype=bool)
        copies[good] = again
        return copies if again.any() else None

    def _judge_in_order(
        self,
        codes: NDArray[np.uint8],
        t: NDArray[np.float64],
        counters: NDArray[np.int64] | None,
    ) -> None:
        """Judge frames (N,) without copies: time-outs, counters, and what follows faults."""
        good = np.flatnonzero(codes == OK)
        if len(good):
            if counters is not None or self._timeout is not None:
                codes[good] = self._sequence_columns(
                    t[good], None if counters is None else counters[good], good
                )
            self._last_t = float(t[good[-1]])
            self._missed = len(codes) - 1 - int(good[-1])
        else:
            self._missed += len(codes)
        if len(codes) and (self._distrust or codes.any()):
            self._distrust_columns(codes)

    def _judge_each(
        self, codes: NDArray[np.uint8], data: Columns, length: NDArray[np.uint8]
    ) -> NDArray[np.int64] | None:
        """Set the codes of frames that are bad in themselves; return the counters."""
        if data.shape[1] < self._size:
            codes[:] = SHORT
            return None if self._counter is None else np.zeros(len(codes), np.int64)
        counters = None
        if self._counter is not None:
            field = self._counter.field
            counters = read_column(words_of(data, field.byte_order), field).astype(np.int64)
            codes[counters >= self._counter.modulus] = INVALID
        if self._checksum is not None:
            codes[~self._checksum.are_right(data)] = CHECKSUM
        codes[length > self._longest] = LONG
        codes[length < self._size] = SHORT
        return counters

    def _sequence_columns(
        self, t: NDArray[np.float64], counters: NDArray[np.int64] | None, good: NDArray[np.intp]
    ) -> NDArray[np.uint8]:
        """`_sequence` over the frames that are good in themselves, at row numbers `good`."""
        codes = np.zeros(len(t), np.uint8)
        if counters is not None and self._counter is not None:
            counter, modulus = self._counter, self._counter.modulus
            missed = _differences(good, -1) - 1
            missed[0] += self._missed
            first = int(counters[0]) if self._last_counter is None else self._last_counter
            step = _differences(counters, first) % modulus
            distance = np.where(step == 0, modulus, step)
            bad = distance > counter.max_jump + missed
            codes[bad] = JUMP
            codes[bad & (step >= modulus - counter.max_jump)] = REVERSED
            codes[bad & (step == 0)] = REPEATED
            lost = np.maximum(distance - 1 - missed, 0)
            if self._last_counter is None:
                codes[0] = lost[0] = OK
            self._last_counter = int(counters[-1])
        if self._timeout is not None:
            last_t = float(t[0]) if self._last_t is None else self._last_t
            codes[_differences(t, last_t) > self._timeout] = TIMEOUT
        if counters is not None:
            self.lost += int(lost[codes == OK].sum())
        return codes

    def _distrust_columns(self, codes: NDArray[np.uint8]) -> None:
        """Drop the good frames that follow a fault too closely."""
        recovery = self.spec.recovery
        row = np.arange(len(codes))
        before = self._distrust - recovery - 1
        last_fault = np.maximum.accumulate(np.where(codes != OK, row, before))
        since = row - last_fault
        codes[(codes == OK) & (since <= recovery)] = UNTRUSTED
        self._distrust = max(0, recovery - int(since[-1]))


def _differences(values: NDArray[Any], first: float) -> NDArray[Any]:
    """Each value (N,) less the one before it, the first less `first`."""
    out = np.empty_like(values)
    out[0] = values[0] - first
    np.subtract(values[1:], values[:-1], out=out[1:])
    return out


def repeated_rows(data: Columns, length: NDArray[np.uint8], last: bytes) -> NDArray[np.bool_]:
    """Which frames (N,), N > 0, have every byte of the one before; last: the one before them."""
    same = np.empty(len(data), dtype=bool)
    same[0] = data[0, : length[0]].tobytes() == last
    same[1:] = (data[1:] == data[:-1]).all(axis=1) & (length[1:] == length[:-1])
    return same
