"""The existing consumers: attitude and direction of travel. A consumer is created if the
configuration enables it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from msgspec import structs

from imucald.attitude.compensated import CompensatedAttitude
from imucald.attitude.estimate import SETTLED_STD, AttitudeEstimate, AttitudeState
from imucald.attitude.filter import AttitudeFilter
from imucald.attitude.sensor_check import CheckResult
from imucald.config import Config, LoadedConfig
from imucald.config.attitude import AttitudeSettings
from imucald.core.rotations import Vector, matrix_times
from imucald.motion.physical_limits import is_plausible
from imucald.motion.ticks import TICK_RATE
from imucald.mount.estimate import Correction, MountEstimate, MountState
from imucald.mount.hysteresis import BAD, GOOD
from imucald.runtime.consumer import ORDER, Consumer
from imucald.runtime.output.attitude_frames import AttitudeFrames
from imucald.runtime.output.output_frames import OutputFrames
from imucald.runtime.output.output_message import OutFrame
from imucald.runtime.output.travel_frames import TravelFrames
from imucald.travel_direction.direction import TravelDirection


def consumers_for(
    loaded: LoadedConfig, output: OutputFrames, gyro_step: float = 0.0
) -> list[Consumer]:
    """Return the consumers that a configuration switches on.

    Raises ConfigError if an input is missing.

    gyro_step: resolution of the gyroscope's signals [rad/s]; 0 if it is not known.
    """
    config = loaded.config
    signals = config.signals
    found: list[Consumer] = []
    for key, frames in (("attitude", output.attitude), ("travel_direction", output.travel)):
        if frames is not None and any(triad.z is None for triad in signals.accelerometer):
            raise loaded.error((key, "enabled"), "needs all three axes of the accelerometer")
    if output.attitude is not None:
        place = ("attitude", "enabled")
        if signals.gyroscope is None:
            raise loaded.error(place, "needs signals.gyroscope")
        is_filter = (
            config.attitude.method == "filter"
        )  # else heading is not read; `check` reports it
        source = config.attitude.filter.heading if is_filter else "free"
        if source == "signal" and signals.heading is None:
            raise loaded.error(("attitude", "filter", "heading"), "needs signals.heading")
        if source == "magnetometer" and signals.magnetometer is None:
            raise loaded.error(("attitude", "filter", "heading"), "needs signals.magnetometer")
        found.append(AttitudeConsumer(config, output.attitude, gyro_step))
    if output.travel is not None:
        if signals.magnetometer is None and signals.heading is None:
            raise loaded.error(
                ("travel_direction", "enabled"), "needs signals.magnetometer or signals.heading"
            )
        found.append(TravelConsumer(config, output.travel))
    return found


_SERVED = GOOD | {MountState.RESTORED}
"""States of the mount in which an attitude is available. With a restored mount, the state of the
attitude is at most *settling*.
"""


class AttitudeConsumer:
    """Computes the attitude of the vehicle from corrected samples (methods B and C)."""

    name = "attitude"
    channels = frozenset(ORDER)

    def __init__(self, config: Config, frames: AttitudeFrames, gyro_step: float = 0.0) -> None:
        self._settings = _with_step(config.attitude, gyro_step)
        self.filter = self._new_filter()
        self._frames = frames
        self._every = round(TICK_RATE / config.attitude.rate)
        self._correction: Correction | None = None
        self._saved_check: CheckResult | None = None
        self._mount_std: tuple[float, float, float] | None = None
        self._mount_state = MountState.WAITING
        self.rejected = 0
        """Number of samples that were not used because their values are impossible."""

    def sample(
        self, t: float, channel: str, values: Sequence[float], correction: Correction | None
    ) -> None:
        """Process a sample. Samples of the calibrated sensor are first converted to vehicle
        axes."""
        if not is_plausible(channel, values):
            self.rejected += 1
            return
        if correction is not self._correction and correction != self._correction:
            self._turn(correction)
        if channel == "speed":
            self.filter.speed(t, values[0])
        elif channel == "reverse":
            self.filter.reverse(values[0] > 0.5)
        elif channel == "heading":
            self.filter.heading(t, values[0])
        elif correction is not None:
            turned = correction.applied(channel, values)
            if channel == "gyro":
                self.filter.gyro(t, turned)
            elif channel == "accel":
                self.filter.accel(t, turned)
            else:
                self.filter.mag(t, turned)

    def _new_filter(self) -> CompensatedAttitude | AttitudeFilter:
        s = self._settings
        return CompensatedAttitude(s) if s.method == "compensation" else AttitudeFilter(s)

    def _turn(self, correction: Correction | None) -> None:
        if correction is None:
            self._saved_check = self._sensed_check()  # valid for any later correction
            self.filter.reset()
        elif self._correction is not None:
            self.filter.turned(self._correction.rotation, correction.rotation)
            self.filter.take_zeros_off(*_offsets_changed(self._correction, correction))
        elif self._saved_check is not None:
            self.filter.restore_check(_as_corrected(self._saved_check, correction))
            self._saved_check = None
        self._correction = correction

    def check_sensors(self) -> None:
        """Repeat the sensor check at the next standstill that is long enough."""
        self._saved_check = None
        self.filter.check_again()

    @property
    def checked(self) -> bool:
        """True if the sensor check has been completed, in this drive or in an earlier drive."""
        return self.filter.checked

    def saved_check(self) -> Mapping[str, Any] | None:
        """Return the result of the sensor check for the saved state (sensor axes, SI); None before
        the check.
        """
        kept = self._sensed_check()
        return None if kept is None else kept.as_saved()

    def _sensed_check(self) -> CheckResult | None:
        """Return the result of the sensor check in sensor axes."""
        found = self.filter.check
        if found is None or self._correction is None:
            return self._saved_check
        return _as_sensed(found, self._correction)

    def restore_check(self, saved: object) -> None:
        """Store the result of a sensor check of an earlier drive, as `saved_check` gave it. The
        result is applied as soon as a mount is known."""
        self._saved_check = CheckResult.from_saved(saved)

    def mounted(self, estimate: MountEstimate) -> None:
        """Store the standard deviations of the mount's angles. These deviations are part of the
        uncertainty of the attitude. When a doubted mount is good again, the attitude restarts in
        the new axes.
        """
        if self._mount_state in BAD and estimate.state not in BAD:
            self.begin_anew()
        self._mount_std, self._mount_state = estimate.std, estimate.state

    def tick(self, k: int) -> list[OutFrame]:
        """Return the attitude frames if they are due at the end of tick k."""
        if (k + 1) % self._every:
            return []
        known = self._correction is not None and self._mount_std is not None
        known &= self._mount_state in _SERVED
        return self._frames.frames(self._estimate((k + 1) / TICK_RATE) if known else None)

    def _estimate(self, now: float | None = None) -> AttitudeEstimate:
        """Return the attitude of the vehicle. Its uncertainty includes the uncertainty of the
        mount.
        """
        e = self.filter.estimate(now)
        if self._mount_std is None:
            return e
        x, y, z = self._mount_std
        roll, pitch, heading = math.hypot(e.std[0], x), math.hypot(e.std[1], y), e.std[2]
        state = e.state
        if state is AttitudeState.FULL:
            heading = math.hypot(heading, z)
        is_unsure = self._mount_state is MountState.RESTORED or max(roll, pitch) > SETTLED_STD
        if AttitudeState.SETTLING < state < AttitudeState.UNFILTERED and is_unsure:
            state = AttitudeState.SETTLING
        return replace(
            e, state=state, std=(roll, pitch, heading), grade_std=math.hypot(e.grade_std, y)
        )

    def gap(self) -> None:
        """Restart the attitude, because time jumped."""
        self.filter.reset()

    def begin_anew(self) -> None:
        """Restart after a failed calculation. The sensor check is forgotten too, because its
        numbers may be the cause.
        """
        self.filter = self._new_filter()
        self._saved_check = None

    def summary(self) -> tuple[str, Mapping[str, Any]]:
        """Return the attitude at the end."""
        is_served = self._correction is not None and self._mount_state not in BAD
        if not is_served or not self.filter.running:
            return self.name, {"state": AttitudeState.NOT_AVAILABLE.name.lower()}
        e = self._estimate()

        def number(value: float, factor: float = 180.0 / math.pi) -> float | None:
            return None if math.isnan(value) else round(value * factor, 5)

        return self.name, {
            "state": e.state.name.lower(),
            "roll_deg": number(e.roll),
            "pitch_deg": number(e.pitch),
            "heading_deg": number(e.heading),
            "std_deg": [number(std) for std in e.std],
            "gyro_bias_deg_s": [number(b) for b in e.bias],
            "grade_percent": number(e.grade, 100.0),
            **self._free_acceleration(e),
            **self._heading_source(),
            "sensor_check": self.filter.checked,
            "rejected_samples": self.rejected,
        }

    def _heading_source(self) -> dict[str, str]:
        used = self.filter
        if self._settings.filter.heading == "free" or not isinstance(used, AttitudeFilter):
            return {}
        return {"heading_source": "doubted" if used.heading_is_doubted else "followed"}

    def _free_acceleration(self, e: AttitudeEstimate) -> dict[str, list[float | None]]:
        if not self.filter.settings.compensation.send:
            return {}
        values = [None if math.isnan(c) else round(c, 4) for c in e.free_acceleration]
        return {"free_acceleration_mps2": values}


def _with_step(settings: AttitudeSettings, gyro_step: float) -> AttitudeSettings:
    """Return the settings. If the configuration states no resolution of the gyroscope, the
    resolution from the database is used [rad/s]."""
    of_filter = settings.filter
    if of_filter.gyro_resolution_deg_s is None:
        of_filter = structs.replace(of_filter, gyro_resolution_deg_s=math.degrees(gyro_step))
    return structs.replace(settings, filter=of_filter)


def _as_corrected(zeros: CheckResult, correction: Correction) -> CheckResult:
    """Convert zero errors of the sensor (sensor axes) to zero errors of corrected samples. The
    offsets were already subtracted from corrected samples.
    """
    turned = zeros.turned(correction.matrix())
    return turned.less(correction.rate_offset, correction.force_offset)


def _as_sensed(zeros: CheckResult, correction: Correction) -> CheckResult:
    """Convert zero errors of corrected samples to zero errors of the sensor (sensor axes)."""
    p, q, r = correction.rate_offset
    a, b, c = correction.force_offset
    return zeros.less((-p, -q, -r), (-a, -b, -c)).turned(correction.matrix().T)


def _offsets_changed(before: Correction, now: Correction) -> tuple[Vector, Vector]:
    """Return the changes of the two offsets that are subtracted from turn rate and specific force,
    in the present vehicle axes.
    """
    turn = now.matrix() @ before.matrix().T

    def change(old: Vector, new: Vector) -> Vector:
        x, y, z = matrix_times(turn, old)
        return new[0] - x, new[1] - y, new[2] - z

    return (
        change(before.rate_offset, now.rate_offset),
        change(before.force_offset, now.force_offset),
    )


class TravelConsumer:
    """Computes the direction of travel of a carried terminal from its samples, in the terminal's
    axes (method D)."""

    name = "travel_direction"
    channels = frozenset(("gyro", "mag", "heading", "accel"))

    def __init__(self, config: Config, frames: TravelFrames) -> None:
        self._settings = config.travel_direction
        self.travel = TravelDirection(self._settings)
        self._frames = frames
        self._sent_steps = 0
        self._every = round(TICK_RATE)

    def sample(
        self, t: float, channel: str, values: Sequence[float], correction: Correction | None
    ) -> None:
        """Process a sample."""
        self.travel.sample(t, channel, values)

    def mounted(self, estimate: MountEstimate) -> None:
        """Do nothing, because a carried terminal has no mount."""

    def tick(self, k: int) -> list[OutFrame]:
        """Return a frame after each tick with a new step, and one frame a second."""
        travel = self.travel
        if travel.steps == self._sent_steps and (k + 1) % self._every:
            return []
        self._sent_steps = travel.steps
        return self._frames.frames(travel.last, travel.state((k + 1) / TICK_RATE), travel.steps)

    def gap(self) -> None:
        """Process a jump of time."""
        self.travel.gap()

    def begin_anew(self) -> None:
        """Restart after a failed calculation. The counts are kept."""
        before, self.travel = self.travel, TravelDirection(self._settings)
        self.travel.cycles.steps = before.cycles.steps
        self.travel.rejected = before.rejected

    def summary(self) -> tuple[str, Mapping[str, Any]]:
        """Return the number of steps and the last direction."""
        last = self.travel.last
        heading = None if last is None or last.heading is None else math.degrees(last.heading)
        return self.name, {
            "steps": self.travel.steps,
            "rejected_samples": self.travel.rejected,
            "heading_deg": None if heading is None else round(heading, 2),
            "ambiguous": last is not None and last.ambiguous,
        }
