"""A chain is a list of callables. Each callable takes a sample and changes or refuses it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

Stage = Callable[[float, Sequence[float]], Sequence[float] | None]
"""Stage: takes time [s] and raw values of one sample, returns its values; None if it is refused."""


def through(stages: Iterable[Stage], t: float, values: Sequence[float]) -> Sequence[float] | None:
    """Pass a sample through all stages and return the result; None as soon as one refuses it."""
    for stage in stages:
        found = stage(t, values)
        if found is None:
            return None
        values = found
    return values
