"""Where the search for causes stands, and what it tries next."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from imucald.diagnosis.cause import Parameter, Variant
from imucald.diagnosis.grid import Array
from imucald.diagnosis.linear import Linearised

ACCEPT = 3.5
"""Log posterior odds above which a cause is accepted in a step."""


@dataclass(frozen=True)
class Trial:
    """One form of one cause, tried on top of the active ones."""

    variant: Variant
    score: float
    """Log posterior odds against leaving it out."""
    start: Mapping[str, float]
    """Values to begin its fit from."""


@dataclass
class Found:
    """Where the search stands."""

    active: list[Variant]
    scores: dict[str, float]
    """Cause to the log posterior odds with which it was accepted."""
    point: Linearised
    tempers: Array
    """(P,) dispersion of the stretches' scores."""
    alike: list[tuple[str, ...]] = field(default_factory=list)
    """Causes whose own fits were as good as that of the first, which is active."""

    @property
    def keys(self) -> list[str]:
        """All parameters of the active causes."""
        return [key for variant in self.active for key in variant.keys]


def signal_of(key: str) -> str:
    """Signal that a parameter's key speaks of."""
    parts = key.split(".")
    return parts[1] if parts[0] == "_lowpass" else parts[0]


def within(p: Parameter, value: float) -> float:
    """Keep a value in what the model file allows."""
    low = -math.inf if p.least is None else p.least
    high = math.inf if p.most is None else p.most
    return min(max(value, low), high)
