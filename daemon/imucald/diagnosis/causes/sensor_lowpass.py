"""A signal with less bandwidth than the model file says."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucald.diagnosis.cause import Cause, Parameter, Values, Variant
from imucald.diagnosis.state import State
from imucald.simulation.model import Model

NAMES = ("accel", "gyro", "yaw_rate")
MOST_GAIN = 4.0
"""An input's low-pass is undone up to this gain: beyond it there is only noise."""


class SensorLowpass(Cause):
    """Second-order Butterworth low-pass; the parameter is 1/cut-off, added to the model's."""

    name = "sensor_lowpass"
    parameters = tuple(
        Parameter(f"_lowpass.{name}", "s", 0.005, 0.8, 0.002, 0.0, 4.0, f"{name}.lowpass_hz")
        for name in NAMES
    )
    signals = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "yaw_rate")
    seen_by = "brake and steer abruptly several times"
    sentence = "A signal is smoothed more than the model's."

    def variants(self) -> Sequence[Variant]:
        """One signal at a time."""
        return [Variant(self.name, name, (f"_lowpass.{name}",)) for name in NAMES]

    def inputs(self, s: State, p: Values) -> None:
        """Undo the low-pass of the measured yaw rate, within reason."""
        if s.yaw_in is not None:
            response = s.spectrum.butterworth(self._cutoff(s.model, "yaw_rate", p))
            # Wiener-like inverse: 1/H where H is large, bounded where it is small.
            inverse = np.conj(response) / np.maximum(np.abs(response) ** 2, MOST_GAIN**-2)
            s.yaw_in = s.spectrum.apply(s.yaw_in, inverse)
        elif s.gyro_in is not None:
            response = s.spectrum.butterworth(self._cutoff(s.model, "gyro", p))
            inverse = np.conj(response) / np.maximum(np.abs(response) ** 2, MOST_GAIN**-2)
            s.gyro_in = s.spectrum.apply(s.gyro_in, inverse)

    def response(self, s: State, p: Values) -> None:
        """Low-pass what is predicted."""
        for name in (*NAMES, "lateral_accel", "longitudinal_accel"):
            cutoff = self._cutoff(s.model, name, p)
            if cutoff < 1e3:
                s.filtered(name, s.spectrum.butterworth(cutoff))

    def extend(self, model: Model, p: Values) -> Model:
        """Return the model with the lower cut-offs."""
        changes = {
            f"{name}.lowpass_hz": self._cutoff(model, name, p)
            for name in NAMES
            if p[f"_lowpass.{name}"] > 0.0
        }
        return model.with_changes(changes) if changes else model

    @staticmethod
    def _cutoff(model: Model, name: str, p: Values) -> float:
        declared = getattr(model, name).lowpass_hz
        more = max(p.get(f"_lowpass.{name}", 0.0), 0.0)
        inverse = (0.0 if declared is None else 1.0 / declared) + more
        return 1.0 / max(inverse, 1e-6)
