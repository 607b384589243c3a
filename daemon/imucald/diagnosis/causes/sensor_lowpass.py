"""A signal with less bandwidth than the model file says."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from imucald.diagnosis.cause import Cause, Parameter, Values, Variant
from imucald.diagnosis.forward_mount import mount_of
from imucald.diagnosis.grid import Track
from imucald.diagnosis.result import Estimated
from imucald.diagnosis.state import Response, State
from imucald.model.model import VehicleModel

NAMES = ("accel", "gyro", "yaw_rate")
MOST_GAIN = 4.0
"""An input's low-pass is undone up to this gain: beyond it there is only noise."""

SHAKEN: Mapping[str, float] = {"accel": 8.0, "gyro": 0.15}
"""No vehicle vibrates more [m/s^2, rad/s rms]."""
SHAKEN_HZ = 8.0
"""Where vibration above the grid's band is taken to lie."""
LEAST_HZ = 3.0 * SHAKEN_HZ
"""Of a slower sensor the change from sample to sample is the motion itself."""
NOISE_SPREAD = 1.3
"""Levels of a sensor's own noise spread by less."""


def is_possible(track: Track, values: Values) -> bool:
    """Whether low-passes as deep as these could have let the vibration through that was measured.

    What is more while driving than at the quietest has come through the low-pass.
    """
    for name, most in SHAKEN.items():
        more = values.get(f"_lowpass.{name}", 0.0)
        if more <= 0.0 or track.rates_hz.get(name, 0.0) < LEAST_HZ:
            continue
        quiet, loud = np.percentile(track.level[name], [10.0, 90.0])
        passed = 1.0 / (1.0 + (SHAKEN_HZ * more) ** 2)
        is_shaken = loud > NOISE_SPREAD * quiet
        if is_shaken and math.sqrt(loud**2 - quiet**2) > most * passed:
            return False
    return True


class SensorLowpass(Cause):
    """Second-order Butterworth low-pass; the parameter is 1/cut-off, added to the model's."""

    name = "sensor_lowpass"
    parameters = tuple(
        Parameter(f"_lowpass.{name}", "s", 0.012, 0.8, 0.002, 0.0, 4.0) for name in NAMES
    )
    signals = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z", "yaw_rate")
    seen_by = "brake and steer abruptly several times"
    sentence = "A signal is smoothed more than the model's."

    def variants(self) -> Sequence[Variant]:
        """One signal at a time."""
        return [Variant(self.name, name, (f"_lowpass.{name}",)) for name in NAMES]

    def inputs(self, s: State, p: Values) -> None:
        """Give the inputs back what their low-pass took, by a bounded inverse.

        The yaw rate gets it from the gyroscope where there is one: with y = H r measured,
        r = y + (1 - H) r, and the gyroscope stands for r in the second term.
        """
        measured = s.gyro_in
        if measured is not None:
            response = s.spectrum.butterworth(self._cutoff(s.model, "gyro", p))
            s.gyro_in = s.spectrum.apply(measured, _inverse(response))
        if s.yaw_in is None:
            return
        response = s.spectrum.butterworth(self._cutoff(s.model, "yaw_rate", p))
        if measured is not None:
            # As measured: through an inverse its noise would go into what predicts it.
            turning = mount_of(s.model)[2] @ measured
            s.yaw_in = s.yaw_in + s.spectrum.apply(turning, 1.0 - response)
        else:
            s.yaw_in = s.spectrum.apply(s.yaw_in, _inverse(response))

    def response(self, s: State, p: Values) -> None:
        """Low-pass what is predicted."""
        for name in (*NAMES, "lateral_accel", "longitudinal_accel"):
            cutoff = self._cutoff(s.model, name, p)
            if cutoff < 1e3:
                s.filtered(name, s.spectrum.butterworth(cutoff))

    def extend(self, model: VehicleModel, p: Values, keys: Sequence[str]) -> VehicleModel:
        """Return the model with the lower cut-offs."""
        names = [key.removeprefix("_lowpass.") for key in keys]
        return model.with_changes(
            {f"{name}.lowpass_hz": self._cutoff(model, name, p) for name in names}
        )

    def report(self, p: Values, std: Values, keys: Sequence[str]) -> dict[str, Estimated]:
        """Return the cut-offs; their spread is that of the parameter, the cut-off's inverse."""
        told = {}
        for key in keys:
            cutoff = 1.0 / max(p[key] + 1.0 / 40.0, 1e-3)
            told[f"{key.removeprefix('_lowpass.')}.lowpass_hz"] = Estimated(
                cutoff, std[key] * cutoff**2, "Hz"
            )
        return told

    @staticmethod
    def _cutoff(model: VehicleModel, name: str, p: Values) -> float:
        declared = getattr(model, name).lowpass_hz
        more = max(p.get(f"_lowpass.{name}", 0.0), 0.0)
        inverse = (0.0 if declared is None else 1.0 / declared) + more
        return 1.0 / max(inverse, 1e-6)


def _inverse(response: Response) -> Response:
    """1/H where H is large, bounded where it is small (as a Wiener filter)."""
    inverse: Response = np.conj(response) / np.maximum(np.abs(response) ** 2, MOST_GAIN**-2)
    return inverse
