"""What a cause is: physics that the forward model may lack, and the parameters that say how much.

A cause is one module in `imucald.diagnosis.causes` that holds a subclass of `Cause`; `catalogue()`
finds it. Its hooks change the `State` of the forward model at their stage; each hook gets the
cause's parameters with their *total* values, under the last part of their keys.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, ClassVar

from imucald.diagnosis.keys import with_values
from imucald.diagnosis.result import Estimated

if TYPE_CHECKING:
    from imucald.diagnosis.state import State
    from imucald.model.model import VehicleModel

Values = Mapping[str, float]
"""Parameter key to its total value."""


@dataclass(frozen=True)
class Parameter:
    """A number of the model that a cause may change.

    key: dotted key of the model file, with an index for lists (`accel.bias.0`), or a name of the
    cause's own that begins with `_` (such a number has no place in the model file).
    """

    key: str
    unit: str
    tolerance: float
    """Standard deviation by which a good model file may be wrong."""
    wide: float
    """Standard deviation when the cause is at work."""
    step: float
    """For the numerical derivative; small against what bends the response."""
    least: float | None = None
    most: float | None = None
    """Limits that the model file sets."""
    share: float = 0.05
    """Part of a fitted departure that the forward model cannot promise."""
    floor: float = 0.6
    """The same whatever the departure, in tolerances: what fits of drives without effect err by."""


@dataclass(frozen=True)
class Variant:
    """One form of a cause: the parameters that move together, for example one signal's delay."""

    cause: str
    label: str
    keys: tuple[str, ...]


class Cause:
    """Base of all causes. Subclasses set the class variables and override the hooks they need."""

    name: ClassVar[str]
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    signals: ClassVar[tuple[str, ...]] = ()
    """Signals that it touches; must exist for the cause to be a candidate (any of them)."""
    needs: ClassVar[tuple[str, ...]] = ()
    """Measured signals without which it cannot be seen."""
    seen_by: ClassVar[str] = ""
    """The manoeuvre that shows it: completes 'To see it, ...'."""
    sentence: ClassVar[str] = ""
    """What is said when it is found."""
    nuisance: ClassVar[bool] = False
    """Moves within its tolerance only and is never named."""

    def variants(self) -> Sequence[Variant]:
        """Forms of the cause that compete; default: all parameters together."""
        return (Variant(self.name, "", tuple(p.key for p in self.parameters)),)

    def inputs(self, s: State, p: Values) -> None:
        """Correct the measured inputs: speed, steering, yaw rate."""

    def motion(self, s: State, p: Values) -> None:
        """Add to the vehicle's motion."""

    def road(self, s: State, p: Values) -> None:
        """Add to the road's attitude."""

    def body(self, s: State, p: Values) -> None:
        """Lean the body on its springs."""

    def place(self, s: State, p: Values) -> None:
        """Carry the force to the sensor's place."""

    def mount(self, s: State, p: Values) -> None:
        """Turn the sensor in the vehicle."""

    def response(self, s: State, p: Values) -> None:
        """Delay and low-pass signals, in the frequency domain."""

    def gain(self, s: State, p: Values) -> None:
        """Scale signals."""

    def offset(self, s: State, p: Values) -> None:
        """Add to signals."""

    def extend(self, model: VehicleModel, p: Values, keys: Sequence[str]) -> VehicleModel:
        """Return the model file with the cause's fitted values; keys: those that moved."""
        return with_values(model, {key: p[key] for key in keys})

    def report(self, p: Values, std: Values, keys: Sequence[str]) -> dict[str, Estimated]:
        """Return the fitted parameters as they are told, by name."""
        units = {parameter.key: parameter.unit for parameter in self.parameters}
        return {key: Estimated(p[key], std[key], units[key]) for key in keys}


STAGES = ("inputs", "road", "motion", "body", "place", "mount", "response", "gain", "offset")


@cache
def catalogue() -> tuple[Cause, ...]:
    """Return one object of every cause in the folder, nuisances last, by name."""
    # The modules of the folder import this one.
    causes = importlib.import_module("imucald.diagnosis.causes")
    found: list[Cause] = []
    for module in pkgutil.iter_modules(causes.__path__):
        loaded = importlib.import_module(f"{causes.__name__}.{module.name}")
        found += [
            item()
            for item in vars(loaded).values()
            if isinstance(item, type)
            and issubclass(item, Cause)
            and item.__module__ == loaded.__name__
            and hasattr(item, "name")
        ]
    return tuple(sorted(found, key=lambda cause: (cause.nuisance, cause.name)))
