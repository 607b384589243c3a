"""The check of protected frames in compiled code, see `MessageChecker.check_columns`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.can.dbc.bits import MAX_FRAME_BYTES, Columns, Field
from imucald.can.e2e.checksum_engine import Checksum
from imucald.can.e2e.protection_spec import ProtectionSpec
from imucald.can.e2e.schedule import Past
from imucald.core.compiled import Kernels

_MOST_VALUES = 1 << 32
"""Largest number of values of a counter that the compiled code checks. Larger counters are checked
frame by frame in Python. Same limit as in `core/kernels/frames.c`."""
_MOST_INDEX_BITS = 15


def _places(field: Field | None) -> list[int]:
    return [0, 0, 0] if field is None else [field.first_bit, field.length, int(field.is_big)]


class CompiledJudge:
    """The protection of a message as numbers and tables (see `core/kernels/frames.c`)."""

    def __init__(self, spec: ProtectionSpec, checksum: Checksum | None) -> None:
        counter, crc = spec.counter, spec.checksum
        self.can_judge = counter is None or counter.modulus <= _MOST_VALUES
        numbers = [spec.size, spec.longest, spec.recovery]
        numbers += _places(None if counter is None else counter.field)
        numbers += (
            [1, 0]
            if counter is None
            else [min(counter.modulus, _MOST_VALUES), counter.max_jump or 0]
        )
        fixed = None if crc is None else crc.fixed
        index = None
        self._table = np.zeros(256, np.uint16)
        self._starts, self._suffixes = np.zeros(1, np.uint16), np.zeros((1, 0), np.uint8)
        if crc is None or checksum is None:
            numbers += [0, 0, 0, 0, 0]
        else:
            is_big = crc.byte_order == "big"
            numbers += [crc.size, crc.position, crc.width, int(is_big), crc.final_xor]
            table, starts, suffixes = checksum.tables
            index = crc.counter if len(starts) > 1 else None
            self._table, self._starts = np.array(table, np.uint16), np.array(starts, np.uint16)
            text = b"".join(suffixes)
            self._suffixes = np.frombuffer(text, np.uint8).reshape(len(suffixes), -1)
            self.can_judge &= index is None or index.length <= _MOST_INDEX_BITS
        numbers += _places(index)
        numbers += _places(None if fixed is None else fixed[0])
        numbers.append(0 if fixed is None else fixed[1])
        self._numbers = np.array(numbers, np.int64)
        self._timeout = math.inf if spec.timeout is None else spec.timeout

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
        state = np.array(
            [past.counter, past.missed, past.distrust, past.lost, len(past.data) or -1,
             past.phase, past.early, past.early_counter, past.chain, past.own, past.trials,
             len(past.overtaken)],
            np.int64,
        )  # fmt: skip
        times = np.array(
            [
                past.t,
                past.due,
                past.cycle,
                past.begun,
                past.steps,
                past.tried,
                past.early_t,
                past.contradicted,
            ],
            np.float64,
        )
        last_data = np.zeros((2, MAX_FRAME_BYTES), np.uint8)
        last_data[0, : len(past.data)] = np.frombuffer(past.data, np.uint8)
        last_data[1, : len(past.overtaken)] = np.frombuffer(past.overtaken, np.uint8)
        kernels.judge_frames(
            t, data, length, self._numbers, self._timeout, self._table, self._starts,
            self._suffixes, state, times, last_data, codes,
        )  # fmt: skip
        past.counter, past.missed, past.distrust, past.lost, known = state[:5].tolist()
        past.phase, past.early, past.early_counter, past.chain = state[5:9].tolist()
        past.own, past.trials, before = state[9:].tolist()
        past.t, past.due, past.cycle, past.begun = times[:4].tolist()
        past.steps, past.tried, past.early_t, past.contradicted = times[4:].tolist()
        past.data = last_data[0, :known].tobytes() if known > 0 else b""
        past.overtaken = last_data[1, :before].tobytes()
        return codes
