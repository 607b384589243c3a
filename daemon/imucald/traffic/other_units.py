"""A shared bus: arbitration, and the traffic of all other control units."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, FrameColumns, concatenate
from imucald.can.logs.recorder_clock import HEAD_BITS, LONG_ID_BITS
from imucald.core.arrays import Array
from imucald.simulation.filters import generator

CYCLES_S = (0.01, 0.02, 0.05, 0.1, 1.0)
CYCLE_SHARES = (0.22, 0.22, 0.16, 0.28, 0.12)
"""Shares of the messages of a real bus, one share for each cycle time."""


def background(
    seed: int, frames_per_s: float, avoid: frozenset[int], start_s: float, stop_s: float
) -> FrameColumns:
    """Return the frames of other control units in the interval [start_s, stop_s). The messages
    (ids, cycles) do not depend on the interval."""
    rng = generator(seed, "background")
    cycles: list[float] = []
    while sum(1.0 / c for c in cycles) < frames_per_s:
        cycles.append(float(rng.choice(CYCLES_S, p=CYCLE_SHARES)))
    free = np.array([i for i in range(0x080, 0x7F0) if i not in avoid])
    if len(cycles) > len(free):
        cycles = cycles[: len(free)]
    ids = rng.permutation(free)[: len(cycles)]
    phases = rng.random(len(cycles))
    constant = rng.integers(0, 256, (len(cycles), 8), dtype=np.uint8)
    changing = rng.random((len(cycles), 8)) < 0.4
    t, index = _moments(np.array(cycles), phases, start_s, stop_s)
    noise = generator(seed, f"background:{start_s:.3f}")
    t = t + noise.standard_exponential(len(t)) * 2e-4
    data = constant[index]
    random_bytes = noise.integers(0, 256, data.shape, dtype=np.uint8)
    data = np.where(changing[index], random_bytes, data)
    n = len(t)
    return FrameColumns(
        t, ids[index].astype(np.uint32), np.full(n, 8, np.uint8), data, np.zeros(n, np.uint8),
        ("can0",),
    )  # fmt: skip


def _moments(
    cycles: Array, phases: Array, start_s: float, stop_s: float
) -> tuple[Array, NDArray[np.int64]]:
    times, owners = [], []
    for i, (cycle, phase) in enumerate(zip(cycles.tolist(), phases.tolist(), strict=True)):
        first = max(0, int(np.ceil(start_s / cycle - phase)))
        t = (np.arange(first, int(np.ceil(stop_s / cycle - phase))) + phase) * cycle
        times.append(t)
        owners.append(np.full(len(t), i, np.int64))
    if not times:
        return np.zeros(0), np.zeros(0, np.int64)
    return np.concatenate(times), np.concatenate(owners)


def arbitrated(frames: FrameColumns, bitrate: float, busy_until: float) -> FrameColumns:
    """Compute the times at which frames are sent on one bus. Frames do not overlap. Of several
    waiting frames, the frame with the lowest id is sent first.

    frames: in any order; t is the time of the send request. busy_until: time when the bus becomes
    free [s]. In the result, t is the end of each frame, when receivers record its time stamp.
    """
    order = np.argsort(frames.t, kind="stable")
    request = frames.t[order]
    duration = _durations(frames, bitrate)[order]
    priority = _priority(frames.can_id)[order]
    won = _served(request.tolist(), duration.tolist(), priority.tolist(), busy_until)
    end = _ends(request[won], duration[won], busy_until)
    sent = frames.take(order[won])
    return FrameColumns(
        end, sent.can_id, sent.length, sent.data, sent.channel, sent.channels, sent.fd
    )


def _ends(request: Array, duration: Array, busy_until: float) -> Array:
    """Return the ends of frames that are sent in the order of their requests: end[k] =
    max(request[k], end[k-1]) + duration[k]."""
    total = np.cumsum(duration)
    slack = np.maximum.accumulate(np.maximum(request, busy_until) - (total - duration))
    ends: Array = slack + total
    return ends


def _served(
    request: list[float], duration: list[float], priority: list[int], now: float
) -> NDArray[np.intp]:
    """Return the indices (N,) of the frames in the order of sending, from the time `now` [s] on."""
    waiting: list[tuple[int, int]] = []
    served: list[int] = []
    coming = 0
    while len(served) < len(request):
        if not waiting:
            now = max(now, request[coming])
        while coming < len(request) and request[coming] <= now:
            heapq.heappush(waiting, (priority[coming], coming))
            coming += 1
        chosen = heapq.heappop(waiting)[1]
        served.append(chosen)
        now += duration[chosen]
    return np.array(served, np.intp)


def _durations(frames: FrameColumns, bitrate: float) -> Array:
    extended = (frames.can_id & CAN_EFF_FLAG) != 0
    bits = np.where(extended, HEAD_BITS + LONG_ID_BITS, HEAD_BITS) + 8.0 * frames.length
    # stuff bits
    durations: Array = bits * (1.1 / bitrate)
    return durations


def _priority(can_id: NDArray[np.uint32]) -> NDArray[np.int64]:
    """Return the arbitration rank of ids. The first 11 bits are compared first; if they are equal,
    a frame with an 11-bit id wins."""
    extended = (can_id & CAN_EFF_FLAG) != 0
    number = (can_id & 0x1FFF_FFFF).astype(np.int64)
    result: NDArray[np.int64] = np.where(extended, (number << 1) | 1, number << 19)
    return result


def joined(parts: Sequence[FrameColumns]) -> FrameColumns:
    """Join frames of several messages, with common channels and width."""
    channels = tuple(dict.fromkeys(name for part in parts for name in part.channels))
    tables = [np.array([channels.index(c) for c in part.channels], np.uint8) for part in parts]
    return concatenate(
        [
            structs.replace(part, channel=table[part.channel], channels=channels)
            for part, table in zip(parts, tables, strict=True)
        ]
    )
