"""What a model file is worth while driving: its terms, ready to be taken out of signals."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from msgspec import structs

from imucald.config.vehicle import VehicleSettings
from imucald.core.samples import Samples, Series
from imucald.model.section import ZERO
from imucald.model_compensation.lever_arm_and_suspension import VehicleCorrection
from imucald.model_compensation.preprocessing import PreprocessingChain
from imucald.model_compensation.reading import read_terms
from imucald.model_compensation.sensors import SensorCorrection
from imucald.model_compensation.suspension import SuspensionFilter
from imucald.model_compensation.terms import Terms, TriadTerms, saved_text
from imucald.model_compensation.tick_preprocessing import TickPreprocessing
from imucald.model_compensation.time_alignment import TimeAlignment, alignment_shifts
from imucald.mount.estimator_settings import DelayPrior, EstimatorSettings
from imucald.mount.method_a.settings import PublishedSettings

KNOWN_DELAY_STD = 0.1
"""How well a model's delays are taken to be known [s]: where nobody looked, a default stands there.
The estimator then finds the rest; where there is none, so wide a prior costs nothing."""
STATED_DELAY_STD = 0.03
"""The same of a delay that the configuration states."""


@dataclass(frozen=True)
class ModelCompensation:
    """The terms of one model file. Immutable; what is made of it carries what changes.

    name: of the file. notes: what of it is not used, a line each. suspension: whether the body's
    roll and pitch on its springs are taken out of the corrected signals. speed_delay_std: how well
    the model's latency of speed is known [s].
    """

    terms: Terms
    name: str = "model"
    notes: tuple[str, ...] = ()
    suspension: bool = True
    speed_delay_std: float = KNOWN_DELAY_STD

    # reports ---------------------------------------------------------------------------------

    def notes_for(self, channels: Collection[str]) -> list[str]:
        """`notes`, and what cannot be used for want of a signal; channels: those there are."""
        found = list(self.notes)
        terms = self.terms
        for channel, triad in (("accel", terms.accel), ("gyro", terms.gyro)):
            if any(triad.bias_temperature) and "temperature" not in channels:
                found.append(
                    f"{channel}.bias_temperature: needs signals.temperature; without it, the "
                    "bias at 25 degC is used"
                )
        if any(terms.lever_arm) and "gyro" not in channels:
            found.append(
                "mount.lever_arm_m: needs signals.gyroscope; without it, its effect is "
                "not corrected"
            )
        if not terms.suspension.neutral and not self.suspension:
            found.append("suspension: not corrected, since compensate_suspension is off")
        return found

    def compensated(self, channels: Collection[str]) -> list[str]:
        """Names of the terms that are taken out; channels: those there are."""
        return [name for name, channel in self._active() if channel in channels]

    def _active(self) -> Iterator[tuple[str, str]]:
        """Term and the channel that it is taken out of."""
        terms, neutral = self.terms, TriadTerms()
        for channel, triad in (("accel", terms.accel), ("gyro", terms.gyro), ("mag", terms.mag)):
            if any(triad.bias):
                yield f"{channel}.bias", channel
            if any(triad.bias_temperature):
                yield f"{channel}.bias_temperature", "temperature"
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
        """Columns of samples less the terms that need no mount; refused ones are left out."""
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
        """The preprocessing of one engine.

        channels: those that its router can give. parallel_rates: the parallel gyroscopes.
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
        """The same where the configuration says how late speed is against the accelerometer [s]."""
        if delay is None:
            return self
        accel = self.terms.latency.get("accel", 0.0)
        latency = {**self.terms.latency, "accel": accel, "speed": accel + delay}
        terms = replace(self.terms, latency=latency)
        return replace(self, terms=terms, speed_delay_std=STATED_DELAY_STD)

    def sensor_correction(self, derived_speed: bool = False) -> SensorCorrection:
        """Takes out the terms that need no mount; derived_speed: the wheels give the speed."""
        return SensorCorrection(self.terms, derived_speed)

    def vehicle_correction(
        self, channels: Collection[str], rates: Collection[str] = ("gyro",)
    ) -> VehicleCorrection:
        """Takes out those that need it; rates: the channels that are angular rates."""
        terms = self.terms if "gyro" in channels else replace(self.terms, lever_arm=ZERO)
        return VehicleCorrection(terms, self.suspension, rates)

    def tick_preprocessing(self) -> TickPreprocessing | None:
        """What is done to ticks before the estimator sees them; None: nothing."""
        shifts, leans = self.shifts(), not self.terms.suspension.neutral
        if not shifts and not leans:
            return None
        return TickPreprocessing(
            TimeAlignment(shifts) if shifts else None,
            SuspensionFilter(self.terms.suspension) if leans else None,
        )

    def shifts(self) -> dict[str, float]:
        """How long each channel is held back from the estimator [s]; empty: none is."""
        return alignment_shifts(self.terms.latency)

    # settings of the estimators ---------------------------------------------------------------

    def full_settings(
        self, settings: EstimatorSettings, stated: Collection[str] = ()
    ) -> EstimatorSettings:
        """Settings with what the model knows; stated: keys of `vehicle` that the user gave."""
        terms, chassis = self.terms, self.terms.chassis
        delays = dict(settings.delays)
        for channel, std in (("speed", self.speed_delay_std), ("yaw_rate", KNOWN_DELAY_STD)):
            if channel in terms.latency:
                delays[channel] = DelayPrior(0.0, std)
        roads = (terms.bank_rms / settings.slope_std, terms.grade_rms / settings.slope_std)
        understeer = chassis.understeer
        return structs.replace(
            settings,
            vehicle=self._vehicle(settings.vehicle, stated),
            crown_mean=self._crown_mean(stated),
            delays=delays,
            lever_arm=terms.lever_arm,
            unevenness=(max(roads[0], 1.0), max(roads[1], 1.0)),
            understeer=settings.understeer if understeer is None else understeer,
        )

    def published_settings(
        self, settings: PublishedSettings, stated: Collection[str] = ()
    ) -> PublishedSettings:
        """The same for method A."""
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
        """The vehicle with the model's measures where the user gave none."""
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
        """Names what an estimate of the mount rests on: equal keys, equal estimates."""
        return hashlib.sha256(saved_text(self.terms).encode()).hexdigest()


def compensation_from_model(
    model: Path | str | Mapping[str, Any], compensate_suspension: bool = True
) -> ModelCompensation:
    """Read a model file, or a mapping of its content. Raises ConfigError with the place."""
    source = model if isinstance(model, Mapping) else Path(model)
    name = "model" if isinstance(model, Mapping) else str(model)
    terms, notes = read_terms(source, name)
    return ModelCompensation(terms, name, notes, compensate_suspension)
