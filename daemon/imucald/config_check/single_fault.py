"""Find the single wrong sign or the single exchange of axes that explains all contradictions
between signals.

A signal with a wrong sign contradicts several other signals. Such a signal therefore causes several
findings, and some of these findings blame correct signals. Therefore each possible single fault is
undone in turn, and all signals are compared again. If no contradiction is left, this fault explains
all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from imucald.config_check.finding import TURN_SIGN, Finding, sign_remedy
from imucald.config_check.motion import Motion
from imucald.core.arrays import Array
from imucald.mount.mirror import AT_REST

MOST_NAMED = 3
"""Largest number of possible faults that are named. A longer list would not help the user."""
_SIDED = {
    "yaw_rate": "yaw_rate",
    "steering_wheel_angle": "steering",
    "lateral_acceleration": "lateral_accel",
    "heading": "heading",
}
"""Channels of the signals whose sign distinguishes left from right, by quantity."""
_OTHER_SIDE = np.eye(4)[[1, 0, 3, 2]]
"""Left and right wheels exchanged."""


@dataclass(frozen=True)
class SingleFault:
    """One possible fault. matrix: (w, w), multiplying the channel's axes by this matrix removes the
    fault. remedy: text that states the necessary change."""

    quantity: str
    text: str
    remedy: str
    channel: str
    matrix: Array


def explained(
    found: Sequence[Finding], motion: Motion, judge: Callable[[Motion], Iterable[Finding]]
) -> tuple[list[Finding], Motion]:
    """Replace the errors by the single faults that explain all of them.

    judge: yields the findings about a motion with one fault removed. A fault is named if its
    removal leaves no error, and if no other fault leaves more pairs of agreeing signals. The number
    of agreeing pairs must also be larger than before the removal. If there is no such fault, or
    there are too many, the errors are not replaced. Returns the findings, and the motion. If there
    is exactly one such fault, it is removed from the returned motion.
    """
    if all(finding.level != "error" for finding in found):
        return list(found), motion
    possible: list[SingleFault] = []
    most = 1 + sum(finding.level == "ok" for finding in found)
    for fault in _faults(motion):
        agree = _agreeing(judge(motion.turned(fault.channel, fault.matrix)))
        if agree is not None and agree >= most:
            possible = [*(possible if agree == most else ()), fault]
            most = agree
    if not 0 < len(possible) <= MOST_NAMED:
        return list(found), motion
    others = [finding for finding in found if finding.level != "error"]
    if len(possible) == 1:
        (one,) = possible
        text = f"{one.text}: {one.remedy}. Then all signals agree"
        named = Finding("error", one.quantity, text)
        return [named, *others], motion.turned(one.channel, one.matrix)
    words = "; or ".join(f"{one.quantity}: {one.text} ({one.remedy})" for one in possible)
    text = f"the signals contradict each other. One of these faults is the cause: {words}"
    quantities = tuple(one.quantity for one in possible)
    return [Finding("error", "signals", text, quantities), *others], motion


def _agreeing(found: Iterable[Finding]) -> int | None:
    """Return the number of findings that confirm a pair of signals; None if any is an error."""
    count = 0
    for finding in found:
        if finding.level == "error":
            return None
        count += finding.level == "ok"
    return count


def _faults(motion: Motion) -> Iterator[SingleFault]:
    for quantity, channel in _SIDED.items():
        if channel in motion.grid:
            yield SingleFault(quantity, "wrong sign", sign_remedy(quantity), channel, -np.eye(1))
    if "wheel_speeds" in motion.grid:
        text = "left and right exchanged"
        yield SingleFault("wheel_speeds", text, "exchange their lines", "wheel_speeds", _OTHER_SIDE)
    if motion.planar:
        return
    for quantity, channel in (("accelerometer", "accel"), ("gyroscope", "gyro")):
        if channel not in motion.grid:
            continue
        eye = np.eye(3)
        for i, axis in enumerate("xyz"):
            text = f"wrong sign of its {axis} axis"
            yield SingleFault(
                quantity, text, TURN_SIGN, channel, eye - 2.0 * np.outer(eye[i], eye[i])
            )
        for order, axes in (([1, 0, 2], "x and y"), ([2, 1, 0], "x and z"), ([0, 2, 1], "y and z")):
            text = f"exchanged axes {axes}"
            yield SingleFault(quantity, text, "exchange their lines", channel, eye[order])
        remedy = f"{AT_REST}; {TURN_SIGN}" if channel == "accel" else TURN_SIGN
        yield SingleFault(quantity, "wrong sign of all its axes", remedy, channel, -eye)
