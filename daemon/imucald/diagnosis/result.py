"""What a diagnosis says: verdict, causes, look-alikes, gain, and the pictures' numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from imucald.model.model import VehicleModel

Verdict = Literal["found", "ambiguous", "unknown", "nothing"]
Array = NDArray[np.float64]


@dataclass(frozen=True)
class Estimated:
    """A parameter's value with its standard deviation, both in `unit`."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class FoundCause:
    """A cause that the measured drives show."""

    name: str
    parameters: Mapping[str, Estimated]
    signals: tuple[str, ...]
    """The signals that it touches, as in `Diagnosis.signals`."""
    evidence: Mapping[str, float]
    """`log_bayes_factor` against the model without it, `probability`, `sigma` (departure in units
    of its standard deviation)."""
    gain: Mapping[str, float]
    """`held_out_log_likelihood` by this cause, in nats."""
    text: str
    """One sentence for a person."""


@dataclass(frozen=True)
class Candidate:
    """A hypothesis that lost: causes that were tried together, and by how much they lost."""

    names: tuple[str, ...]
    log_evidence: float
    """Against the winner [nats]; negative."""
    reason: str


@dataclass(frozen=True)
class SignalGain:
    """Residual of one measured signal, rms in `unit`."""

    rms_before: float
    rms_after: float
    noise_floor: float
    unit: str


@dataclass(frozen=True)
class Gain:
    """What the extended model is worth on data that its fit did not use."""

    held_out_log_likelihood: float
    """Nats by which the held-out stretches are likelier."""
    interval: tuple[float, float]
    """95 % interval of that, over whole stretches."""
    mount_error_deg_before: float | None = None
    mount_error_deg_after: float | None = None


GOES_AGAINST = "goes against the model"
"""Kind of structure where a signal moves against what is predicted."""


@dataclass(frozen=True)
class Structure:
    """Something left in a residual that no candidate explains."""

    signal: str
    kind: str
    """Such as `spectral peak`, `bursts`, `depends on speed`."""
    size: float
    """In standard deviations of what chance would give, or as a ratio to the expected power."""
    text: str


@dataclass(frozen=True)
class SignalPicture:
    """Numbers to draw for one signal; arrays (N,) on `t` unless said otherwise."""

    signal: str
    unit: str
    t: Array
    """[s] from the first drive's start; drives follow each other."""
    measured: Array
    predicted_before: Array
    predicted_after: Array
    driver_name: str
    """The input that the residual goes with most, such as `dv/dt [m/s^2]`."""
    driver: Array
    frequency: Array
    """(F,) [Hz]"""
    spectrum_before: Array
    """(F,) one-sided residual density, unit^2/Hz; likewise the two below."""
    spectrum_after: Array
    spectrum_floor: Array


@dataclass(frozen=True)
class Diagnosis:
    """The outcome of `diagnose`."""

    verdict: Verdict
    causes: tuple[FoundCause, ...]
    look_alikes: tuple[tuple[str, ...], ...]
    to_separate: str
    signals: Mapping[str, SignalGain]
    gain: Gain
    duration_s: float
    candidates: tuple[Candidate, ...] = ()
    structure: tuple[Structure, ...] = ()
    notes: tuple[str, ...] = ()
    """What the person should know: signals absent, drives too short, stretches left out."""
    pictures: tuple[SignalPicture, ...] = ()
    model_before: VehicleModel = field(default_factory=VehicleModel)
    model_after: VehicleModel = field(default_factory=VehicleModel)

    def as_json(self) -> dict[str, Any]:
        """Return what tools rely on: plain numbers, lists and texts; nothing infinite."""
        return {
            "verdict": self.verdict,
            "causes": [
                {
                    "name": cause.name,
                    "parameters": {
                        name: {"value": _plain(p.value), "std": _plain(p.std), "unit": p.unit}
                        for name, p in cause.parameters.items()
                    },
                    "signals": list(cause.signals),
                    "evidence": {name: _plain(x) for name, x in cause.evidence.items()},
                    "gain": {name: _plain(x) for name, x in cause.gain.items()},
                    "text": cause.text,
                }
                for cause in self.causes
            ],
            "look_alikes": [list(names) for names in self.look_alikes],
            "to_separate": self.to_separate,
            "signals": {
                name: {
                    "rms_before": _plain(s.rms_before),
                    "rms_after": _plain(s.rms_after),
                    "noise_floor": _plain(s.noise_floor),
                    "unit": s.unit,
                }
                for name, s in self.signals.items()
            },
            "gain": {
                "held_out_log_likelihood": _plain(self.gain.held_out_log_likelihood),
                "interval": [_plain(x) for x in self.gain.interval],
                "mount_error_deg_before": _plain(self.gain.mount_error_deg_before),
                "mount_error_deg_after": _plain(self.gain.mount_error_deg_after),
            },
            "duration_s": _plain(self.duration_s),
            "structure": [
                {"signal": s.signal, "kind": s.kind, "size": _plain(s.size), "text": s.text}
                for s in self.structure
            ],
            "candidates": [
                {"names": list(c.names), "log_evidence": _plain(c.log_evidence), "reason": c.reason}
                for c in self.candidates
            ],
            "notes": list(self.notes),
        }


def _plain(x: float | None) -> float | None:
    return None if x is None or not math.isfinite(x) else round(float(x), 9)
