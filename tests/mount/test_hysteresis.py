"""States with hysteresis: taken at a limit, left beyond it."""

from __future__ import annotations

import pytest

from imucald.mount.estimate import MountState
from imucald.mount.hysteresis import Level, best_level

FINE, USABLE, SUSPECT = MountState.FINE, MountState.USABLE, MountState.SUSPECT


def levels(enough: bool = True) -> tuple[Level, Level]:
    return Level(FINE, 0.3, 0.7, enough, 1.5), Level(USABLE, 1.0, 2.0, enough, 2.0)


@pytest.mark.parametrize(
    ("before", "yaw", "tilt", "found"),
    [
        (MountState.LEVELLED, 0.2, 0.5, FINE),
        (MountState.LEVELLED, 0.31, 0.5, USABLE),
        (MountState.LEVELLED, 0.2, 0.8, USABLE),
        (MountState.LEVELLED, 1.1, 0.5, None),
        (FINE, 0.4, 0.9, FINE),
        (FINE, 0.46, 0.9, USABLE),
        (FINE, 1.9, 3.9, USABLE),
        (USABLE, 0.4, 0.5, USABLE),
        (USABLE, 1.99, 0.5, USABLE),
        (USABLE, 2.01, 0.5, None),
        (SUSPECT, 1.3, 0.5, None),
        (SUSPECT, 0.4, 0.5, USABLE),
    ],
)
def test_a_state_is_taken_at_its_limits_and_left_beyond_them(
    before: MountState, yaw: float, tilt: float, found: MountState | None
) -> None:
    assert best_level(levels(), before, yaw, tilt) is found


def test_certainty_alone_is_not_enough() -> None:
    assert best_level(levels(enough=False), MountState.LEVELLED, 0.1, 0.1) is None
