"""Frames of the vehicle's attitude: angles, deviations, rates, grade."""

from __future__ import annotations

import math

from imucald.attitude.estimate import AttitudeEstimate, AttitudeState
from imucald.config import Config
from imucald.core.angles import DEG_PER_RAD
from imucald.runtime.output.output_message import (
    NOT_AVAILABLE_SIGNED,
    NOT_AVAILABLE_UNSIGNED,
    OutFrame,
    OutputMessage,
)


class AttitudeFrames:
    """Encodes attitude estimates in the frames of one configuration. angles: the frame with roll,
    pitch, heading and state."""

    def __init__(self, config: Config) -> None:
        ids, checksum = config.output.ids, config.output.checksum

        def message(name: str, can_id: int, signals: dict[str, int]) -> OutputMessage:
            return OutputMessage(name, (*signals, "State"), can_id, checksum, signals)

        low, high = NOT_AVAILABLE_SIGNED, NOT_AVAILABLE_UNSIGNED
        self.angles = message(
            "IMUCALD_Attitude", ids.attitude, {"Roll": low, "Pitch": low, "Heading": high}
        )
        self._deviation = message(
            "IMUCALD_AttitudeDeviation",
            ids.attitude_deviation,
            dict.fromkeys(("DeviationRoll", "DeviationPitch", "DeviationHeading"), high),
        )
        self._rates = message(
            "IMUCALD_Rates", ids.rates, dict.fromkeys((f"FreeRate{a}" for a in "XYZ"), low)
        )
        self._grade = message(
            "IMUCALD_Grade",
            ids.grade,
            {"Grade": low, "DeviationGrade": high, "DeviationRate": high},
        )

        self._free = None
        if config.attitude.compensation.send:
            signals = dict.fromkeys((f"FreeAccel{a}" for a in "XYZ"), low)
            self._free = message("IMUCALD_FreeAcceleration", ids.free_acceleration, signals)

    def messages(self) -> list[OutputMessage]:
        """All messages that are sent."""
        free = [] if self._free is None else [self._free]
        return [self.angles, self._deviation, self._rates, self._grade, *free]

    def frames(self, estimate: AttitudeEstimate | None) -> list[OutFrame]:
        """Return the frames of an estimate; None means that the attitude is unknown. Angles are
        sent from the state *settling* on."""
        if estimate is None or estimate.state < AttitudeState.SETTLING:
            state = 0 if estimate is None else int(estimate.state)
            nothing = (None, None, None, state)
            return [m.frame(nothing) for m in self.messages()]
        e, state = estimate, int(estimate.state)
        angles = (e.roll * DEG_PER_RAD, e.pitch * DEG_PER_RAD, bearing(e.heading), state)
        std = (*(s * DEG_PER_RAD for s in e.std), state)
        rates = (*(rate * DEG_PER_RAD for rate in e.rate), state)
        grade = (100.0 * e.grade, 100.0 * e.grade_std, max(e.rate_std) * DEG_PER_RAD, state)
        free = (*e.free_acceleration, state)
        return [
            message.frame([None if math.isnan(v) else v for v in values])
            for message, values in zip(
                self.messages(), (angles, std, rates, grade, free), strict=False
            )
        ]


def bearing(heading: float) -> float:
    """Return the bearing [deg] of a heading [rad]; a value that would round up to 360 becomes 0."""
    if math.isnan(heading):
        return heading
    degrees = (heading * DEG_PER_RAD) % 360.0
    return degrees if degrees < 360.0 - 0.005 else 0.0
