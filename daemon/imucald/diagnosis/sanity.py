"""Before anything is searched for: do drives and model belong together at all?"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from imucald.core.errors import EstimateError
from imucald.diagnosis.forward import UNITS, Forward
from imucald.diagnosis.grid import GRID_HZ, ROLLING_MPS, Array
from imucald.diagnosis.result import GOES_AGAINST, Structure
from imucald.inputs.quantities import LIMITS

LEAST_ROLLING_S = 45.0
"""A vehicle that hardly moves shows nothing of scales, lever arm, handling."""
AGAINST = -0.4
"""A signal whose correlation with what is predicted is lower goes against it."""
LEAST_RMS = {"m/s^2": 0.1, "rad/s": 0.005}
"""What is predicted must move by so much, rms, to be compared."""
_LIMIT = {"m/s^2": LIMITS["acceleration"], "rad/s": LIMITS["angular_rate"]}


def refuse_unusable(forwards: Sequence[Forward]) -> None:
    """Raise EstimateError where the drives have no driving or the model predicts what cannot be."""
    rolling = rolling_s(forwards)
    if rolling < LEAST_ROLLING_S:
        raise EstimateError(
            f"diagnosis needs at least {LEAST_ROLLING_S:.0f} s of driving in which all signals are "
            f"there, these logs have {rolling:.0f} s"
        )
    with np.errstate(all="ignore"):
        predicted = forwards[0].predict(forwards[0].base())
    for name, x in zip(forwards[0].names, predicted, strict=True):
        unit = UNITS[name]
        largest = float(np.abs(x).max())
        if not largest <= _LIMIT.get(unit, math.inf):
            raise EstimateError(
                f"the model file predicts {largest:.3g} {unit} for {name}, which cannot be: look "
                "at its scales, offsets and lever arm, and at units and signs in the configuration"
            )


def rolling_s(forwards: Sequence[Forward]) -> float:
    """How long the drives move [s], of what can be compared."""
    return sum(float(np.sum(_rolling(f))) for f in forwards) / GRID_HZ


def against(forwards: Sequence[Forward]) -> list[Structure]:
    """Signals that move against what the model file predicts: a sign is wrong, not a parameter."""
    made = []
    drives = [_compared(f) for f in forwards]
    for i, name in enumerate(forwards[0].names):
        both = np.concatenate([drive[i] for drive in drives], axis=1)
        least = LEAST_RMS.get(UNITS[name], math.inf)
        if both.shape[1] < 2 or (both.std(axis=1) < least).any():
            continue
        together = float(np.corrcoef(both)[0, 1])
        if together < AGAINST:
            made.append(Structure(name, GOES_AGAINST, abs(together), _text(name, together)))
    return made


def _text(name: str, together: float) -> str:
    return (
        f"{name} goes against what the model predicts (correlation {together:.2f}): a sign in the "
        "configuration is wrong, of this signal or of one that it is predicted from, or the mount "
        "in the model file is. 'imucald check' looks for wrong signs."
    )


def _compared(forward: Forward) -> list[Array]:
    """Each signal as measured and as predicted (2, n) while rolling, less their means."""
    predicted, rolling = forward.predict(forward.base()), _rolling(forward)
    pairs = []
    for x, p, usable in zip(forward.measured, predicted, forward.usable, strict=True):
        both = np.stack([x, p])[:, usable & rolling]
        pairs.append(both - both.sum(axis=1, keepdims=True) / max(both.shape[1], 1))
    return pairs


def _rolling(forward: Forward) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    moving = np.abs(forward.track.scalars["speed"]) > ROLLING_MPS
    return np.asarray(moving & forward.track.usable["speed"] & forward.track.usable["accel"])
