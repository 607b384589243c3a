"""Answers of the rows of `left_over.table`, by the kind of structure that they report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from imucald.diagnosis.fit.chance import Answer, Row
from imucald.diagnosis.fit.score import Hypothesis, Problem
from imucald.diagnosis.left_over.remains import Remains
from imucald.diagnosis.left_over.table import LEFT, ODD, RawValues
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import DriveSignals
from imucald.model.model import VehicleModel


def nothing_named() -> State:
    return State((), VehicleModel(), VehicleModel(), {})


def remains(
    problem: Problem, state: State | None = None, drift: Hypothesis | None = None
) -> Remains:
    return Remains(problem, state or nothing_named(), drift)


def answers(rows: Sequence[Row], kind: str, evidence: Any) -> list[Answer]:
    return [answer for row in rows if row.kind == kind for answer in row.asked(evidence)]


def odd(kind: str, drive: DriveSignals, model: VehicleModel | None = None) -> list[Answer]:
    """Of the raw values of a drive."""
    return answers(ODD, kind, RawValues([drive], model or VehicleModel()))


def left(kind: str, of: Remains) -> list[Answer]:
    """Of residuals."""
    return answers(LEFT, kind, of)
