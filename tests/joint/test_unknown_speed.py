"""A drive without a speed: the filter that eliminates it, on drives in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.samples import GRAVITY
from imucald.drive.unknown_speed import NAMES, Steered, UnknownSpeed
from imucald.motion.ticks import TICK_S

TICKS = 1200
T = np.arange(TICKS) * TICK_S
SPEED = 10.0 + 5.0 * np.sin(0.25 * T)
ACCEL = 5.0 * 0.25 * np.cos(0.25 * T)
TURN = 0.25 * np.sin(0.5 * T) ** 3
NEVER = np.zeros(TICKS, dtype=bool)
ALWAYS = ~NEVER


def follower(is_carried: bool = True, steered: Steered | None = None) -> UnknownSpeed:
    return UnknownSpeed(0.02, 0.0, is_carried, steered)


def driven(xy: float = 0.0, yx: float = 0.0) -> np.ndarray:
    """The force of the drive on a level road, with this cross-talk."""
    lateral = SPEED * TURN
    level = np.full(TICKS, GRAVITY)
    return np.column_stack([ACCEL + xy * lateral, lateral + yx * ACCEL, level])


def rates(turn: np.ndarray = TURN) -> np.ndarray:
    return np.column_stack([np.zeros((TICKS, 2)), turn])


@pytest.mark.parametrize("is_carried", [True, False], ids=["gyroscope", "yaw rate"])
def test_bends_show_the_speed(is_carried: bool) -> None:
    unknown = follower(is_carried)
    found = unknown.follow(driven(), rates(), NEVER, ALWAYS)
    assert np.abs(found.speed - SPEED)[300:].max() < 0.5
    assert unknown.std < 2.0


def test_bends_of_a_steering_angle_show_the_speed() -> None:
    steered = Steered(12.0, 0.001)
    shares = np.array([steered.share(v) for v in SPEED.tolist()])
    found = follower(False, steered).follow(driven(), rates(TURN / shares), NEVER, ALWAYS)
    assert np.abs(found.speed - SPEED)[300:].max() < 0.5
    np.testing.assert_allclose(found.turn[300:], TURN[300:], atol=0.02)


def test_a_vehicle_that_drives_backward_has_a_negative_speed() -> None:
    found = follower().follow(-driven(), rates(), NEVER, ALWAYS)
    assert np.abs(found.speed + SPEED)[300:].max() < 0.5


@pytest.mark.parametrize(("name", "size"), [("xy", {"xy": 1e-4}), ("yx", {"yx": 1e-4})])
def test_an_error_shows_as_its_column_says(name: str, size: dict[str, float]) -> None:
    sound = follower().follow(driven(), rates(), NEVER, ALWAYS).columns
    wrong = follower().follow(driven(**size), rates(), NEVER, ALWAYS).columns
    shown = (wrong[:, 0] - sound[:, 0])[300:] / 1e-4
    column = sound[300:, NAMES.index(name)]
    assert np.abs(shown - column).max() < 0.1 * np.abs(column).max()


def test_a_stop_is_rest_and_a_smooth_cruise_is_not() -> None:
    still = np.column_stack([np.zeros((TICKS, 2)), np.full(TICKS, GRAVITY)])
    unknown = follower()
    unknown.follow(driven(), rates(), NEVER, ALWAYS)  # 4.3 m/s at the end, by the bends
    found = unknown.follow(still, np.zeros((TICKS, 3)), ALWAYS, ALWAYS)
    assert abs(found.speed[10] - SPEED[-1]) < 1.0
    parked = follower().follow(still, np.zeros((TICKS, 3)), ALWAYS, ALWAYS)
    assert abs(parked.speed[10]) < 0.2


def test_ticks_without_a_usable_force_are_bridged() -> None:
    broken, use = driven(), ALWAYS.copy()
    broken[600:620] = 300.0
    use[600:620] = False
    found = follower().follow(broken, rates(), NEVER, use)
    assert np.abs(found.speed - SPEED)[700:].max() < 1.0
