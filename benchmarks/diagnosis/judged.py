"""What counts as right: one outcome against what was hidden."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hidden import OUTSIDE_SIGNALS

Array = NDArray[np.float64]
Line = Mapping[str, Any]

LARGEST_SET = 3
"""An ambiguous set counts where it holds the right cause and at most two others."""
WITHIN_STD = 3.0
NEAR_FLOOR = 1.10


def hidden_names(line: Line) -> list[str]:
    return [cause for cause, _ in line["hidden"]]


def said_names(line: Line) -> list[str]:
    return [cause["name"] for cause in line["said"]["causes"]]


def is_identifiable(line: Line) -> bool:
    """Every hidden effect is of medium size at least."""
    return all(size in {"medium", "large"} for _, size in line["hidden"])


def size_of(line: Line) -> str:
    return str(line["hidden"][0][1])


def set_with(line: Line, cause: str) -> Sequence[str]:
    """The set of look-alikes that holds a cause; empty without one or where it is too large."""
    for names in line["said"].get("look_alikes", []):
        if cause in names and len(names) <= LARGEST_SET:
            return list(names)
    return []


def naming(line: Line) -> str:
    """How a single hidden effect was named.

    `right`: it and nothing else. `set`: an ambiguous set of at most three with it, and nothing
    else. `beside`: it, and something that is not there. `wrong`: others only. Else the verdict.
    """
    (true,) = hidden_names(line)
    verdict, said = line["said"]["verdict"], said_names(line)
    if verdict in {"nothing", "unknown", "error"} and not said:
        return str(verdict)
    alike = set_with(line, true)
    if verdict == "found" and said == [true]:
        return "right"
    if alike and set(said) <= {true, *alike}:
        return "set"
    if verdict == "unknown":
        return "unknown"
    return "beside" if true in said else "wrong"


def named(line: Line) -> list[str]:
    """Hidden causes that were named, alone or in a set with something that was said."""
    said = set(said_names(line))
    return [
        cause
        for cause in hidden_names(line)
        if cause in said or (said & set(set_with(line, cause)))
    ]


def invented(line: Line) -> list[str]:
    """Causes said that are not hidden, and not in a set with one that is."""
    true = hidden_names(line)
    alike = {name for cause in true for name in set_with(line, cause)}
    return [name for name in said_names(line) if name not in true and name not in alike]


def outside_signals_are_right(line: Line) -> bool:
    """Structure was reported in a signal that the effect touches."""
    touched = {s for cause in hidden_names(line) for s in OUTSIDE_SIGNALS[cause]}
    return any(s["signal"] in touched for s in line["said"].get("structure", []))


def z_scores(lines: Sequence[Line]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Errors of the parameters of rightly named causes, in their standard deviations."""
    return np.array(
        [
            (score["value"] - score["true"]) / max(score["std"], 1e-300)
            for line in lines
            for score in line["scores"]
            if score["cause"] in hidden_names(line)
        ]
    )


def relative_error(line: Line) -> float | None:
    """Error of the named cause's parameters together, relative to their hidden change.

    Axes of a triad count as one vector. None where the cause was not named.
    """
    (true,) = hidden_names(line)
    scores = [s for s in line["scores"] if s["cause"] == true]
    if not scores:
        return None
    error = np.array([s["value"] - s["true"] for s in scores])
    change = np.array([s["true"] - s["base"] for s in scores])
    return float(np.linalg.norm(error)) / max(float(np.linalg.norm(change)), 1e-300)


def floors(line: Line) -> list[float]:
    """Residual over noise floor after extension, of the signals that the named causes touch."""
    touched = {s for cause in line["said"]["causes"] for s in cause["signals"]}
    return [
        s["rms_after"] / s["noise_floor"]
        for name, s in line["said"]["signals"].items()
        if name in touched and s["noise_floor"]
    ]


def mount_error(line: Line, model: str) -> float | None:
    """Angle [deg] by which the daemon's mount is wrong at the end of the drive."""
    vector = line.get("vehicle", {}).get(model, {}).get("mount_deg")
    return None if vector is None else float(np.linalg.norm(vector))


def turn(line: Line, model: str) -> Array | None:
    """Rotation vector (3,) [deg] by which the effect turns the daemon's mount.

    That is against the same drive without the effect.
    """
    vehicle = line.get("vehicle", {})
    with_it, without = (vehicle.get(name, {}).get("mount_deg") for name in (model, "without"))
    if with_it is None or without is None:
        return None
    return np.asarray(np.subtract(with_it, without))


def turned(line: Line, model: str) -> float | None:
    """Size of `turn` [deg]."""
    vector = turn(line, model)
    return None if vector is None else float(np.linalg.norm(vector))


def turned_deviations(line: Line, model: str, stated: str = "before") -> float | None:
    """The same, about the axis where it is largest, in deviations that the daemon states there.

    stated: with which mount: `before`, the one with the effect and the honest model file, or
    `without` the effect. The first is wider where an effect makes all less certain.
    """
    vector, std = turn(line, model), line.get("vehicle", {}).get(stated, {}).get("std_deg")
    return None if vector is None or std is None else float(np.max(np.abs(vector) / std))


def force_error(line: Line, model: str) -> float | None:
    """rms error of the corrected horizontal force [m/s^2]."""
    force = line.get("vehicle", {}).get(model, {}).get("force")
    return None if force is None else float(np.hypot(force[0], force[1]))
