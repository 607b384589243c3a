"""Check received protected frames: length, checksum, counter, time. A frame that fails is dropped
completely, and one reason is counted. After a fault, the next `recovery` good frames are dropped
too ("untrusted"). Single frames (`check`) and columns (`check_columns`) give the same reasons and
the same state, in any mixture. Problems of a single signal (not available, implausible) are checked
in `quantities`.

Order of the checks:

1. "short_frame". 2. "long_frame", only with a checksum: the frame is longer than the protected
length. For CAN FD, the limit is the next possible frame length. 3. "checksum" (with the data id).
4. "counter_invalid". After a failure of 1 to 4, the counter of the frame is not used. 5. The
counter compared with the last good frame: "counter_repeated" (a stuck counter or a frame sent
again), "counter_reversed" (an old frame), "counter_jump". 6. "too_early": with its cycle time, the
sender cannot have sent another frame yet.

Two frames with the same counter and different data show two senders. The frames do not show which
sender is the true one, so all frames of the next `HELD_S` are dropped ("untrusted"). The first
frame of the false sender was already used; only authentication would prevent the use of this frame.
A false frame is accepted from `EARLIEST` cycles after a true frame, and the next true frame follows
within `1 - EARLIEST` cycles. A single sender with a stuck counter repeats the counter after a whole
cycle. The limit between the two cases is the mean of both times. If an older frame comes between
the two frames, the limit is `WAITS` cycles.

A lost frame is not a fault. If the time is long enough for a step of the counter (see `schedule`),
the step is counted as lost frames, unless a largest step is stated. Frames dropped for a wrong
checksum or length are known to be missing, so they increase the allowed step. After a silence, the
counter may start at any value.

"doubled" is checked before the counter: the frame is equal to the previous one, in every bit and in
the time stamp. A bus cannot carry two frames at the same time, so a gateway or a logger has made
the copy. The copy is dropped and does not count as a fault of the sender. A third copy is
"counter_repeated". Copies are detected only in messages with a counter; without a counter, the next
frame may have the same content.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import FD_BYTES
from imucald.can.dbc.bits import Columns, Field, read_bits
from imucald.can.e2e.checksum_engine import Checksum
from imucald.can.e2e.protection_spec import ProtectionSpec
from imucald.can.e2e.schedule import AHEAD, EARLIEST, HELD_S, IN_FORCE, TRIAL, WAITS, Past
from imucald.core import compiled
from imucald.core.compiled import Kernels

REASONS = (
    "",
    "short_frame",
    "long_frame",
    "checksum",
    "counter_invalid",
    "too_early",
    "counter_repeated",
    "counter_reversed",
    "counter_jump",
    "untrusted",
    "doubled",
)
"""The text of each reason code. Code 0 means an accepted frame."""

OK, SHORT, LONG, CHECKSUM, INVALID, EARLY, REPEATED, REVERSED, JUMP, UNTRUSTED, COPY = range(11)

DOUBLED = REASONS[COPY]
TOO_EARLY = REASONS[EARLY]


class MessageChecker:
    """Checks the frames of one message, in order. The first good frame is trusted."""

    reasons = REASONS
    """The texts of the codes that `check_columns` returns."""

    def __init__(self, spec: ProtectionSpec) -> None:
        self.spec = spec
        self._size, self._longest = spec.size, spec.longest
        self._checksum = None if spec.checksum is None else Checksum(spec.checksum)
        self._compiled = _CompiledJudge(spec, self._checksum)
        self._counter = spec.counter
        self._is_protected = spec.counter is not None or spec.checksum is not None
        self._timeout = math.inf if spec.timeout is None else spec.timeout
        self._counts = [0] * len(REASONS)
        self.past = Past()
        """The state with which the next frame is compared."""
        if spec.cycle_time is not None and self._is_protected:
            self.past.expect(spec.cycle_time, IN_FORCE if spec.cycle_is_sure else TRIAL)

    @property
    def lost(self) -> int:
        """Number of lost frames, according to the counter."""
        return self.past.lost

    @property
    def accepted(self) -> int:
        """Number of frames accepted so far."""
        return self._counts[OK]

    @property
    def rejected(self) -> dict[str, int]:
        """Number of frames dropped so far, by reason; only reasons that occurred."""
        return {REASONS[i]: n for i, n in enumerate(self._counts) if i != OK and n}

    def check(self, t: float, data: bytes | bytearray) -> str | None:
        """Check one frame received at `t` [s]. Return None if it is good, else the reason."""
        code = self._judge(t, data)
        self._counts[code] += 1
        return REASONS[code] or None

    def _judge(self, t: float, data: bytes | bytearray) -> int:
        past, counter, value = self.past, self._counter, -1
        if len(data) < self._size:
            code = SHORT
        elif len(data) > self._longest:
            code = LONG
        elif self._checksum is not None and not self._checksum.is_right(data):
            code = CHECKSUM
        else:
            code = OK
            if counter is not None:
                value = read_bits(data, counter.field)
                if value >= counter.modulus:
                    code = INVALID
                elif t == past.t and data == past.data:
                    past.data = b""
                    return COPY
            if code == OK and self._is_protected:
                known, since, cycle = past.data, t - past.t, past.cycle
                is_near = 0.0 < since <= WAITS * cycle
                code = self._sequence(t, value, data)
                is_soon = code == REPEATED and since <= (1.0 - 0.5 * EARLIEST) * cycle
                if is_near and self._is_again(known if is_soon else past.overtaken, value, data):
                    past.contradicted = t
                past.overtaken = known if is_near and code == REVERSED else b""
        if code == OK:
            if past.distrust:
                past.distrust -= 1
                return UNTRUSTED
            return UNTRUSTED if 0.0 <= t - past.contradicted < HELD_S else OK
        past.distrust = self.spec.recovery
        if code <= INVALID:
            past.missed += 1
        return code

    def _is_again(self, before: bytes, value: int, data: bytes | bytearray) -> bool:
        """True if a frame has the counter, but not the data, of a frame shortly before."""
        if not before or self._counter is None or not self.spec.recovery:
            return False
        return read_bits(before, self._counter.field) == value and data != before

    def _sequence(self, t: float, value: int, data: bytes | bytearray) -> int:
        past = self.past
        since = t - past.t
        if not 0.0 <= since <= self._timeout:  # the first, or after a silence
            past.begin(t, since)
            past.store_frame(t, value, data)
            return OK
        modulus = 1 if self._counter is None else self._counter.modulus
        past.attribute_early(t, value, modulus)
        due = past.due_after(since)
        earliest = due + EARLIEST * past.cycle
        is_ahead, distance, code = earliest > t, 1, OK
        if self._counter is not None:
            most = self._counter.max_jump
            step = (value - past.counter) % modulus
            distance = step or modulus
            back = modulus // 2 + 1 if most is None else modulus - most
            is_bad = distance > (back - 1 if most is None else most) + past.missed
            if most is None and past.cycle:
                # an old frame is late, but gives no credit
                origin = past.t + EARLIEST * past.cycle if distance >= back else earliest
                is_ahead = origin + AHEAD * past.cycle * (distance - 1) > t
                is_bad = is_ahead and (is_bad or past.phase == IN_FORCE)
            if is_bad and distance > 1:
                code = REPEATED if not step else REVERSED if step >= back else JUMP
        if is_ahead and past.phase == TRIAL:
            past.tried = t
        if earliest > t and past.phase == IN_FORCE:
            past.refuse_early(t, value, modulus)
            return code or EARLY
        if code == OK:
            past.lost += max(0, distance - 1 - past.missed)
        past.go_on(t, since, due, distance if code == OK else 0)
        past.store_frame(t, value, data)
        return code

    def check_columns(
        self, t: NDArray[np.float64], data: Columns, length: NDArray[np.uint8]
    ) -> NDArray[np.uint8]:
        """Check N frames in order and return their reason codes (N,); code 0 is a good frame.

        t: (N,) [s]. data: (N, W). length: (N,).
        """
        if compiled.kernels is not None:
            codes = self._compiled.judge(compiled.kernels, self.past, t, data, length)
        else:
            rows = zip(t.tolist(), data, length.tolist(), strict=True)
            judged = [self._judge(at, row[:n].tobytes()) for at, row, n in rows]
            codes = np.array(judged, np.uint8)
        found = np.bincount(codes, minlength=len(REASONS)).tolist()
        self._counts = [a + b for a, b in zip(self._counts, found, strict=True)]
        return codes


def _places(field: Field | None) -> list[int]:
    return [0, 0, 0] if field is None else [field.first_bit, field.length, int(field.is_big)]


_WHOLE = (
    "counter", "missed", "distrust", "lost", "phase", "early", "early_counter", "chain", "own",
    "trials",
)  # fmt: skip
_TIMES = ("t", "due", "cycle", "begun", "steps", "tried", "early_t", "contradicted")
"""Fields of `Past`, in the order of `State` and `Times` in `core/kernels/frames.c`."""


class _CompiledJudge:
    """The protection of a message as numbers and tables (see `core/kernels/frames.c`)."""

    def __init__(self, spec: ProtectionSpec, checksum: Checksum | None) -> None:
        counter, crc = spec.counter, spec.checksum
        numbers = [spec.size, spec.longest, spec.recovery]
        numbers += _places(None if counter is None else counter.field)
        numbers += [1, 0] if counter is None else [counter.modulus, counter.max_jump or 0]
        fixed, index = None, None
        tables: tuple[Any, ...] = [0] * 256, [0], [b""]
        if crc is None or checksum is None:
            numbers += [0, 0, 0, 0, 0]
        else:
            is_big = crc.byte_order == "big"
            numbers += [crc.size, crc.position, crc.width, int(is_big), crc.final_xor]
            tables, fixed = checksum.tables, crc.fixed
            index = crc.counter if len(tables[1]) > 1 else None
        numbers += _places(index)
        numbers += [*_places(fixed and fixed[0]), fixed[1] if fixed else 0]
        table, starts, suffixes = tables
        self._fixed = (
            np.array(numbers, np.int64),
            math.inf if spec.timeout is None else spec.timeout,
            np.array(table, np.uint16),
            np.array(starts, np.uint16),
            np.frombuffer(b"".join(suffixes), np.uint8).reshape(len(suffixes), -1),
        )

    def judge(
        self,
        kernels: Kernels,
        past: Past,
        t: NDArray[np.float64],
        data: Columns,
        length: NDArray[np.uint8],
    ) -> NDArray[np.uint8]:
        """Return the reason codes (N,) of frames, and update `past` to the last frame."""
        codes = np.empty(len(length), np.uint8)
        state = [getattr(past, name) for name in _WHOLE]
        whole = np.array([*state, len(past.data) or -1, len(past.overtaken)], np.int64)
        times = np.array([getattr(past, name) for name in _TIMES], np.float64)
        last_data = np.zeros((2, FD_BYTES), np.uint8)
        last_data[0, : len(past.data)] = np.frombuffer(past.data, np.uint8)
        last_data[1, : len(past.overtaken)] = np.frombuffer(past.overtaken, np.uint8)
        kernels.judge_frames(t, data, length, *self._fixed, whole, times, last_data, codes)
        *state, known, before = whole.tolist()
        for name, value in zip(_WHOLE + _TIMES, state + times.tolist(), strict=True):
            setattr(past, name, value)
        past.data = last_data[0, : max(known, 0)].tobytes()
        past.overtaken = last_data[1, :before].tobytes()
        return codes
