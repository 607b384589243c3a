"""Looks for all faults of a drive, and sets right what can be."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from imucald.core.samples import Samples, Series
from imucald.diagnosis.faults import clock_drift, dropouts, saturation, stuck_signal
from imucald.diagnosis.faults.cycle import cycle_of
from imucald.diagnosis.faults.fault import Fault, Stretches, joined, watched
from imucald.model.model import VehicleModel

LONGEST_DROPOUT_LIST = 2000
"""A model file is made to be read."""


def find_faults(samples: Samples, model: VehicleModel) -> list[Fault]:
    """Return the faults that a drive's samples and stamps show, surest first.

    model: the baseline; its rates, losses and clock drifts are what is expected. Channels of less
    than a few hundred samples, and those without a cycle (for drop-outs and drift), say nothing.
    """
    names = watched(samples)
    cycles = {name: cycle for name in names if (cycle := cycle_of(samples[name])) is not None}
    found = saturation.find(samples, model)
    railed = frozenset(fault.signal for fault in found)
    found += dropouts.find(samples, model, cycles)
    found += stuck_signal.find(samples, model, railed)
    found += clock_drift.find(samples, model, cycles)
    return sorted(found, key=lambda fault: -fault.score)


def spoilt(faults: Sequence[Fault]) -> dict[str, Stretches]:
    """Return the stretches [s] of each channel that must not be used."""
    gathered: dict[str, list[tuple[float, float]]] = {}
    for fault in faults:
        gathered.setdefault(fault.signal, []).extend(fault.spoilt)
    return {name: joined(stretches) for name, stretches in gathered.items() if stretches}


def corrected(samples: Samples, faults: Sequence[Fault]) -> Samples:
    """Return samples whose accelerometer and gyroscope have stamps that do not run off.

    Their delay becomes what it is at time 0. Without such a fault the samples are returned as
    they are.
    """
    ppm = next((f.parameters[clock_drift.STAMPS].value for f in faults
                if clock_drift.STAMPS in f.parameters), None)  # fmt: skip
    if ppm is None:
        return samples
    return {
        name: Series(series.t / (1.0 + 1e-6 * ppm), series.values)
        if name in clock_drift.UNIT
        else series
        for name, series in samples.items()
    }


def extend(model: VehicleModel, faults: Sequence[Fault]) -> VehicleModel:
    """Return the model with the faults written where it has a place for them.

    `full_scale`, `loss` (of single frames), `dropouts`, `stuck`, `clock_drift_ppm`. A place is
    wanting for the rail of a signal that is no inertial sensor, and for stamps that run off.
    """
    changes: dict[str, Any] = {}
    for fault in faults:
        changes.update(_changes(model, fault))
    return model.with_changes(changes) if changes else model


def _changes(model: VehicleModel, fault: Fault) -> Mapping[str, Any]:
    place = getattr(model, fault.signal)
    name = fault.signal
    gaps = [
        {"start_s": max(first, 0.0), "duration_s": last - first}
        for first, last in fault.spoilt[:LONGEST_DROPOUT_LIST]
        if last > max(first, 0.0)
    ]
    if fault.cause == "saturation" and hasattr(place, "full_scale"):
        return {f"{name}.full_scale": fault.parameters[f"{name}.full_scale"].value}
    if fault.cause == "dropouts":
        return {
            f"{name}.dropouts": gaps,
            f"{name}.loss": fault.parameters[f"{name}.single_loss"].value,
        }
    if fault.cause == "stuck_signal":
        return {f"{name}.stuck": gaps}
    return {
        key: parameter.value
        for key, parameter in fault.parameters.items()
        if key.endswith(".clock_drift_ppm")
    }
