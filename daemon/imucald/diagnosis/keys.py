"""Reads and writes numbers of a model by dotted key, with indices: `accel.bias.0`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from imucald.model.model import VehicleModel


def model_value(model: VehicleModel, key: str) -> float:
    """Return a number of the model; 0 for a cause's own key (it begins with `_`).

    None in the model (a low-pass that is not there) is infinity.
    """
    if key.startswith("_"):
        return 0.0
    place: Any = model
    for part in key.split("."):
        place = place[int(part)] if part.isdigit() else getattr(place, part)
    return float("inf") if place is None else float(place)


def with_values(model: VehicleModel, values: Mapping[str, float]) -> VehicleModel:
    """Return the model with numbers replaced; a cause's own keys are left out."""
    changes: dict[str, Any] = {}
    for key, value in values.items():
        if key.startswith("_"):
            continue
        parent, _, last = key.rpartition(".")
        if last.isdigit():
            whole = changes.get(parent)
            if whole is None:
                place: Any = model
                for part in parent.split("."):
                    place = getattr(place, part)
                whole = changes[parent] = list(place)
            whole[int(last)] = value
        else:
            changes[key] = value
    return model.with_changes(changes)
