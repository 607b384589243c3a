"""Find a speed and a steering angle in bytes that no database describes.

A field of one or two bytes is used if consecutive values are close together and the range of the
values is wide. Fields are proposed as `raw`.

Speeds are fields that are proportional to each other: wheels, transmission, display. The steering
angle is a field that follows the curvature, which is the difference of two wheel speeds divided by
their mean. If an accelerometer is known, the accelerometer gives the scale of the speed. No result
is sure, so all results are only suggestions.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK
from imucald.can.dbc.message import ByteOrder, Message, Signal
from imucald.config_check.motion import Motion, change_of
from imucald.config_check.relation import Relation, relation, response
from imucald.core.arrays import Array
from imucald.discovery.candidates import MessageTraffic, SeenSignal, candidates_of
from imucald.discovery.evidence import SAME_MOTION
from imucald.discovery.proposal import MAX_ALTERNATIVES, Alternative, Choice, Proposed
from imucald.discovery.recording import Traffic

MIN_FRAMES = 200
MIN_LEVELS = 40
"""Smallest number of different values of a speed or an angle in a drive."""
CLOSE = 0.02
"""Largest median step of a smooth field, relative to its range."""
JUMP = 0.25
"""Smallest step that counts as a jump, as a share of the range (a wrap, or bits of other
signals)."""
ROLL_TOGETHER = 0.995
"""Smallest correlation between two speeds of one vehicle."""
NO_OFFSET = 0.02
"""Largest value of a speed while another speed is zero, relative to the range."""
USUAL_KMH = (0.01, 1.0 / 64.0, 0.05625, 0.1, 1.0 / 256.0, 0.05, 0.02, 1.0)
"""Common scales of a speed signal [km/h]."""
TOP_SPEED = (8.0, 250.0)
"""Smallest and largest possible top speed of a drive [km/h]."""
TRACK, STEERING_METRES = 1.55, 40.0
"""Track, and wheelbase times steering ratio, of a passenger car [m]. The error of the resulting
scale is less than a third."""


def raw_choices(fields: Sequence[SeenSignal], motion: Motion, wanted: set[str]) -> list[Choice]:
    """Return suggestions for `speed` and `steering_wheel_angle` if they are in `wanted`. The
    suggestions are written as comments."""
    searches = {"speed": _speed, "steering_wheel_angle": _steering}
    found = (search(fields, motion) for name, search in searches.items() if name in wanted)
    return [choice for choice in found if choice is not None]


def _offer(quantity: str, offers: list[tuple[Proposed, str]], why: str) -> Choice | None:
    if not offers:
        return None
    others = [Alternative({"": source}, text) for source, text in offers[:MAX_ALTERNATIVES]]
    return Choice(
        quantity,
        {},
        "no database describes these bytes, but they change like this quantity",
        why,
        others,
    )


def _speed(fields: Sequence[SeenSignal], motion: Motion) -> Choice | None:
    if motion.accel is not None and motion.up is not None and not motion.planar:
        fits = []
        for c in fields:
            one = response(motion.accel, motion.up, change_of(c.smooth))
            shown = Relation() if one is None else one.relation
            if shown.is_believed and shown.explained >= SAME_MOTION:
                fits.append((shown, c))
        fits.sort(key=lambda f: -f[0].explained)
        return _offer(
            "speed",
            [
                (_scaled(c, "km/h", _usual(3.6 * r.gain, USUAL_KMH)),
                 f"its changes show in the accelerometer (correlation {r.correlation:.2f})")
                for r, c in fits
            ],
            "only the changes of these bytes show that they are a speed",
        )  # fmt: skip
    groups = speed_groups(fields)
    if not groups:
        return None
    best = groups[0]
    return _offer(
        "speed",
        [
            (
                _scaled(c, "km/h", _plausible_scale(c)),
                f"{len(best)} fields are equal except for a factor",
            )
            for c in best
        ],
        "the scale is a guess: compare the highest speed with the speed of the drive",
    )


def speed_groups(fields: Sequence[SeenSignal]) -> list[list[SeenSignal]]:
    """Return groups of fields that are proportional and zero at the same times, the largest group
    first."""
    rolling = [c for c in fields if _rests_at_its_least(c)]
    left, groups = list(rolling), []
    while left:
        first = left.pop(0)
        group = [first, *(c for c in left if _is_same_but_for_a_factor(first, c))]
        left = [c for c in left if c not in group]
        if len(group) > 1:
            groups.append(group)
    # a speed is in several messages, or there are four wheels; the largest group wins
    return sorted(groups, key=lambda g: (-len({c.message.name for c in g}) - len(g), g[0].cycle))


def _rests_at_its_least(c: SeenSignal) -> bool:
    """True if the smallest value of a field is close to zero. An angle, in contrast, has values in
    both directions."""
    known = c.x[np.isfinite(c.x)]
    return bool(len(known)) and c.least <= 0.1 * c.largest


def _is_same_but_for_a_factor(a: SeenSignal, b: SeenSignal) -> bool:
    rows = np.isfinite(a.smooth) & np.isfinite(b.smooth)
    if np.count_nonzero(rows) < 100:
        return False
    x, y = a.smooth[rows], b.smooth[rows]
    if not (x.std() > 0.0 and y.std() > 0.0) or np.corrcoef(x, y)[0, 1] < ROLL_TOGETHER:
        return False
    slope, offset = np.polyfit(x, y, 1)
    return bool(slope > 0.0 and abs(offset) < NO_OFFSET * b.largest)


def _plausible_scale(c: SeenSignal) -> float:
    low, high = TOP_SPEED
    return next((s for s in USUAL_KMH if low < s * c.largest < high), USUAL_KMH[0])


def _usual(scale: float, usual: Sequence[float]) -> float:
    """Return the common scale within 20 % of the found scale, else the found scale with two
    digits."""
    nearest = min(usual, key=lambda u: abs(np.log(u / scale)))
    return nearest if 0.8 < nearest / scale < 1.25 else float(f"{scale:.2g}")


def _scaled(c: SeenSignal, unit: str, scale: float, offset: float = 0.0) -> Proposed:
    assert c.raw is not None, "only raw fields are offered"
    value = str(c.raw["value"])
    if scale != 1.0:
        value = f"({value}) * {scale:.6g}"
    if offset:
        value += f" {'-' if offset < 0.0 else '+'} {abs(offset):.6g}"
    return Proposed(raw={**c.raw, "value": value}, unit=unit, channel=c.own_channel)


def _steering(fields: Sequence[SeenSignal], motion: Motion) -> Choice | None:
    curvature, what = motion.curvature, "the curvature"
    used: set[str] = set()
    if curvature is None:
        curvature, used = _curvature_of_wheels(fields)
        what = "the difference of two wheel speeds, divided by the speed"
    if curvature is None:
        return None
    fits: list[tuple[Relation, SeenSignal]] = []
    for c in fields:
        found = relation(curvature, c.smooth)
        if c.path not in used and found.is_believed and found.explained >= SAME_MOTION:
            fits.append((found, c))
    fits.sort(key=lambda f: -f[0].explained)
    offers = []
    for found, c in fits:
        rows = np.isfinite(curvature) & np.isfinite(c.smooth)
        straight = float(np.polyfit(curvature[rows], c.smooth[rows], 1)[1])
        scale = _usual(
            float(np.degrees(STEERING_METRES)) / found.gain, (0.1, 0.01, 0.05, 1 / 16, 0.5, 1.0)
        )
        source = _scaled(c, "deg", scale, -round(scale * straight, 1))
        if found.sign < 0:
            source = replace(source, sign=-1)
        offers.append((source, f"follows {what} (correlation {found.correlation:+.2f})"))
    return _offer(
        "steering_wheel_angle", offers,
        "scale and zero are guesses for a passenger car; the value must increase in left turns",
    )  # fmt: skip


def _curvature_of_wheels(fields: Sequence[SeenSignal]) -> tuple[Array | None, set[str]]:
    """Return the curvature [1/m] from two adjacent wheels in a message. The sign of the curvature
    is unknown."""
    for group in speed_groups(fields):
        by_message: dict[str, list[SeenSignal]] = {}
        for c in group:
            by_message.setdefault(c.message.name, []).append(c)
        for wheels in by_message.values():
            if len(wheels) < 2:
                continue
            left, right = wheels[0].smooth, wheels[1].smooth
            mean = 0.5 * (left + right)
            fast = np.where(mean > 0.15 * np.nanmax(mean), mean, np.nan)
            return (right - left) / fast / TRACK, {c.path for c in group}
    return None, set()


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
    values = data[:, places[0]]
    if len(places) == 2:
        values = values * 256 + data[:, places[1]]
    return _candidate(one, places, ticks, several) if _is_smooth(values) else None


def _is_smooth(values: NDArray[np.int64]) -> bool:
    span = int(values.max() - values.min())
    if span < MIN_LEVELS or len(np.unique(values)) < MIN_LEVELS:
        return False
    both = np.diff(values)
    steps = np.abs(both)
    if float(np.mean(steps > 0)) < 0.01:
        return False
    moving = steps[steps > 0]
    one_way = min(float((both > 0).mean()), float((both < 0).mean())) < 0.001
    return bool(
        not one_way  # a clock, a counter, an odometer
        and float(np.median(moving)) < CLOSE * span
        and int(steps.max()) < JUMP * span
    )


def _candidate(
    one: Traffic, places: tuple[int, ...], ticks: int, several: bool
) -> SeenSignal | None:
    """Return the field at these bytes, the upper one first."""
    is_big = places == tuple(sorted(places))
    start = 8 * places[0] + 7 if is_big else 8 * places[-1]
    order: ByteOrder = "big_endian" if is_big else "little_endian"
    signal = Signal(f"bytes_{'_'.join(map(str, places))}", start, 8 * len(places), order)
    number = one.can_id & CAN_EFF_MASK
    message = Message(f"0x{number:X}", one.can_id, one.data.shape[1], {signal.name: signal})
    upper, lower = (f"data[{place}]" for place in (places[0], places[-1]))
    value = upper if len(places) == 1 else f"{upper} * 256 + {lower}"
    raw = {"id": number, "value": value}
    if one.can_id & CAN_EFF_FLAG and number < 0x800:
        raw["extended"] = True
    traffic = MessageTraffic(message, one.channel, one.t, one.data, one.length)
    for found in candidates_of(traffic, ticks):
        return replace(found, raw=raw, own_channel=one.channel if several else None)
    return None
