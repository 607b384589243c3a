"""The frames that imucald sends. ``imucald_out.dbc`` defines the layout; the configuration defines
ids and protection.

Corrected samples are sent at once, one frame per sample. Status frames are sent with each snapshot.
A value that must not be used is sent as *not available*, never as a number. Columns of frames and
single frames give the same bytes, including counters.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from imucald.config import Config
from imucald.core.angles import DEG_PER_RAD
from imucald.mount.estimate import ANGLES, Missing, MountEstimate, MountState, SentDeviations
from imucald.runtime.output.output_message import (
    NOT_AVAILABLE_12,
    NOT_AVAILABLE_SIGNED,
    NOT_AVAILABLE_UNSIGNED,
    OutFrame,
    OutputMessage,
    output_database,
)

__all__ = ["Health", "OutFrame", "OutputFrames", "output_database"]

STATUS_FRAMES = 5
"""Number of status frames per snapshot: one for the mount, three for deviations, one for health."""

_LAYOUTS: Mapping[str, tuple[str, tuple[str, str, str], float]] = {
    "acceleration": ("IMUCALD_Acceleration", ("AccelX", "AccelY", "AccelZ"), 1.0),
    "angular_rate": ("IMUCALD_AngularRate", ("RateX", "RateY", "RateZ"), DEG_PER_RAD),
    "magnetic_field": ("IMUCALD_MagneticField", ("FieldX", "FieldY", "FieldZ"), 1e6),
}
"""For each kind of sensor: name of the message, names of the signals, factor from SI to the unit of
the signals."""

_HEALTH_FLAGS = (
    "AccelerometerMissing",
    "GyroscopeMissing",
    "SpeedMissing",
    "InputRejected",
    "FramesLost",
    "IdConflict",
    "SendFailed",
    "SensorFaulty",
)
_MAIN = {"acceleration": "accel", "angular_rate": "gyro", "magnetic_field": "mag"}


class Health(Struct, frozen=True):
    """Content of the health frame except the fields about the calibration, and the faulty sensors
    and signals."""

    accelerometer_missing: bool = False
    gyroscope_missing: bool = False
    speed_missing: bool = False
    input_rejected: bool = False
    frames_lost: bool = False
    id_conflict: bool = False
    send_failed: bool = False
    accelerometer_faulty: bool = False
    gyroscope_faulty: bool = False
    magnetometer_faulty: bool = False
    speed_faulty: bool = False
    yaw_rate_faulty: bool = False
    rejected: int = 0
    lost: int = 0

    @property
    def flags(self) -> tuple[bool, ...]:
        """The flags in the order of the health frame."""
        return (
            self.accelerometer_missing,
            self.gyroscope_missing,
            self.speed_missing,
            self.input_rejected,
            self.frames_lost,
            self.id_conflict,
            self.send_failed,
            self.accelerometer_faulty
            or self.gyroscope_faulty
            or self.magnetometer_faulty
            or self.speed_faulty
            or self.yaw_rate_faulty,
        )


class OutputFrames:
    """Encodes all frames of one configuration.

    triads: channels with a corrected frame, in sending order. planar: channels of parallel sensors
    with two axes; z is sent as *not available*. sensor_of: for each channel, the channel of the
    sensor whose health applies. For a parallel sensor, this is the main sensor of the same kind.
    attitude, travel: frames of the attitude (methods B and C) and of the direction of travel
    (method D), if configured.
    """

    def __init__(self, config: Config) -> None:
        output, signals = config.output, config.signals
        ids = output.ids
        kinds: dict[str, tuple[str, int]] = {"accel": ("acceleration", ids.acceleration)}
        if signals.gyroscope is not None:
            kinds["gyro"] = ("angular_rate", ids.angular_rate)
        if signals.magnetometer is not None:
            kinds["mag"] = ("magnetic_field", ids.magnetic_field)
        for sensor in signals.parallel:
            kinds[f"parallel/{sensor.name}"] = (sensor.kind, sensor.id)
        self.triads = tuple(kinds)
        self.planar = frozenset(f"parallel/{s.name}" for s in signals.parallel if s.z is None)
        self.sensor_of = {channel: _MAIN[kind] for channel, (kind, _) in kinds.items()}
        self._checksum = output.checksum
        self._corrected = {c: self._triad(kind, can_id) for c, (kind, can_id) in kinds.items()}
        self._factors = {c: _LAYOUTS[kind][2] for c, (kind, _) in kinds.items()}
        mount = [f"Mount{angle.capitalize()}" for angle in ANGLES]
        self._mount = self._message(
            "IMUCALD_Mount", ids.mount, mount, "State", NOT_AVAILABLE_SIGNED
        )
        self._deviation = self._deviations(
            "IMUCALD_MountDeviation", "XYZ", ids.mount_deviation, NOT_AVAILABLE_UNSIGNED
        )
        self._cross_talk = self._deviations(
            "IMUCALD_CrossTalkDeviation", ("XY", "YX", "ZX", "ZY"), ids.cross_talk_deviation
        )
        self._zero = self._deviations(
            "IMUCALD_ZeroDeviation", ("ZeroX", "ZeroY", "RateXZ", "RateYZ"), ids.zero_deviation
        )
        self._health = OutputMessage(
            "IMUCALD_Health",
            (
                "State",
                *(f"Waiting{a.capitalize()}" for a in ANGLES),
                *_HEALTH_FLAGS,
                "RejectedCount",
                "LostCount",
            ),
            ids.health,
            output.checksum,
            {},
        )

        self.attitude: AttitudeFrames | None = None
        self.travel: TravelFrames | None = None
        if config.attitude.enabled:
            from imucald.runtime.output.attitude_frames import AttitudeFrames  # noqa: PLC0415

            self.attitude = AttitudeFrames(config)
        if config.travel_direction.enabled:
            from imucald.runtime.output.travel_frames import TravelFrames  # noqa: PLC0415

            self.travel = TravelFrames(config)

    def message_of(self, channel: str) -> OutputMessage:
        """Return the message in which a channel of `triads` is sent."""
        return self._corrected[channel]

    @property
    def can_ids(self) -> frozenset[int]:
        """All ids that are sent, with the flag for 29 bits."""
        return frozenset(message.can_id for message in self.messages())

    def _all_messages(self) -> list[OutputMessage]:
        more = self._cross_talk, self._zero
        return [*self._corrected.values(), self._mount, self._deviation, *more, self._health]

    def go_on_from(self, before: OutputFrames) -> None:
        """Continue the counters of all messages that `before` also sends, so that receivers see no
        jump.
        """
        known = {message.key: message for message in before.messages()}
        for message in self.messages():
            if message.key in known:
                message.go_on_from(known[message.key])

    def messages(self) -> list[OutputMessage]:
        """All messages that are sent."""
        found = self._all_messages()
        for more in (self.attitude, self.travel):
            if more is not None:
                found += more.messages()
        return found

    def prepare(self) -> None:
        """Compile all messages now, so that the first frame takes no longer than later frames."""
        for message in self._all_messages():
            message.prepare()

    def _triad(self, kind: str, can_id: int) -> OutputMessage:
        name, signals, _ = _LAYOUTS[kind]
        return self._message(name, can_id, signals, "Quality", NOT_AVAILABLE_SIGNED)

    def _deviations(
        self, name: str, entries: Sequence[str], can_id: int, missing: int = NOT_AVAILABLE_12
    ) -> OutputMessage:
        signals = [f"Deviation{entry}" for entry in entries]
        return self._message(name, can_id, signals, "State", missing)

    def _message(
        self, name: str, can_id: int, signals: Sequence[str], last: str, missing: int
    ) -> OutputMessage:
        """Return a message. `missing` is the raw value of `signals` for *not available*. The signal
        `last` always has a value.
        """
        own = dict.fromkeys(signals, missing)
        return OutputMessage(name, (*signals, last), can_id, self._checksum, own)

    def corrected(self, channel: str, values: Sequence[float] | None, quality: int) -> OutFrame:
        """Return the frame of one corrected sample in SI (None: not available)."""
        message = self._corrected[channel]
        if values is None:
            return message.not_available()
        factor = self._factors[channel]
        x, y, z = values
        up = None if channel in self.planar else z * factor
        return message.frame((x * factor, y * factor, up, quality))

    def corrected_columns(
        self, channel: str, values: NDArray[np.float64], quality: NDArray[np.uint8]
    ) -> tuple[int, NDArray[np.uint8]]:
        """Return id and payloads (N, 8) of corrected samples (N, 3) in SI; NaN is not available."""
        message = self._corrected[channel]
        factor = self._factors[channel]
        columns = [values[:, i] * factor for i in range(3)]
        return message.can_id, message.payloads([*columns, quality.astype(np.float64)])

    def status(self, estimate: MountEstimate, usable: bool, health: Health) -> list[OutFrame]:
        """Return the status frames of one snapshot. The frames contain the angles only if `usable`
        is true."""
        state = int(estimate.state)
        angles = estimate.angles if usable else None
        std = estimate.std if usable else None
        nothing: tuple[None, None, None] = (None, None, None)
        angle_values = [v * DEG_PER_RAD for v in angles] if angles else nothing
        std_values = [v * DEG_PER_RAD for v in std] if std else nothing
        sent = estimate.sent if usable else None
        cross_talk, zero = _of_sent(sent)
        waiting = [int(estimate.missing.get(a, _default(estimate, a))) for a in ANGLES]
        return [
            self._mount.frame((*angle_values, state)),
            self._deviation.frame((*std_values, state)),
            self._cross_talk.frame((*cross_talk, state)),
            self._zero.frame((*zero, state)),
            self._health.frame(
                (state, *waiting, *map(float, health.flags), health.rejected, health.lost)
            ),
        ]


def _of_sent(
    sent: SentDeviations | None,
) -> tuple[Sequence[float | None], Sequence[float | None]]:
    """Return the deviations of corrected samples in the units of two frames: first cross-talk, then
    zero error and turn rate. All deviations are None if `sent` is None."""
    if sent is None:
        return (None,) * 4, (None,) * 4
    cross_talk = [v * DEG_PER_RAD for v in (sent.xy, sent.yx, sent.zx, sent.zy)]
    rates = [v * DEG_PER_RAD for v in (sent.rate_xz, sent.rate_yz)]
    return cross_talk, [sent.zero_x, sent.zero_y, *rates]


def _default(estimate: MountEstimate, angle: str) -> Missing:
    if angle in estimate.waiting_for:
        return Missing.OTHER
    return Missing.NOTHING if estimate.state != MountState.WAITING else Missing.OTHER
