"""What a diagnosis says: verdict, causes, look-alikes, gain, and the pictures' numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
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
    """What the model file says."""
    tolerance: float = 0.0
    """By how much a correct model file may be wrong."""


@dataclass(frozen=True)
class FoundCause:
    """A cause that the measured drives show."""

    name: str
    parameters: Mapping[str, Estimated]
    signals: tuple[str, ...]
    """The signals that it touches, as in `Diagnosis.signals`."""
    evidence: Mapping[str, float]
    """`held_out_nats`: by how much likelier it makes data that its fit did not see, without the
    best segments; `sigma`: departure in units of its standard deviation; `quantile`: how many of
    these the interval has on each side."""
    text: str
    """One sentence for a person."""
    certainty: Certainty = "certain"
    against: tuple[str, ...] = ()
    """What speaks against it, in sentences."""
    along_sensor: Mapping[str, Estimated] = field(default_factory=dict)
    """Vectors of `parameters` along the sensor's axes, as the model file has them: by the file's
    key and the number of the axis."""

    @property
    def in_file(self) -> dict[str, Estimated]:
        """By the file's own key."""
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
"""Why a cause that is large enough is not named."""


@dataclass(frozen=True)
class Candidate:
    """A cause that was not named."""

    name: str
    outcome: Outcome
    nats: float
    """By which it makes data that its fit did not see likelier, without the best segments."""
    text: str
    """Its value, and the size that these drives could have shown."""
    parameters: Mapping[str, Estimated] = field(default_factory=dict)
    """What each of its parameters would be, freed by itself."""
    key: str = ""
    """The parameter that is furthest off."""
    off: float = math.nan
    """By how much, in `unit`; likewise the next two."""
    std: float = math.nan
    shows_from: float = math.nan
    """Size from which these drives would have shown it."""
    unit: str = ""


@dataclass(frozen=True)
class SignalGain:
    """Residual of one measured signal, rms in `unit`; *after* is the written file alone."""

    rms_before: float
    rms_after: float
    noise_floor: float
    """What a fit of everything that the catalogue has would leave."""
    unit: str
    slow_before: float = math.nan
    """The same below 0.2 Hz."""
    slow_after: float = math.nan
    left: str = ""
    """What is left, in words: an offset, a drift."""
    rms_unseen: float = math.nan
    """*After* of each segment by parameters that were found without it."""
    verdict: Verdict = "nothing"
    """What is said of this signal alone."""


@dataclass(frozen=True)
class Gain:
    """What the extended model is worth on data that its fit did not use."""

    held_out_log_likelihood: float
    """Nats by which the held-out segments are likelier with the written file alone."""
    interval: tuple[float, float]
    """95 % interval of that, over whole segments."""
    worse: tuple[str, ...] = ()
    """Signals that the extended model predicts worse."""
    was_fitted: bool = True
    """False where nothing was fitted: what was read directly changes no prediction by itself."""


GOES_AGAINST = "goes against the model"
"""Kind of structure where a signal moves against what is predicted."""
TOO_MUCH = "too much is left"
"""Kind where more is left than any measured car leaves: then no fit is believed."""
GOES_WITH_LEVEL = "goes with its own signal"
"""Kind where what is left depends on a signal's level, direction or past."""
GOES_WITH_ANOTHER = "goes with another signal"
"""Kind where what a signal shows too much depends on another."""
TURNS_WITH_WHEEL = "turns with the wheel"
"""Kind where what is left swings with the way travelled, once or twice a turn of a wheel."""
GOES_WITH_SHAKING = "goes with shaking"
"""Kind where what is left depends on how much the sensor is shaken."""
VALUE_HELD = "a value is held"
"""Kind where a sensor shows one value far oftener than those next to it."""
READINGS_LOST = "readings are lost"
"""Kind where a sensor jumps to one value and back: those readings are none, and are not used."""
WANDERS = "wanders"
"""Kind where a zero, a gain or a delay is another from piece to piece of a drive."""
DIFFERS = "differs by condition"
"""Kind where it is another when the vehicle is driven otherwise."""
UNEVEN = "some segments leave more"
"""Kind where some segments leave what neither their noise nor a correct file leaves."""
LOUDER = "more is left than the file states"
"""Kind where more is left than the drives left that the model file was made of."""
COARSER = "coarser than the file states"
"""Kind where a signal's values lie further apart than in the drives that the file was made of."""
VALUES_MISSING = "values are missing"
"""Kind where a signal never shows a range that it passes through."""
CHANGES_MISSING = "small changes are missing"
"""Kind where a signal stays, and then changes by much."""
JUMPS_ALONE = "single values jump"
"""Kind where a signal jumps again and again, and changes by little before and after."""
CHANGES_OTHERWISE = "changes by another amount than the file states"
"""Kind where a sensor changes from sample to sample by more or less than in the file's drives."""
FOLLOWS_OTHERWISE = "samples follow each other in another way"
"""Kind where samples repeat, lie on lines or have tails otherwise than in the file's drives."""
NOT_PLAUSIBLE = "not plausible"
"""Kind where a cause explains the numbers, but cannot be: a cause is missing."""


@dataclass(frozen=True)
class Structure:
    """Something left in a residual that no candidate explains."""

    signal: str
    kind: str
    """Such as "peak", "shared motion", "not plausible"."""
    size: float
    """In standard deviations of chance, or as a ratio to what is expected or may be."""
    text: str
    parameter: str = ""
    """The zero or gain that is not the same all along, where it is one."""


@dataclass(frozen=True)
class SignalPicture:
    """Numbers to draw for one signal; arrays (N,) on `t` unless stated otherwise."""

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
    likely: tuple[FoundCause, ...] = ()
    """Causes that are likely, and not written into the model file."""
    candidates: tuple[Candidate, ...] = ()
    structure: tuple[Structure, ...] = ()
    notes: tuple[str, ...] = ()
    """What the person should know: signals absent, drives too short, segments left out."""
    pictures: tuple[SignalPicture, ...] = ()
    model_before: VehicleModel = field(default_factory=VehicleModel)
    model_after: VehicleModel = field(default_factory=VehicleModel)
    recommended: bool = False
    """The extended model predicts held-out data better, and no signal worse."""
    complete: bool = True
    """False where the time limit ended the search."""

    def as_json(self) -> dict[str, Any]:
        """Return what tools rely on: plain numbers, lists and texts; nothing infinite."""
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
    """Texts as they are, numbers as JSON has them."""
    found = ((name, getattr(of, name)) for name in names)
    return {name: x if isinstance(x, str) else _plain(x) for name, x in found}


def _plain(x: float | None) -> float | None:
    return None if x is None or not math.isfinite(x) else round(float(x), 9)
