"""A chain of processing stages. A stage is a callable that takes a sample, and changes or refuses
the sample."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

Stage = Callable[[float, Sequence[float]], Sequence[float] | None]
"""Function that takes the time [s] and the raw values of a sample. It returns the new values; None
if the sample is refused."""


def through(stages: Iterable[Stage], t: float, values: Sequence[float]) -> Sequence[float] | None:
    """Pass a sample through all stages and return the result; None if a stage refuses the
    sample."""
    for stage in stages:
        found = stage(t, values)
        if found is None:
            return None
        values = found
    return values
