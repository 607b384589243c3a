"""The terms of a model file, ready for removal from signals while driving."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from msgspec import structs

from imucald.config.vehicle import VehicleSettings
from imucald.core.samples import TEMPERATURE, Samples, Series
from imucald.drive.roads import SLOPE
from imucald.model.section import ZERO
from imucald.model_compensation.filters import SuspensionFilter
from imucald.model_compensation.lever_arm_and_suspension import VehicleCorrection
from imucald.model_compensation.preprocessing import PreprocessingChain
from imucald.model_compensation.reading import read_terms
from imucald.model_compensation.sensors import SensorCorrection
from imucald.model_compensation.terms import Terms, TriadTerms, saved_text
from imucald.model_compensation.tick_preprocessing import (
    TickPreprocessing,
    TimeAlignment,
    alignment_shifts,
)
from imucald.mount.estimator_settings import DelayPrior, EstimatorSettings
from imucald.mount.method_a.settings import PublishedSettings

KNOWN_DELAY_STD = 0.1
"""Assumed standard deviation of the delays in a model file [s]. A delay may be a default that
nobody checked. The estimator then finds the remaining delay. If there is no remaining delay, such a
wide prior has no effect."""
STATED_DELAY_STD = 0.03
"""Assumed standard deviation of a delay that the configuration states [s]."""


@dataclass(frozen=True)
class ModelCompensation:
    """The terms of one model file. The object is immutable. The objects that this object makes
    contain the changing state.

    name: name of the model file. notes: one line for each part of the file that is not used.
    suspension: True if the body's roll and pitch on its springs are removed from the corrected
    signals. speed_delay_std: standard deviation of the model's speed delay [s].
    """

    terms: Terms
    name: str = "model"
    notes: tuple[str, ...] = ()
    suspension: bool = True
    speed_delay_std: float = KNOWN_DELAY_STD

    # reports ---------------------------------------------------------------------------------

    def notes_for(self, channels: Collection[str]) -> list[str]:
        """Return `notes`, and one line for each term that cannot be used because a signal is
        missing. channels: available channels."""
        found = list(self.notes)
        terms = self.terms
        for channel, triad in (("accel", terms.accel), ("gyro", terms.gyro)):
            if any(triad.bias_temperature) and TEMPERATURE.channel not in channels:
                found.append(
                    f"{channel}.bias_temperature: needs signals.{TEMPERATURE.key}; without it, the "
                    "bias at 25 degC is used"
                )
        if any(terms.lever_arm) and "gyro" not in channels:
            found.append(
                "mount.lever_arm_m: needs signals.gyroscope; without it, the effect "
                "of the lever arm is not corrected"
            )
        if not terms.suspension.neutral and not self.suspension:
            found.append("suspension: not corrected, since compensate_suspension is off")
        return found

    def compensated(self, channels: Collection[str]) -> list[str]:
        """Return the names of the terms that are removed. channels: available channels."""
        return [name for name, channel in self._active() if channel in channels]

    def _active(self) -> Iterator[tuple[str, str]]:
        """Yield each active term, and the channel from which it is removed."""
        terms, neutral = self.terms, TriadTerms()
        for channel, triad in (("accel", terms.accel), ("gyro", terms.gyro), ("mag", terms.mag)):
            if any(triad.bias):
                yield f"{channel}.bias", channel
            if any(triad.bias_temperature):
                yield f"{channel}.bias_temperature", TEMPERATURE.channel
            if triad.inverse != neutral.inverse:
                yield f"{channel}.scale, {channel}.cross_axis", channel
        if any(terms.g_sensitivity):
            yield "gyro.g_sensitivity", "gyro"
        if any(terms.wheel_scales):
            yield "wheel_speeds.scale", "wheel_speeds"
        for channel, scalar in terms.scalars.items():
            if scalar.scale:
                yield f"{channel}.scale", channel
            if scalar.offset:
                yield f"{channel}.offset", channel
        if any(terms.lever_arm):
            yield "mount.lever_arm_m", "gyro"
        if self.suspension and not terms.suspension.neutral:
            yield "suspension", "accel"
        if self.shifts():
            yield "delays (for the mount)", "accel"

    # what is made of it ----------------------------------------------------------------------

    def samples(self, samples: Samples) -> Samples:
        """Return columns of samples without the terms that can be removed without the mount.
        Refused samples are left out."""
        order = {channel: series.t for channel, series in samples.items()}
        taken = self.sensor_correction().columns(samples, order)
        out = dict(samples)
        for channel, one in taken.items():
            good = ~one.refused
            out[channel] = Series(samples[channel].t[good], one.values[good])
        return out

    def preprocessing_chain(
        self, channels: Collection[str], derived_speed: bool, parallel_rates: Collection[str] = ()
    ) -> PreprocessingChain:
        """Return the preprocessing of one engine.

        channels: channels that the router can deliver. parallel_rates: the parallel gyroscopes.
        """
        vehicle = self.vehicle_correction(channels, ("gyro", *parallel_rates))
        return PreprocessingChain(
            self.name,
            self.estimate_key,
            self.sensor_correction(derived_speed),
            None if vehicle.neutral else vehicle,
            self.tick_preprocessing(),
            tuple(self.compensated(channels)),
            tuple(self.notes_for(channels)),
        )

    def with_speed_delay(self, delay: float | None) -> ModelCompensation:
        """Return a copy with a stated delay of the speed against the accelerometer [s]. The
        configuration states this delay."""
        if delay is None:
            return self
        accel = self.terms.latency.get("accel", 0.0)
        latency = {**self.terms.latency, "accel": accel, "speed": accel + delay}
        terms = replace(self.terms, latency=latency)
        return replace(self, terms=terms, speed_delay_std=STATED_DELAY_STD)

    def sensor_correction(self, derived_speed: bool = False) -> SensorCorrection:
        """Return the correction of the terms that can be removed without the mount. derived_speed:
        the speed is computed from the wheel speeds."""
        return SensorCorrection(self.terms, derived_speed)

    def vehicle_correction(
        self, channels: Collection[str], rates: Collection[str] = ("gyro",)
    ) -> VehicleCorrection:
        """Return the correction of the terms that need the mount. rates: channels that are angular
        rates."""
        terms = self.terms if "gyro" in channels else replace(self.terms, lever_arm=ZERO)
        return VehicleCorrection(terms, self.suspension, rates)

    def tick_preprocessing(self) -> TickPreprocessing | None:
        """Return the preprocessing of the ticks for the estimator; None if no preprocessing is
        needed."""
        shifts, leans = self.shifts(), not self.terms.suspension.neutral
        if not shifts and not leans:
            return None
        return TickPreprocessing(
            TimeAlignment(shifts) if shifts else None,
            SuspensionFilter(self.terms.suspension) if leans else None,
        )

    def shifts(self) -> dict[str, float]:
        """Return the time by which each channel is delayed for the estimator [s]; empty if no
        channel is delayed."""
        return alignment_shifts(self.terms.latency)

    # settings of the estimators ---------------------------------------------------------------

    def joint_settings(
        self, settings: EstimatorSettings, stated: Collection[str] = ()
    ) -> EstimatorSettings:
        """Return the settings of the joint estimator with the values of the model file. stated:
        keys of `vehicle` that the user gave."""
        terms, chassis = self.terms, self.terms.chassis
        delays = dict(settings.delays)
        for channel, std in (("speed", self.speed_delay_std), ("yaw_rate", KNOWN_DELAY_STD)):
            if channel in terms.latency:
                delays[channel] = DelayPrior(0.0, std)
        understeer = chassis.understeer
        return structs.replace(
            settings,
            vehicle=self._vehicle(settings.vehicle, stated),
            crown_mean=self._crown_mean(stated),
            delays=delays,
            lever_arm=terms.lever_arm,
            slope=max(SLOPE, terms.bank_rms, terms.grade_rms),
            understeer=settings.understeer if understeer is None else understeer,
        )

    def published_settings(
        self, settings: PublishedSettings, stated: Collection[str] = ()
    ) -> PublishedSettings:
        """Return the settings of method A with the values of the model file. stated: keys of
        `vehicle` that the user gave."""
        calibration = settings.calibration
        if "speed" in self.terms.latency:
            calibration = structs.replace(calibration, speed_delay=0.0)
        return structs.replace(
            settings,
            calibration=calibration,
            vehicle=self._vehicle(settings.vehicle, stated),
            crown_mean=self._crown_mean(stated),
        )

    def _vehicle(self, vehicle: VehicleSettings, stated: Collection[str]) -> VehicleSettings:
        """Return the vehicle settings with the dimensions of the model file. A dimension that the
        user gave is kept."""
        known = {
            key: value
            for key in ("wheelbase", "track", "steering_ratio")
            if (value := getattr(self.terms.chassis, key)) is not None and key not in stated
        }
        return structs.replace(vehicle, **known)

    def _crown_mean(self, stated: Collection[str]) -> float | None:
        return None if "crown_percent" in stated else self.terms.crown_mean

    @property
    def estimate_key(self) -> str:
        """Key of all values that affect an estimate of the mount. Equal keys give equal
        estimates."""
        return hashlib.sha256(saved_text(self.terms).encode()).hexdigest()


def compensation_from_model(
    model: Path | str | Mapping[str, Any], compensate_suspension: bool = True
) -> ModelCompensation:
    """Read a model file, or a mapping with its content. Raises ConfigError with the place of a
    mistake."""
    source = model if isinstance(model, Mapping) else Path(model)
    name = "model" if isinstance(model, Mapping) else str(model)
    terms, notes = read_terms(source, name)
    return ModelCompensation(terms, name, notes, compensate_suspension)
