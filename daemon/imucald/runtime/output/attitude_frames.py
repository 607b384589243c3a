"""The frames of the vehicle's attitude: angles, deviations, rates, grade."""

from __future__ import annotations

import math

from imucald.attitude.estimate import AttitudeEstimate, AttitudeState
from imucald.config import Config
from imucald.runtime.output.sender import (
    NOT_AVAILABLE_SIGNED,
    NOT_AVAILABLE_UNSIGNED,
    OutFrame,
    Sender,
)

_TO_DEG = 180.0 / math.pi
DEVIATION_MAX = 327.67
"""Largest deviation that its signals hold [deg]."""
GRADE_DEVIATION_MAX = 655.34
"""[%]"""
RATE_DEVIATION_MAX = 6.5534
"""[deg/s]"""
HEADING_LSB = 0.01


class AttitudeFrames:
    """Encodes attitude estimates for one configuration."""

    def __init__(self, config: Config) -> None:
        ids, checksum = config.output.ids, config.output.checksum

        def sender(name: str, can_id: int, signals: dict[str, int]) -> Sender:
            return Sender(name, (*signals, "State"), can_id, checksum, signals)

        low, high = NOT_AVAILABLE_SIGNED, NOT_AVAILABLE_UNSIGNED
        self._angles = sender(
            "IMUCALD_Attitude", ids.attitude, {"Roll": low, "Pitch": low, "Heading": high}
        )
        self._deviation = sender(
            "IMUCALD_AttitudeDeviation",
            ids.attitude_deviation,
            dict.fromkeys(("DeviationRoll", "DeviationPitch", "DeviationHeading"), high),
        )
        self._rates = sender(
            "IMUCALD_Rates", ids.rates, dict.fromkeys((f"FreeRate{a}" for a in "XYZ"), low)
        )
        self._grade = sender(
            "IMUCALD_Grade",
            ids.grade,
            {"Grade": low, "DeviationGrade": high, "DeviationRate": high},
        )

        self._free = None
        if config.attitude.compensation.send:
            signals = dict.fromkeys((f"FreeAccel{a}" for a in "XYZ"), low)
            self._free = sender("IMUCALD_FreeAcceleration", ids.free_acceleration, signals)

    @property
    def can_ids(self) -> frozenset[int]:
        """Every id that is sent, with the flag for 29 bits."""
        return frozenset(s.can_id for s in self._senders())

    def _senders(self) -> list[Sender]:
        free = [] if self._free is None else [self._free]
        return [self._angles, self._deviation, self._rates, self._grade, *free]

    def frames(self, estimate: AttitudeEstimate | None) -> list[OutFrame]:
        """The frames; None: nothing is known. Angles are there from *settling* on."""
        if estimate is None or estimate.state < AttitudeState.SETTLING:
            state = 0 if estimate is None else int(estimate.state)
            nothing = (None, None, None, state)
            return [s.frame(nothing) for s in self._senders()]
        e, state = estimate, int(estimate.state)
        angles = (e.roll * _TO_DEG, e.pitch * _TO_DEG, bearing(e.heading), state)
        std = (*(min(s * _TO_DEG, DEVIATION_MAX) for s in e.std), state)
        rates = (*(rate * _TO_DEG for rate in e.rate), state)
        grade = (
            100.0 * e.grade,
            min(100.0 * e.grade_std, GRADE_DEVIATION_MAX),
            min(max(e.rate_std) * _TO_DEG, RATE_DEVIATION_MAX),
            state,
        )
        free = (*e.free_acceleration, state)
        return [
            sender.frame([None if math.isnan(v) else v for v in values])
            for sender, values in zip(
                self._senders(), (angles, std, rates, grade, free), strict=False
            )
        ]


def bearing(heading: float) -> float:
    """A heading [rad] in degrees, such that it does not round up to 360."""
    if math.isnan(heading):
        return heading
    degrees = (heading * _TO_DEG) % 360.0
    return degrees if degrees < 360.0 - 0.5 * HEADING_LSB else 0.0
