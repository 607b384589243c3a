"""A finding of `imucald check`, and common calculations for findings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imucald.config_check.motion import MIN_TICKS
from imucald.core.angles import DEG_PER_RAD
from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY, HEADING

Level = Literal["error", "warning", "note", "ok"]

ODD_GAIN = 1.4
"""A gain above this (or below its inverse) is suspicious. Measured and simulated vehicles have
gains of 0.8 to 1.2. A confusion of miles and kilometres multiplies the gain by 0.6 or 1.6."""

TURN_SIGN = "set 'sign: -1', or remove 'sign: -1' if it is set"
"""Text with the remedy for a wrong sign. If `sign: -1` is configured, this setting is the
mistake."""

_FACTORS = (
    (DEG_PER_RAD, "deg against rad"),
    (GRAVITY, "g against m/s²"),
    (3.6, "km/h against m/s"),
    (1.0 / 0.44704, "mph against m/s"),
    (1.609344, "mph against km/h"),
    (1000.0, "thousandths"),
)


@dataclass(frozen=True)
class Finding:
    """One finding. `quantity`: name in the configuration. beside: the other quantities with which
    it was compared."""

    level: Level
    quantity: str
    text: str
    beside: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, str]:
        """Return the finding as plain data for JSON."""
        return {"level": self.level, "quantity": self.quantity, "text": self.text}


def is_beyond(gain: float, limit: float) -> bool:
    """True if the size of a gain (ideally 1) is above a limit or below its inverse."""
    return not 1.0 / limit < abs(gain) < limit


def gain_guess(ratio: float, unit_advice: str | None) -> str:
    """Return a text with the likely cause of a gain that should be 1. unit_advice: advice for a
    quantity with a stated unit."""
    size, unit_advice = abs(ratio), unit_advice or "set 'unit:'"
    words = f"{size:.3g} times too large" if size > 1.0 else f"{1.0 / size:.3g} times too small"
    for factor, guess in _FACTORS:
        if abs(math.log(max(size, 1.0 / size) / factor)) < math.log(1.15):
            return f"{words}, which looks like {guess}; {unit_advice}"
    return f"{words}; check its unit and scale"


def sign_remedy(quantity: str) -> str:
    """Return the remedy for a wrong sign of a single signal that shows turns."""
    if quantity == HEADING.key:
        return f"a heading must increase in right turns; {TURN_SIGN}"
    return f"left turns must be positive; {TURN_SIGN}"


def spread(x: Array) -> float:
    """Standard deviation of the known values of x; 0 if there are too few."""
    known = x[np.isfinite(x)]
    return float(np.std(known)) if len(known) >= MIN_TICKS else 0.0


def cut_frames(name: str, shortest: int, size: int) -> str:
    """Return a text for a message whose frames are shorter [bytes] than in the database."""
    return (
        f"frames of {name} have {shortest} bytes, but the database says {size}: the signals "
        "in the last bytes are missing. Is it the database of this vehicle?"
    )
