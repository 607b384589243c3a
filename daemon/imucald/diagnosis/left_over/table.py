"""The questions about structure that no cause of the catalogue explains, as rows of tables.

Each row has the question, the kind of structure that it reports, and its statistic. The statistic
yields answers (`fit.chance.Answer`): the size of an effect, the smallest size that is reported, and
the probability of this size if nothing is wrong. `ODD` asks about raw values,
before any fit. `AGAINST` asks about the residuals of the stated model file, before the search.
`LEFT` asks about residuals after the search.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from imucald.diagnosis.direct.levels import Numbers, coarser, dead_band, hole, signals_of
from imucald.diagnosis.direct.single_values import held_values
from imucald.diagnosis.direct.successive import (
    CHANGES,
    changes_missing,
    changes_of,
    follows,
    jumps_alone,
    traits_of,
)
from imucald.diagnosis.fit.chance import Answer, Row, Tick, reported
from imucald.diagnosis.left_over.adequacy import goes_against, lines, shared, too_much
from imucald.diagnosis.left_over.courses import DELAY, by_course, gains_apart
from imucald.diagnosis.left_over.louder import LEAVES, more_than_stated, uneven
from imucald.diagnosis.left_over.orders import orders
from imucald.diagnosis.left_over.pairs import pairs
from imucald.diagnosis.left_over.remains import Remains
from imucald.diagnosis.outcome import implausible
from imucald.diagnosis.result import Kind, Structure
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import DriveSignals
from imucald.model.model import VehicleModel


class RawValues(NamedTuple):
    """Drives and their model file, before any fit."""

    drives: Sequence[DriveSignals]
    model: VehicleModel


def _of_each(
    statistic: Callable[[Numbers, VehicleModel], Iterator[Answer]],
) -> Callable[[RawValues], Iterator[Answer]]:
    """Return a statistic that asks each component of each signal of each drive."""
    return lambda raw: (
        answer
        for drive in raw.drives
        for signal in signals_of(drive)
        for answer in statistic(signal, raw.model)
    )


ODD = (
    Row(Kind.COARSER, "Are the values further apart than in the drives of the model file?",
        _of_each(coarser)),
    Row(Kind.VALUES_MISSING,
        "Is a speed 0 up to a higher value than in the drives of the model file?",
        _of_each(dead_band)),
    Row(Kind.VALUES_MISSING, "Does a signal jump over a range that it never shows?",
        _of_each(hole)),
    Row(Kind.CHANGES_MISSING, "Does a signal stay constant until it changes by a large amount?",
        _of_each(changes_missing)),
    Row(Kind.JUMPS_ALONE, "Do single values jump?", _of_each(jumps_alone)),
    Row(Kind.FOLLOWS_OTHERWISE,
        "Do samples follow each other in another way than in the drives of the model file?",
        lambda raw: raw.model.leaves
        and follows(*raw).answers(traits_of(raw.drives), raw.model)),
)  # fmt: skip
AGAINST = (
    Row(Kind.GOES_AGAINST, "Does a signal have the opposite sign of its prediction?", goes_against,
        True),
)  # fmt: skip
LEFT = (
    Row(Kind.NOT_PLAUSIBLE, "Do only physically impossible values explain the numbers?",
        lambda left: implausible(left.state), True),
    Row(Kind.TOO_MUCH, "Is the sideways residual larger than in any measured car?", too_much, True),
    Row(Kind.UNEVEN, "Do some segments have a residual larger than their noise?", uneven, True),
    Row(Kind.VALUE_HELD,
        "Does a sensor show one value far more often than the neighbouring values?",
        lambda left: held_values(left.state.drives), True),
    Row(Kind.SHARED_MOTION, "Do two equations without a common sensor have a common residual?",
        shared, True),
    Row(Kind.GOES_WITH_ANOTHER, "Does an error of one signal depend on another signal?", pairs),
    Row(Kind.TURNS_WITH_WHEEL, "Does the speed oscillate with each turn of a wheel?", orders),
    Row(Kind.OSCILLATES, "Does a residual oscillate at one frequency?", lines),
    Row(Kind.WANDERS, "Does a zero error, a gain or a delay change with time?", by_course),
    Row(Kind.WANDERS, "Do the gains of segments differ, in any order?", gains_apart),
    Row(Kind.LOUDER, "Is the median residual larger than in the drives of the model file?",
        lambda left: LEAVES.answers(left.by_band, left.state.stated)),
    Row(Kind.LOUDER, "Do some segments leave more than in the drives of the model file?",
        more_than_stated),
    Row(Kind.CHANGES_OTHERWISE,
        "Do the changes of samples differ from the drives of the model file?",
        lambda left: left.state.stated.leaves
        and CHANGES.answers(changes_of(left.state.drives, left.state.model), left.state.stated)),
)  # fmt: skip


def left_over(state: State, tick: Tick) -> list[Structure]:
    """Return structure in the residuals that no cause explains. Stamps that leave their cycle need
    an explanation, so the delay of the speed has an error rate of its own."""
    return reported(LEFT, Remains.of_state(state), tick, apart=DELAY)
