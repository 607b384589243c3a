"""Direct evidence before any fit: the gyroscope's zero error at stops.

A fit that contradicts the zero error at stops is wrong, so the zero error at stops limits the fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from imucald.core.angles import RAD_PER_DEG as DEG
from imucald.core.arrays import Array
from imucald.diagnosis.cause_keys import sensor_of, tolerance
from imucald.diagnosis.signals import CHANCE, DriveSignals
from imucald.model.model import VehicleModel
from imucald.model.sensors import REFERENCE_DEGC
from imucald.simulation.imu import mounts

LEAST_SE = 0.04 * DEG
"""Accuracy of the zero error from one or two stops [rad/s]. Between the stops of one measured
drive, the zero error differs by 0.03 deg/s."""


@dataclass(frozen=True)
class Rest:
    """Zero error of the gyroscope relative to the model file, along the vehicle's axes, (3,)."""

    rate: Array
    """Mean over the stops [rad/s]."""
    se: Array
    quantile: float
    stops: int
    kelvin: float = 0.0
    """Mean temperature of the stops minus the temperature at which the zero error of the model file
    is valid [K]."""

    def allowed(self, model: VehicleModel) -> Array:
        """Return the error (3,) that a correct model file may have at these stops [rad/s]. The
        error is the tolerance of the zero error, plus the tolerance of its temperature slope times
        the temperature difference."""
        return _tolerances(model, "gyro.bias") + self._by_temperature(model)

    def _by_temperature(self, model: VehicleModel) -> Array:
        return _tolerances(model, "gyro.bias_temperature") * abs(self.kelvin)

    def bounds(self, model: VehicleModel) -> dict[str, tuple[float, float]]:
        """Return limits of the zero error for the fit [rad/s]. The limits are the interval of the
        zero error at stops, widened by the tolerance of its temperature slope times the temperature
        difference."""
        half = self.quantile * self.se + self._by_temperature(model)
        return {
            f"gyro.bias.{axis}": (float(x - h), float(x + h))
            for axis, x, h in zip("xyz", self.rate, half, strict=True)
        }


def _tolerances(model: VehicleModel, key: str) -> Array:
    return np.array([tolerance(model, f"{key}.{axis}") for axis in "xyz"])


def rest_of(drives: Sequence[DriveSignals], model: VehicleModel, questions: int) -> Rest | None:
    """Return the zero error from the means over all stops; None without a gyroscope or a stop."""
    rates, kelvins = [], []
    sensor = sensor_of(model, "gyro", {})
    inverse = np.linalg.inv(sensor.gain)
    for drive in drives:
        for stop in drive.stops:
            middle = 0.5 * (stop.start_s + stop.stop_s)
            R = [R for start, R in mounts(model.mount) if start <= middle][-1]
            kelvin = 0.0
            if drive.has("temperature"):
                warm = drive.channels["temperature"].means(np.array([middle]))[0]
                kelvin = float(warm) - REFERENCE_DEGC
            raw = stop.gyro - sensor.bias - sensor.per_kelvin * kelvin
            raw = raw - sensor.per_force * stop.accel
            rates.append(R @ inverse @ raw)
            kelvins.append(kelvin)
    if not rates:
        return None
    table, n = np.array(rates), len(rates)
    mean = table.mean(axis=0)
    scatter = np.std(table, axis=0, ddof=1) / np.sqrt(n) if n > 1 else np.zeros(3)
    if n < 3:
        # If two stops differ by more than the accuracy of one stop, they have no common zero.
        return Rest(mean, np.maximum(scatter, LEAST_SE), 3.0, n, float(np.mean(kelvins)))
    se = np.maximum(scatter, 0.004 * DEG)
    q = float(student.ppf(1.0 - CHANCE / (2.0 * max(questions, 1)), n - 1))
    return Rest(mean, se, min(q, 10.0), n, float(np.mean(kelvins)))
