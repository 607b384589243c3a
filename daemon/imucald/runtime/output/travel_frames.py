"""The frame with the direction of travel of a carried terminal."""

from __future__ import annotations

from imucald.config import Config
from imucald.core.angles import DEG_PER_RAD
from imucald.runtime.output.attitude_frames import bearing
from imucald.runtime.output.output_message import NOT_AVAILABLE_UNSIGNED, OutFrame, OutputMessage
from imucald.travel_direction.direction import Step, TravelState

WALKS = frozenset({TravelState.WALKING, TravelState.TURNING, TravelState.AMBIGUOUS})


class TravelFrames:
    """Encodes directions of travel in the frames of one configuration."""

    def __init__(self, config: Config) -> None:
        self._message = OutputMessage(
            "IMUCALD_TravelDirection",
            ("TravelHeading", "CompassHeading", "StepCount", "State"),
            config.output.ids.travel_direction,
            config.output.checksum,
            dict.fromkeys(("TravelHeading", "CompassHeading"), NOT_AVAILABLE_UNSIGNED),
        )

        self._deviation = OutputMessage(
            "IMUCALD_TravelDeviation",
            ("DeviationTravel", "AheadProbability", "AxisHeading", "State"),
            config.output.ids.travel_deviation,
            config.output.checksum,
            dict.fromkeys(
                ("DeviationTravel", "AheadProbability", "AxisHeading"), NOT_AVAILABLE_UNSIGNED
            ),
        )

    def messages(self) -> list[OutputMessage]:
        """All messages that are sent."""
        return [self._message, self._deviation]

    def frames(self, step: Step | None, state: TravelState, steps: int) -> list[OutFrame]:
        """Return the frames after a step. Headings are available only while the person walks. A
        heading that may be wrong by 180 deg is sent only as an axis (without direction).
        """
        if step is None or state not in WALKS:
            nothing = (None, None, None, int(state))
            return [
                self._message.frame((None, None, steps, int(state))),
                self._deviation.frame(nothing),
            ]
        heading, compass = (
            None if angle is None else bearing(angle) for angle in (step.heading, step.compass)
        )
        axis = heading
        if state is TravelState.AMBIGUOUS:
            heading = None
        deviation, ahead = step.deviation, step.ahead
        sure = (
            None if deviation is None else deviation * DEG_PER_RAD,
            None if ahead is None else 100.0 * ahead,
            axis,
            int(state),
        )
        return [
            self._message.frame((heading, compass, steps, int(state))),
            self._deviation.frame(sure),
        ]
