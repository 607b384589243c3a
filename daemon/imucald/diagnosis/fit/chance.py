"""Many questions about what is left, and one false-discovery rate over all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from imucald.diagnosis.result import Structure

FALSE_SHARE = 0.01
"""Of what is reported; where nothing is left, the chance that anything is."""


@dataclass(frozen=True)
class Question:
    """Asked of a residual: its chance where nothing is there, and what would be reported."""

    p: float
    is_large: bool
    """Beyond what a correct model file may leave."""
    structure: Structure


def beyond_chance(asked: Sequence[Question]) -> list[Structure]:
    """What is reported: of the k smallest of M chances those up to k 0.01/M (Benjamini and Hochberg
    1995), if they are large; of each signal and kind the largest."""
    found: dict[tuple[str, str], Structure] = {}
    ranked = sorted(asked, key=lambda q: q.p)
    sure = [k + 1 for k, q in enumerate(ranked) if q.p <= (k + 1) * FALSE_SHARE / len(ranked)]
    for q in ranked[: max(sure, default=0)]:
        at = q.structure.signal, q.structure.kind
        if q.is_large and (at not in found or q.structure.size > found[at].size):
            found[at] = q.structure
    return list(found.values())
