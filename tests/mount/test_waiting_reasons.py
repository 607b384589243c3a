"""What each angle waits for, in words."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from imucald.mount.acceptance import WHY_GRAVITY_MOVED
from imucald.mount.estimate import ANGLES, MountState
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.explanation import waiting_reasons
from imucald.mount.hysteresis import BAD
from imucald.mount.states import MountKnowledge

SETTINGS = EstimatorSettings()
DEG = math.radians(1.0)


def words(state: MountState, yaw_deg: float, **troubles: str) -> dict[str, str]:
    """After a sudden tilt, of which nobody knows yet what it was."""
    std = (0.3 * DEG, 0.3 * DEG, yaw_deg * DEG)
    known = MountKnowledge(gravity=True, std=std, straight=5, lefts=2, rights=2)
    asked: Any = SimpleNamespace(missing_to_be_good=lambda: WHY_GRAVITY_MOVED, has_no_sides=False)
    return waiting_reasons(known, state, SETTINGS, asked, troubles)[0]


@pytest.mark.parametrize("state", [MountState.LEVELLED, *sorted(BAD)])
def test_what_a_mount_is_withheld_for_is_said_also_after_it_was_good(state):
    assert words(state, 0.1) == dict.fromkeys(ANGLES, WHY_GRAVITY_MOVED)
    some = words(state, 0.5, roll="the mount creeps")
    assert some["roll"] == "the mount creeps"
    assert some["pitch"] == WHY_GRAVITY_MOVED
    assert some["yaw"] != WHY_GRAVITY_MOVED, "it has a reason of its own"


def test_a_mount_that_is_good_is_not_withheld():
    assert WHY_GRAVITY_MOVED not in words(MountState.USABLE, 0.5).values()


def test_a_fine_mount_waits_for_nothing():
    """Also where an angle is past its target again, and the hysteresis keeps the state."""
    assert words(MountState.FINE, 0.5) == {}
    assert "more driving" in words(MountState.USABLE, 0.5)["yaw"]
