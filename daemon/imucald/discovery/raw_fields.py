"""Find measured numbers in frames that no database describes.

A field of one or two bytes is used if consecutive values are close together and the range of the
values is wide. Upper bits that jump (flags of other signals) are masked. Fields are proposed as
`raw`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK
from imucald.can.dbc.message import Message, Signal
from imucald.config_check.motion import bridged, smooth
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.recording import Traffic
from imucald.motion.ticks import TICK_RATE

MIN_FRAMES = 200
MIN_LEVELS = 40
"""Smallest number of different values of a speed or an angle in a drive."""
CLOSE = 0.02
"""Largest median step of a smooth field, relative to its range."""
JUMP = 0.25
"""Smallest step that counts as a jump, as a share of the range (a wrap, or bits of other
signals)."""
MAX_MASKED = 5
"""Largest number of upper bits that may belong to other signals."""
MAX_STEP_S = 1.0


def raw_fields(traffic: Sequence[Traffic], known: set[int], ticks: int) -> Iterator[SeenSignal]:
    """Yield all fields of the identifiers that are not in `known`, wide fields first."""
    several = len({one.channel for one in traffic}) > 1
    for one in traffic:
        if one.can_id in known or len(one) < MIN_FRAMES:
            continue
        size = int(one.length.min())
        taken: set[int] = set()
        for at in range(size - 1):
            if taken & {at, at + 1}:
                continue
            for big in (True, False):
                high, low = (at, at + 1) if big else (at + 1, at)
                found = _field(one, (high, low), ticks, several)
                if found is not None:
                    taken |= {at, at + 1}
                    yield found
                    break
        for at in range(size):
            if at not in taken:
                found = _field(one, (at,), ticks, several)
                if found is not None:
                    yield found


def _field(one: Traffic, places: tuple[int, ...], ticks: int, several: bool) -> SeenSignal | None:
    data = one.data.astype(np.int64)
    if len(places) == 2 and len(np.unique(data[:, places[1]])) < MIN_LEVELS:
        return None  # no data in the low byte: the field has one byte
    for masked in range(MAX_MASKED + 1 if len(places) == 2 else 1):
        mask = 0xFF >> masked
        values = data[:, places[0]] & mask
        if len(places) == 2:
            values = values * 256 + data[:, places[1]]
        if _is_smooth(one.t, values):
            return _candidate(one, places, mask, values.astype(np.float64), ticks, several)
    return None


def _is_smooth(t: NDArray[np.float64], values: NDArray[np.int64]) -> bool:
    span = int(values.max() - values.min())
    if span < MIN_LEVELS or len(np.unique(values)) < MIN_LEVELS:
        return False
    steps = np.abs(np.diff(values))[np.diff(t) < MAX_STEP_S]
    if not len(steps) or float(np.mean(steps > 0)) < 0.01:
        return False
    moving = steps[steps > 0]
    both = np.diff(values)
    one_way = min(float((both > 0).mean()), float((both < 0).mean())) < 0.001
    return bool(
        not one_way  # a clock, a counter, an odometer
        and float(np.median(moving)) < CLOSE * span
        and int(steps.max()) < JUMP * span
    )


def _candidate(
    one: Traffic, places: tuple[int, ...], mask: int, values: NDArray[np.float64], ticks: int,
    several: bool,
) -> SeenSignal:  # fmt: skip
    index = np.minimum((one.t * TICK_RATE).astype(np.int64), ticks - 1)
    count = np.bincount(index, minlength=ticks)
    rows = np.flatnonzero(count)
    means = np.bincount(index, values, minlength=ticks)[rows] / count[rows]
    x = bridged(ticks, rows, means)
    upper = f"data[{places[0]}]" if mask == 0xFF else f"(data[{places[0]}] & {mask})"
    value = upper if len(places) == 1 else f"{upper} * 256 + data[{places[1]}]"
    number = one.can_id & CAN_EFF_MASK
    signal = Signal(f"bytes_{'_'.join(map(str, places))}", 0, 8 * len(places))
    raw = {"id": number, "value": value}
    if one.can_id & CAN_EFF_FLAG and number < 0x800:
        raw["extended"] = True
    return SeenSignal(
        message=Message(f"0x{number:X}", one.can_id, 8, {signal.name: signal}),
        signal=signal,
        channel=one.channel,
        x=x,
        smooth=smooth(x),
        cycle=float(np.median(np.diff(one.t))),
        levels=(),
        held=None,
        unavailable=(),
        least=float(values.min()),
        largest=float(values.max()),
        raw=raw,
        own_channel=one.channel if several else None,
    )
