"""States with hysteresis: a state is left only if its limit times a factor is exceeded."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from imucald.mount.estimate import MountState

GOOD = frozenset({MountState.USABLE, MountState.FINE})
"""States in which a mount counts as good."""
BAD = frozenset({MountState.SUSPECT, MountState.RECALIBRATING})
"""States in which a mount is used although evidence contradicts it."""

SLACK = 1.4
"""Factor on the limit of a state above which the state is left. Frames are still sent with their
stated deviation.
"""


class Level(NamedTuple):
    """A good state and its conditions.

    yaw_std, tilt_std: largest standard deviations [rad]. enough: True if the drive was long enough
    for this state. slack: factor on both limits while the state is held.
    """

    state: MountState
    yaw_std: float
    tilt_std: float
    enough: bool
    slack: float


def best_level(
    levels: Iterable[Level], before: MountState, yaw_std: float, tilt_std: float
) -> MountState | None:
    """Return the first state whose limits hold, or None if no state's limits hold.

    levels: states in order, the best state first. before: previous state. The limits of the
    previous state and of lower states are multiplied by their slack.
    """
    for level in levels:
        times = level.slack if before in GOOD and before >= level.state else 1.0
        yaw_holds = yaw_std < level.yaw_std * times
        tilt_holds = tilt_std < level.tilt_std * times
        if level.enough and yaw_holds and tilt_holds:
            return level.state
    return None
