"""States with hysteresis: a reached state is left only beyond its limits times a slack."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from imucald.mount.estimate import MountState

GOOD = frozenset({MountState.USABLE, MountState.FINE})
"""States in which a mount counts as good."""
BAD = frozenset({MountState.SUSPECT, MountState.RECALIBRATING})
"""States in which a mount is used although evidence contradicts it."""

SLACK = 1.4
"""A reached state is left only beyond its limit times this factor; frames are still sent with the
stated deviation.
"""


class Level(NamedTuple):
    """A good state and its conditions.

    yaw_std, tilt_std: largest standard deviations [rad]. enough: whether the drive was long enough
    for it. slack: once reached, the state is left only beyond its limits times this.
    """

    state: MountState
    yaw_std: float
    tilt_std: float
    enough: bool
    slack: float


def best_level(
    levels: Iterable[Level], before: MountState, yaw_std: float, tilt_std: float
) -> MountState | None:
    """Return the first state whose limits hold, None if none does.

    levels: the best state first. before: the state so far. The limits of this state, and of lesser
    states, are multiplied by their slack.
    """
    for level in levels:
        times = level.slack if before in GOOD and before >= level.state else 1.0
        yaw_holds = yaw_std < level.yaw_std * times
        tilt_holds = tilt_std < level.tilt_std * times
        if level.enough and yaw_holds and tilt_holds:
            return level.state
    return None
