"""Find the signals of the four wheel speeds, and the wheel of each signal."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np

from imucald.config_check.motion import Motion, less, moving, right_less_left
from imucald.config_check.relation import Relation, relation
from imucald.discovery.candidates import MEASURED_BITS, SeenSignal
from imucald.discovery.evidence import UnitChoice
from imucald.discovery.names import WHEELS, wheel_by_name
from imucald.discovery.proposal import Choice, Proposed, source_of

SAME_SPEED = 0.1
"""Largest relative difference between the mean wheel speeds of one vehicle. Different tyres cause 3
%."""
SIDE_BY_SIDE = 0.98
"""Smallest correlation between the wheel speeds in a drive. Wheel speeds of one vehicle differ only
in bends and by slip."""
HALF_SQUARE = (1.5, 12.0)
"""Range of half of the square of a wheelbase [m^2], for 2 m to 5 m. Side-slip reduces the measured
value."""

IN_ORDER = "right wheels are faster in left turns"
BY_TURNS = "left and right follow from the yaw rate"
EXCHANGED = "the recording shows that left and right are exchanged"


def wheel_sets(candidates: Sequence[SeenSignal]) -> Iterator[tuple[SeenSignal, ...]]:
    """Yield all sets of four similar signals that move like the wheels of one vehicle."""
    kinds: dict[object, list[SeenSignal]] = {}
    for c in candidates:
        if (
            c.may_be("speed")
            and not c.is_constant
            and not c.levels
            and c.signal.length >= MEASURED_BITS
        ):
            s = c.signal
            kinds.setdefault((c.unit, s.length, s.scale, s.offset, s.byte_order), []).append(c)
    for kind in kinds.values():
        by_message: dict[str, list[SeenSignal]] = {}
        for c in kind:
            by_message.setdefault(c.message.name, []).append(c)
        fours = [m for m in by_message.values() if len(m) == 4]
        twos = [m for m in by_message.values() if len(m) == 2]
        fours += [a + b for a, b in itertools.combinations(twos, 2)]
        if len(kind) == 4 and not fours:
            fours = [kind]
        for four in fours:
            if _roll_together(four):
                yield tuple(four)


def _roll_together(four: Sequence[SeenSignal]) -> bool:
    table = np.column_stack([c.smooth for c in four])
    table = table[np.isfinite(table).all(axis=1)]
    if len(table) < 100 or not (table.std(axis=0) > 0.0).all():
        return False
    means = table.mean(axis=0)
    if means.min() <= 0.0 or means.max() > (1.0 + SAME_SPEED) * means.min():
        return False
    return bool(np.corrcoef(table.T).min() > SIDE_BY_SIDE)


def find_wheels(
    four: Sequence[SeenSignal], unit: UnitChoice, doubt: str, motion: Motion
) -> tuple[Choice, float | None]:
    """Find the wheel of each signal, and the track [m]. If the names show all wheels, the names
    decide.

    In a left turn, the right wheels are faster. In any turn, the front wheels are faster.
    """
    named = [wheel_by_name(c.signal.name) for c in four]
    by_name = sorted(n or "" for n in named) == sorted(WHEELS)
    if by_name:
        order, text, unsure = (
            [named.index(w) for w in WHEELS],
            "the names show the wheel of each",
            "",
        )
    else:
        order, text, unsure = _by_turns(four, unit, motion)
    track = _track(four, order, unit, motion)
    if by_name and track is not None and track.is_believed:
        text += f"; {IN_ORDER if track.sign > 0 else IN_ORDER.replace('right', 'LEFT')}"
        doubt = EXCHANGED if track.sign < 0 else doubt
    sources: dict[str, Proposed] = {
        wheel: source_of(four[i], unit.name) for wheel, i in zip(WHEELS, order, strict=True)
    }
    words = f"four similar speeds; {text}"
    choice = Choice("wheel_speeds", sources, words, doubt or unsure)
    if track is None or not track.is_believed or track.sign < 0 or track.explained <= 0.8:
        return choice, None
    return choice, track.low if 0.8 < track.low < 3.0 else None


def _by_turns(
    four: Sequence[SeenSignal], unit: UnitChoice, motion: Motion
) -> tuple[list[int], str, str]:
    """Return the indices of the wheels in the order front left, front right, rear left, rear right,
    then the evidence, then the doubt."""
    unknown = (
        [0, 1, 2, 3],
        "the wheels are in the order of their bits",
        "the wheel of each signal is not known",
    )
    if motion.turn is None:
        return unknown
    table = np.column_stack([c.smooth for c in four]) * unit.factor
    v = moving(table.mean(axis=1))
    curvature = motion.turn / v
    sides = [relation(curvature, table[:, i] / v) for i in range(4)]
    right = [i for i in range(4) if sides[i].sign > 0]
    left = [i for i in range(4) if i not in right]
    if len(right) != 2 or not all(s.is_believed for s in sides):
        return unknown
    drive = np.zeros(len(v)) if motion.change is None else motion.change
    known = np.column_stack([curvature, drive, v])  # side, slip with acceleration, size of the tyre
    squared = less(curvature**2, known)

    def front_first(a: int, b: int) -> tuple[int, int, bool]:
        """Return two wheels with the front wheel (the faster wheel in bends) first, and whether
        this order is sure.

        The path of a front wheel is longer by half of the square of wheelbase times curvature.
        """
        found = relation(squared, less((table[:, a] - table[:, b]) / v, known))
        first, second = (b, a) if found.sign < 0 else (a, b)
        low, high = HALF_SQUARE
        return first, second, found.is_believed_of(2) and low < found.low < high

    front_left, rear_left, sure_left = front_first(*left)
    front_right, rear_right, sure_right = front_first(*right)
    if sure_left and sure_right and (front_left < rear_left) == (front_right < rear_right):
        text = f"{BY_TURNS}, front and rear from the distances that the wheels roll in bends"
        return [front_left, front_right, rear_left, rear_right], text, ""
    order = [left[0], right[0], left[1], right[1]]
    return order, BY_TURNS, "the front wheels are guessed from the order of the signals"


def _track(
    four: Sequence[SeenSignal], order: Sequence[int], unit: UnitChoice, motion: Motion
) -> Relation | None:
    """Return the relation between the yaw rate and the speed difference of right and left wheels,
    both divided by the speed. Its gain is the track."""
    if motion.turn is None:
        return None
    fl, fr, rl, rr = (four[i].smooth * unit.factor for i in order)
    v = moving(0.25 * (fl + fr + rl + rr))
    return relation(motion.turn / v, right_less_left(fl, fr, rl, rr) / v)
