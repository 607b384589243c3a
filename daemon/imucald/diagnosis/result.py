"""The result of a diagnosis: verdict, causes, look-alikes, gain, and the numbers for the
pictures."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal

from imucald.core.arrays import Array
from imucald.model.model import VehicleModel

Verdict = Literal["found", "ambiguous", "unknown", "nothing"]
Certainty = Literal["certain", "likely"]
Outcome = Literal[
    "within tolerance", "not decidable here", "does not pay", "not plausible", "not ruled out"
]


@dataclass(frozen=True)
class Estimated:
    """A parameter's value with its standard deviation, both in `unit`."""

    value: float
    std: float
    unit: str
    stated: float = 0.0
    """Value in the model file."""
    tolerance: float = 0.0
    """Error that a correct model file may have (half width)."""


@dataclass(frozen=True)
class FoundCause:
    """A cause that the measured drives show."""

    name: str
    parameters: Mapping[str, Estimated]
    signals: tuple[str, ...]
    """The signals that the cause affects, as in `Diagnosis.signals`."""
    evidence: Mapping[str, float]
    """`held_out_nats`: increase of the log-likelihood of data outside the fit, without the best
    segments. `sigma`: difference from the model file in standard deviations. `quantile`: half width
    of the interval in standard deviations."""
    text: str
    """One sentence for a reader."""
    certainty: Certainty = "certain"
    against: tuple[str, ...] = ()
    """Arguments against the cause, as sentences."""
    along_sensor: Mapping[str, Estimated] = field(default_factory=dict)
    """Vectors of `parameters` along the sensor's axes, as in the model file: by the key of the file
    and the number of the axis."""

    @property
    def in_file(self) -> dict[str, Estimated]:
        """Parameters by the keys of the model file."""
        own = {k: p for k, p in self.parameters.items() if not self._is_turned(k)}
        return {**self.along_sensor, **own}

    @property
    def along_vehicle(self) -> dict[str, Estimated]:
        """Vectors along the vehicle's axes: `accel.bias.forward`, `.left`, `.up`."""
        return {
            f"{k[:-1]}{VEHICLE_AXES[k[-1]]}": p
            for k, p in self.parameters.items()
            if self._is_turned(k)
        }

    def _is_turned(self, key: str) -> bool:
        return f"{key[:-1]}0" in self.along_sensor


VEHICLE_AXES = {"x": "forward", "y": "left", "z": "up"}


OTHERWISE = (
    "; not certain: other causes fit as well, or data that were not fitted do not confirm it"
)
"""Reason why a cause that is large enough is not named."""


@dataclass(frozen=True)
class Candidate:
    """A cause that was not named."""

    name: str
    outcome: Outcome
    nats: float
    """Increase of the log-likelihood of data outside the fit, without the best segments [nats]."""
    text: str
    """Text with the value, and with the size from which these drives would have shown the cause."""
    parameters: Mapping[str, Estimated] = field(default_factory=dict)
    """Value of each parameter of the cause if this cause alone is fitted in addition."""
    key: str = ""
    """The parameter with the largest difference from the model file, relative to its standard
    deviation."""
    off: float = math.nan
    """Difference of this parameter from the model file, in `unit`. `std` and `shows_from` have the
    same unit."""
    std: float = math.nan
    shows_from: float = math.nan
    """Size from which these drives would have shown the cause."""
    unit: str = ""


@dataclass(frozen=True)
class SignalGain:
    """Residual of one measured signal, rms in `unit`. `rms_after` is the residual with the written
    model file, without a further fit."""

    rms_before: float
    rms_after: float
    noise_floor: float
    """Residual after a fit of all parameters of the catalogue."""
    unit: str
    slow_before: float = math.nan
    """`rms_before`, below 0.2 Hz only."""
    slow_after: float = math.nan
    left: str = ""
    """Remaining offset or drift, in words."""
    rms_unseen: float = math.nan
    """`rms_after`, but each segment is predicted with parameters that were fitted without it."""
    verdict: Verdict = "nothing"
    """Verdict of this signal alone."""


@dataclass(frozen=True)
class Gain:
    """Gain of the extended model file on data that its fit did not use."""

    held_out_log_likelihood: float
    """Increase of the log-likelihood of held-out segments with the written file alone [nats]."""
    interval: tuple[float, float]
    """95 % interval of this increase, computed over whole segments."""
    worse: tuple[str, ...] = ()
    """Signals that the extended model file predicts worse than the stated file."""
    was_fitted: bool = True
    """False if nothing was fitted. Facts that were read directly change no prediction."""


class Kind(StrEnum):
    """Kinds of structure that no cause of the catalogue explains; `left_over.table` has the
    questions."""

    GOES_AGAINST = "goes against the model"  # the opposite sign of the prediction
    TOO_MUCH = "too much is left"
    NOT_PLAUSIBLE = "not plausible"  # only a physically impossible value explains the numbers
    UNEVEN = "some segments leave more"
    WANDERS = "wanders"
    GOES_WITH_ANOTHER = "goes with another signal"
    SHARED_MOTION = "shared motion"
    OSCILLATES = "peak"
    TURNS_WITH_WHEEL = "turns with the wheel"
    LOUDER = "more is left than the file states"
    CHANGES_OTHERWISE = "changes by another amount than the file states"
    FOLLOWS_OTHERWISE = "samples follow each other in another way"
    COARSER = "coarser than the file states"
    VALUES_MISSING = "values are missing"
    CHANGES_MISSING = "small changes are missing"
    JUMPS_ALONE = "single values jump"
    VALUE_HELD = "a value is held"
    READINGS_LOST = "readings are lost"  # readings with one invalid value, which are not used


UNBELIEVED = (Kind.GOES_AGAINST, Kind.TOO_MUCH)
"""Kinds of left-over structure with which no fit is trusted."""


@dataclass(frozen=True)
class Structure:
    """Structure in a residual that no cause of the catalogue explains."""

    signal: str
    kind: str
    """One of `Kind`."""
    size: float
    """Size in standard deviations of chance, or as a ratio to the expected or allowed size."""
    text: str
    parameter: str = ""
    """The zero error or gain that changes during the drive; empty for other structures."""


@dataclass(frozen=True)
class SignalPicture:
    """Numbers for the pictures of one signal. Arrays are (N,) on `t` unless stated otherwise."""

    signal: str
    unit: str
    t: Array
    """Time [s] since the start of the first drive. The drives follow one another."""
    measured: Array
    predicted_before: Array
    predicted_after: Array
    driver_name: str
    """The input that correlates most with the residual, such as `dv/dt [m/s^2]`."""
    driver: Array
    frequency: Array
    """Frequencies (F,) [Hz]."""
    spectrum_before: Array
    """One-sided spectral density (F,) of the residual [unit^2/Hz]. `spectrum_after` has the same
    form."""
    spectrum_after: Array


@dataclass(frozen=True)
class Diagnosis:
    """The result of `diagnose`."""

    verdict: Verdict
    causes: tuple[FoundCause, ...]
    look_alikes: tuple[tuple[str, ...], ...]
    to_separate: str
    signals: Mapping[str, SignalGain]
    gain: Gain
    duration_s: float
    likely: tuple[FoundCause, ...] = ()
    """Likely causes, which are not written into the model file."""
    candidates: tuple[Candidate, ...] = ()
    structure: tuple[Structure, ...] = ()
    notes: tuple[str, ...] = ()
    """Notes for the user: missing signals, drives that are too short, segments that were left
    out."""
    pictures: tuple[SignalPicture, ...] = ()
    model_before: VehicleModel = field(default_factory=VehicleModel)
    model_after: VehicleModel = field(default_factory=VehicleModel)
    recommended: bool = False
    """True if the extended model file predicts held-out data better, and no signal worse."""
    complete: bool = True
    """False if the time limit ended the search."""
    channels: frozenset[str] | None = None
    """The signals of the drives; None: not known."""

    def as_json(self) -> dict[str, Any]:
        """Return the output for programs: plain numbers, lists and texts, without infinite
        values."""
        return {
            "verdict": self.verdict,
            "complete": self.complete,
            "causes": [_cause_json(cause) for cause in self.causes],
            "likely": [_cause_json(cause) for cause in self.likely],
            "look_alikes": [list(names) for names in self.look_alikes],
            "to_separate": self.to_separate,
            "signals": {name: _fields(s, *OF_SIGNAL) for name, s in self.signals.items()},
            "gain": {
                "held_out_log_likelihood": _plain(self.gain.held_out_log_likelihood),
                "interval": [_plain(x) for x in self.gain.interval],
                "worse": list(self.gain.worse),
                "recommended": self.recommended,
            },
            "duration_s": _plain(self.duration_s),
            "structure": [_fields(s, "signal", "kind", "size", "text") for s in self.structure],
            "candidates": [
                {
                    **_fields(c, "name", "outcome", "nats", "text"),
                    "parameter": c.key,
                    **_fields(c, "off", "std", "shows_from", "unit"),
                }
                for c in self.candidates
            ],
            "notes": list(self.notes),
        }


OF_SIGNAL = ("verdict", "rms_before", "rms_after", "rms_unseen", "slow_before", "slow_after",
             "noise_floor", "unit", "left")  # fmt: skip
OF_NUMBER = ("value", "std", "unit", "stated", "tolerance")


def _cause_json(cause: FoundCause) -> dict[str, Any]:
    return {
        **_fields(cause, "name", "certainty"),
        "parameters": {key: _fields(p, *OF_NUMBER) for key, p in cause.in_file.items()},
        "vehicle_axes": {key: _fields(p, *OF_NUMBER) for key, p in cause.along_vehicle.items()},
        "signals": list(cause.signals),
        "evidence": {name: _plain(x) for name, x in cause.evidence.items()},
        "text": cause.text,
        "against": list(cause.against),
    }


def _fields(of: object, *names: str) -> dict[str, Any]:
    """Return attributes by name. Texts are unchanged, numbers are as in JSON."""
    found = ((name, getattr(of, name)) for name in names)
    return {name: x if isinstance(x, str) else _plain(x) for name, x in found}


def _plain(x: float | None) -> float | None:
    return None if x is None or not math.isfinite(x) else round(float(x), 9)
