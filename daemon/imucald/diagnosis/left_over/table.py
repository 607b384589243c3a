"""The questions about structure that no cause of the catalogue explains, as rows of tables.

Each row has the question, the kind of structure that it reports, and its statistic. An answer of
the statistic has a size, the least size that counts, and its chance. `ODD` asks about raw values,
before any fit. `LEFT` asks about residuals, after the search.
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
from imucald.diagnosis.fit.chance import Answer, Row, reported
from imucald.diagnosis.left_over.adequacy import lines, shared, too_much
from imucald.diagnosis.left_over.courses import DELAY, by_course, gains_apart
from imucald.diagnosis.left_over.louder import LEAVES, more_than_stated, uneven
from imucald.diagnosis.left_over.orders import orders
from imucald.diagnosis.left_over.pairs import pairs
from imucald.diagnosis.left_over.remains import Remains
from imucald.diagnosis.outcome import implausible
from imucald.diagnosis.result import (
    CHANGES_MISSING,
    CHANGES_OTHERWISE,
    COARSER,
    FOLLOWS_OTHERWISE,
    GOES_WITH_ANOTHER,
    JUMPS_ALONE,
    LOUDER,
    OSCILLATES,
    SHARED_MOTION,
    TOO_MUCH,
    TURNS_WITH_WHEEL,
    UNEVEN,
    VALUE_HELD,
    VALUES_MISSING,
    WANDERS,
    Structure,
)
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


def _following(raw: RawValues) -> Iterator[Answer]:
    drives, model = raw
    return follows(*raw).answers(traits_of(drives), model) if model.leaves else iter(())


def _beside_stated(left: Remains) -> Iterator[Answer]:
    stated = left.state.stated
    return LEAVES.answers(left.by_band, stated) if stated.leaves else iter(())


def _changing(left: Remains) -> Iterator[Answer]:
    state = left.state
    if not state.stated.leaves:
        return iter(())
    return CHANGES.answers(changes_of(state.drives, state.model), state.stated)


ODD = (
    Row("Are the values further apart than in the drives of the model file?", COARSER,
        _of_each(coarser)),
    Row("Is a speed 0 up to a higher value than in the drives of the model file?",
        VALUES_MISSING, _of_each(dead_band)),
    Row("Does a signal jump over a range that it never shows?", VALUES_MISSING, _of_each(hole)),
    Row("Does a signal stay constant until it changes by a large amount?", CHANGES_MISSING,
        _of_each(changes_missing)),
    Row("Do single values jump?", JUMPS_ALONE, _of_each(jumps_alone)),
    Row("Do samples follow each other in another way than in the drives of the model file?",
        FOLLOWS_OTHERWISE, _following),
)  # fmt: skip
LEFT = (
    Row("Is the sideways residual larger than in any measured car?", TOO_MUCH, too_much, True),
    Row("Do some segments have a residual larger than their noise?", UNEVEN, uneven, True),
    Row("Does a sensor show one value far more often than the neighbouring values?", VALUE_HELD,
        lambda left: held_values(left.state.drives), True),
    Row("Do two equations without a common sensor have a common residual?", SHARED_MOTION,
        shared, True),
    Row("Does an error of one signal depend on another signal?", GOES_WITH_ANOTHER, pairs),
    Row("Does the speed oscillate with each turn of a wheel?", TURNS_WITH_WHEEL, orders),
    Row("Does a residual oscillate at one frequency?", OSCILLATES, lines),
    Row("Does a zero error, a gain or a delay change with time?", WANDERS, by_course),
    Row("Do the gains of segments differ, in any order?", WANDERS, gains_apart),
    Row("Is the median residual larger than in the drives of the model file?", LOUDER,
        _beside_stated),
    Row("Do some segments have a larger residual than in the drives of the model file?", LOUDER,
        more_than_stated),
    Row("Do the changes of samples differ from the drives of the model file?", CHANGES_OTHERWISE,
        _changing),
)  # fmt: skip


def odd_values(drives: Sequence[DriveSignals], model: VehicleModel) -> list[Structure]:
    """Return structure in raw values that no healthy signal shows. Faults are not included."""
    return reported(ODD, RawValues(drives, model))


def left_over(state: State) -> list[Structure]:
    """Return structure in the residuals that no cause explains. Stamps that leave their cycle need
    an explanation, so the delay of the speed has an error rate of its own."""
    return [*implausible(state), *reported(LEFT, Remains.of_state(state), apart=DELAY)]
