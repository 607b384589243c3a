"""Remove the terms that can be removed without the mount. The result is the sample of an error-free
sensor.

In one frame, the temperature is processed first, then the accelerometer, then the gyroscope (its
g-sensitivity needs the force). Columns follow the same rule by their order numbers. Single samples
and columns may be mixed, and their results are bit-equal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, Flags
from imucald.core.samples import (
    TEMPERATURE,
    TRIADS,
    VEHICLE_SIGNALS,
    Series,
    speed_of_wheels,
    speeds_of_wheels,
)
from imucald.model.section import Vector3
from imucald.model_compensation.compensator import Compensator
from imucald.model_compensation.filters import Smoothed
from imucald.model_compensation.held_repeats import HeldRepeats, Stage, held, through
from imucald.model_compensation.terms import ScalarTerms, Terms, TriadTerms

Order = NDArray[np.int64] | NDArray[np.float64]

Sample = tuple[str, Sequence[float]]

FELT_HZ = 5.0
"""Cut-off frequency of the low-pass filter on the force for the gyroscope's g-sensitivity [Hz]. The
two sensors sample at different times, so the vibration of the accelerometer must not affect the
gyroscope's samples."""
MIN_DEGC, MAX_DEGC = -60.0, 150.0
"""Range of valid temperatures [degC]. After an invalid temperature, the last valid temperature
stays in use."""
_FIRST = {TEMPERATURE.channel: 0, "accel": 1, "gyro": 2, "wheel_speeds": 3}
CHANNELS = (TEMPERATURE.channel, *TRIADS, "wheel_speeds", "speed", *VEHICLE_SIGNALS)
"""Channels that a term may change."""


@dataclass(frozen=True, eq=False)
class Taken:
    """Columns of one channel after compensation: values as in `samples`, and flags of the refused
    samples."""

    values: Array
    refused: Flags


class SensorCorrection:
    """Removes the known errors of each sensor from its samples.

    derived_speed: True if the speed is computed from the wheel speeds. The speed is then computed
    again from the corrected wheel speeds.
    """

    def __init__(self, terms: Terms, derived_speed: bool = False) -> None:
        self._terms = terms
        self._derived = derived_speed and any(terms.wheel_scales)
        triads = {"accel": terms.accel, "gyro": terms.gyro, "mag": terms.mag}
        self._sensitive = any(terms.g_sensitivity)
        self._felt = Smoothed(FELT_HZ)
        self._sensors = {
            channel: Compensator.of_triad(channel, t)
            for channel, t in triads.items()
            if t != TriadTerms() or (channel == "gyro" and self._sensitive)
        }
        self._sensors |= {
            channel: Compensator.of_scalar(channel, s)
            for channel, s in terms.scalars.items()
            if s != ScalarTerms() and not (channel == "speed" and derived_speed)
        }
        if any(terms.wheel_scales):
            self._sensors["wheel_speeds"] = Compensator.of_wheels(terms.wheel_scales)
        self._temperature_dependent = [s for s in self._sensors.values() if s.follows_temperature]
        # terms that change from sample to sample
        self._repeats = {
            channel: HeldRepeats()
            for channel, sensor in self._sensors.items()
            if sensor.follows_temperature or (channel == "gyro" and self._sensitive)
        }
        stages = {channel: self._stages(channel) for channel in CHANNELS}
        self._chains = {channel: chain for channel, chain in stages.items() if chain}

    def _stages(self, channel: str) -> list[Stage]:
        """Return the processing stages for each sample of a channel, in order; empty if there are
        none."""
        stages: list[Stage] = []
        if channel in self._sensors:
            stages.append(self._sensors[channel].sample)
        if channel == "gyro" and self._sensitive:
            stages.append(self._less_felt)
        if channel in self._repeats:
            stages = [held(self._repeats[channel], stages)]
        if channel == "accel" and self._sensitive:
            stages.append(self._feel)
        if channel == TEMPERATURE.channel and self._temperature_dependent:
            stages.append(self._temperature)
        return stages

    def gap(self) -> None:
        """Restart after a jump of time: state from earlier samples is deleted, except the
        temperature."""
        self._felt.restart()
        for repeats in self._repeats.values():
            repeats.restart()

    # one frame -----------------------------------------------------------------------------

    def frame(self, t: float, samples: list[Sample]) -> tuple[list[Sample], list[str]]:
        """Compensate the samples of one frame at stream time t [s]. Returns the samples, and the
        channels with a refused sample."""
        if len(samples) == 1:
            channel, values = samples[0]
            stages = self._chains.get(channel)
            if stages is None:
                return samples, []
            found = through(stages, t, values)
            return ([], [channel]) if found is None else ([(channel, found)], [])
        out: list[Sample] = []
        refused: list[str] = []
        wheels: Sequence[float] | None = None
        for channel, values in sorted(samples, key=lambda s: _FIRST.get(s[0], 9)):
            found = through(self._chains.get(channel, ()), t, values)
            if channel == "wheel_speeds":
                wheels = found
            elif channel == "speed" and self._derived:
                found = None if wheels is None else (speed_of_wheels(wheels),)
            if found is None:
                refused.append(channel)
            else:
                out.append((channel, found))
        return out, refused

    def _temperature(self, t: float, v: Sequence[float]) -> Sequence[float]:
        degc = v[0]
        if MIN_DEGC <= degc <= MAX_DEGC:
            for sensor in self._temperature_dependent:
                sensor.set_temperature(degc)
        return v

    def _feel(self, t: float, v: Sequence[float]) -> Sequence[float]:
        x, y, z = v
        self._felt.push(t, (x, y, z))
        return v

    def _less_felt(self, t: float, v: Sequence[float]) -> Sequence[float]:
        a, b, c = self._felt.value
        p, q, r = self._terms.g_sensitivity
        return v[0] - p * a, v[1] - q * b, v[2] - r * c

    # columns -------------------------------------------------------------------------------

    def columns(
        self, samples: Mapping[str, Series], order: Mapping[str, Order]
    ) -> dict[str, Taken]:
        """Compensate columns of samples. Returns the channels that are changed.

        order: by channel, the order of arrival of each sample, ascending. Samples with equal
        numbers came in one frame.
        """
        known, degc = self._temperatures(samples, order)
        out: dict[str, Taken] = {}
        for channel, sensor in self._sensors.items():
            if channel in samples:
                before = _before(order[channel], known)
                out[channel] = Taken(*sensor.columns(samples[channel].values, before, degc))
        self._repeat("accel", samples, out)
        if self._sensitive:
            self._take_felt(samples, order, out)
        self._repeat("gyro", samples, out)
        for sensor in self._temperature_dependent if len(degc) else ():
            sensor.set_temperature(float(degc[-1]))
        if self._derived and "speed" in samples and "wheel_speeds" in out:
            wheels = out["wheel_speeds"]
            out["speed"] = Taken(speeds_of_wheels(wheels.values), wheels.refused)
        return out

    def _repeat(self, channel: str, samples: Mapping[str, Series], out: dict[str, Taken]) -> None:
        if channel in self._repeats and channel in samples:
            taken, raw = out[channel], samples[channel].values
            found = self._repeats[channel].columns(raw, taken.values, taken.refused)
            out[channel] = Taken(*found)

    def _temperatures(
        self, samples: Mapping[str, Series], order: Mapping[str, Order]
    ) -> tuple[Order, Array]:
        """Return the order numbers and the values of the valid temperatures [degC]."""
        series = samples.get(TEMPERATURE.channel)
        if series is None or not self._temperature_dependent:
            return np.zeros(0), np.zeros(0)
        good = (series.values >= MIN_DEGC) & (series.values <= MAX_DEGC)
        return order[TEMPERATURE.channel][good], series.values[good]

    def _take_felt(
        self, samples: Mapping[str, Series], order: Mapping[str, Order], out: dict[str, Taken]
    ) -> None:
        """Remove the effect of the force on the gyroscope, at each sample of the gyroscope."""
        felt: list[Vector3] = [self._felt.value]
        before: Order = np.zeros(0)
        accel = samples.get("accel")
        if accel is not None:
            taken = out.get("accel")
            good = np.ones(len(accel.t), bool) if taken is None else ~taken.refused
            values = accel.values if taken is None else taken.values
            for t, v in zip(accel.t[good].tolist(), values[good].tolist(), strict=True):
                felt.append(self._felt.push(t, v))
            before = order["accel"][good]
        if "gyro" in samples:
            force = np.array(felt)[_before(order["gyro"], before)]
            gyro = out["gyro"]
            taken_off = np.array(self._terms.g_sensitivity) * force
            out["gyro"] = Taken(gyro.values - taken_off, gyro.refused)


def _before(order: Order, others: Order) -> NDArray[np.int64]:
    """Return, for each sample, the number of other samples that arrived before it or in the same
    frame."""
    return np.searchsorted(others, order, side="right").astype(np.int64)
