"""The frame of a carried terminal's direction of travel."""

from __future__ import annotations

from imucald.config import Config
from imucald.runtime.output.attitude_frames import bearing
from imucald.runtime.output.output_message import NOT_AVAILABLE_UNSIGNED, OutFrame, OutputMessage
from imucald.travel_direction.direction import Step, TravelState

STEPS_MAX = 65534


class TravelFrames:
    """Encodes directions of travel for one configuration."""

    def __init__(self, config: Config) -> None:
        self._message = OutputMessage(
            "IMUCALD_TravelDirection",
            ("TravelHeading", "CompassHeading", "StepCount", "State"),
            config.output.ids.travel_direction,
            config.output.checksum,
            dict.fromkeys(("TravelHeading", "CompassHeading"), NOT_AVAILABLE_UNSIGNED),
        )

    @property
    def can_ids(self) -> frozenset[int]:
        """Every id that is sent, with the flag for 29 bits."""
        return frozenset((self._message.can_id,))

    def frames(self, step: Step | None, state: TravelState, steps: int) -> list[OutFrame]:
        """The frame after a step; headings are there while somebody walks."""
        count = min(steps, STEPS_MAX)
        if step is None or state not in (TravelState.WALKING, TravelState.TURNING):
            return [self._message.frame((None, None, count, int(state)))]
        heading, compass = (
            None if angle is None else bearing(angle) for angle in (step.heading, step.compass)
        )
        return [self._message.frame((heading, compass, count, int(state)))]
