"""What each angle waits for, in words."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from msgspec.structs import replace

from imucald.mount.alternatives import NO_TURNS
from imucald.mount.estimate import ANGLES, Missing, MountState
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.explanation import waiting_reasons
from imucald.mount.hysteresis import BAD
from imucald.mount.signal_checks import WHY_GRAVITY_MOVED
from imucald.mount.states import MountKnowledge, waiting_for

SETTINGS = EstimatorSettings()
DEG = math.radians(1.0)


def words(state: MountState, yaw_deg: float, **troubles: str) -> dict[str, str]:
    """After a sudden tilt, of which nobody knows yet what it was."""
    std = (0.3 * DEG, 0.3 * DEG, yaw_deg * DEG)
    talk = (yaw_deg * DEG, 0.05 * DEG)
    known = MountKnowledge(gravity=True, std=std, cross_talk=talk)
    asked: Any = SimpleNamespace(missing_to_be_good=lambda: WHY_GRAVITY_MOVED, has_no_sides=False)
    return waiting_reasons(known, state, SETTINGS, asked, troubles)[0]


@pytest.mark.parametrize("state", [MountState.LEVELLED, *sorted(BAD)])
def test_what_a_mount_is_withheld_for_is_said_also_after_it_was_good(state):
    assert words(state, 0.1) == dict.fromkeys(ANGLES, WHY_GRAVITY_MOVED)
    some = words(state, 1.5, roll="the mount creeps")
    assert some["roll"] == "the mount creeps"
    assert some["pitch"] == WHY_GRAVITY_MOVED
    assert some["yaw"] != WHY_GRAVITY_MOVED, "it has a reason of its own"


def test_a_mount_that_is_good_is_not_withheld():
    assert WHY_GRAVITY_MOVED not in words(MountState.USABLE, 0.5).values()


def test_a_fine_mount_waits_for_nothing():
    """Also where an angle is past its target again, and the hysteresis keeps the state."""
    assert words(MountState.FINE, 0.5) == {}
    assert "bends" in words(MountState.USABLE, 0.5)["yaw"]


def level(tilt_deg: float, xy_deg: float = 0.1, yx_deg: float = 0.1) -> MountKnowledge:
    """What the joint estimator knows, whose cross-talk is judged."""
    std = (tilt_deg * DEG, tilt_deg * DEG, max(xy_deg, yx_deg) * DEG)
    cross_talk = xy_deg * DEG, yx_deg * DEG
    return MountKnowledge(gravity=True, std=std, straight=5, cross_talk=cross_talk)


def test_reasons_are_those_of_the_next_state():
    """What is small enough for *usable* does not keep a mount from it."""
    known = level(0.9)
    assert "roll" not in waiting_for(known, SETTINGS, MountState.LEVELLED)
    text, code = waiting_for(known, SETTINGS, MountState.USABLE)["roll"]
    expected = "more driving: slopes average out (forward axis ±1.8 deg, fine below ±1.17 deg)"
    assert (text, code) == (expected, Missing.MORE_DRIVING)


@pytest.mark.parametrize(
    ("xy", "yx", "text", "code"),
    [
        (1.5, 0.2, "bends", Missing.TURNS),
        (0.2, 1.5, "acceleration or braking above 1 m/s2", Missing.ACCELERATION),
    ],
)
def test_the_larger_cross_talk_says_what_to_drive(xy, yx, text, code):
    found = waiting_for(level(0.3, xy, yx), SETTINGS, MountState.LEVELLED)
    assert found == {"yaw": (f"{text} (up axis ±3 deg, usable below ±2 deg)", code)}


def test_no_bend_is_asked_for_where_no_signal_shows_turns():
    found = waiting_for(replace(level(0.3, 1.5, 0.2), turning=False), SETTINGS)
    assert found["yaw"] == (NO_TURNS, Missing.TURNS)


def test_a_speed_that_came_too_seldom_is_named_with_its_rate():
    """'a speed' alone, next to a rate of 48/s, read as if there were none."""
    seldom = replace(level(0.3, 1.5, 0.2), speed=False, speed_hz=48.0)
    found = waiting_for(seldom, SETTINGS, MountState.LEVELLED)
    assert found["yaw"] == ("a speed (48/s used in the last minute)", Missing.SPEED)


def test_without_a_speed_only_fine_waits_for_one():
    none = replace(level(0.3, 1.5, 0.2), speed=False, without_speed=True)
    assert waiting_for(none, SETTINGS, MountState.USABLE)["yaw"] == ("a speed", Missing.SPEED)
    text, code = waiting_for(none, SETTINGS, MountState.LEVELLED)["yaw"]
    assert text.startswith("bends (")
    assert code is Missing.TURNS


def test_a_level_zero_that_may_drift_waits_for_bends():
    known = replace(level(0.9), std_without_drift=(0.4 * DEG, 0.9 * DEG, 0.1 * DEG))
    found = waiting_for(known, SETTINGS, MountState.USABLE)
    assert found["roll"][0].startswith("bends, to decide whether the accelerometer's zero drifts (")
    assert found["roll"][1] is Missing.TURNS
    assert found["pitch"][1] is Missing.MORE_DRIVING
