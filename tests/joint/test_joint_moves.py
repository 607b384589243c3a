"""A move of the sensor as the joint solution sees it: before against after, on planar drives."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.rotations import rotation_from_vector
from imucald.mount.joint.evidence import Block, Evidence
from imucald.mount.joint.moves import EntryChange, Move, likeliest_move
from imucald.mount.joint.state import Priors
from joint.planar_drive import ROTATION, Sensor, blocks

LEVEL_ROADS = Priors(crown=(0.0, 0.002), slope=0.002)
DEG = np.pi / 180.0
YAW = 2
MIXED = np.eye(3) + np.array([[0.0, 0.04, -0.03], [-0.02, 0.0, 0.04], [0.03, -0.05, 0.0]])


def turned(drive: list[Block], axis: int, degrees: float) -> list[Block]:
    """The same drive, of a sensor whose housing is turned by an angle about a vehicle axis."""
    T = rotation_from_vector(degrees * DEG * np.eye(3)[axis])
    in_sensor = ROTATION.T @ T @ ROTATION  # what was R_vehicle_from_sensor is T R
    return [b._replace(force=b.force @ in_sensor, rate=b.rate @ in_sensor) for b in drive]


def moves(drive: list[Block]) -> list[Move | None]:
    """What is found after each block."""
    evidence, found = Evidence(LEVEL_ROADS), []
    for block in drive:
        evidence.add_block(block)
        evidence.solve_when_due()
        move = evidence.move()
        found.append(move if move is not None and move.is_certain else None)
    return found


@pytest.mark.parametrize("degrees", [3.0, -3.0])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_turn_of_the_housing_is_found_about_its_axis_with_its_size(axis, degrees) -> None:
    drive, at = blocks(10.0, Sensor()), 60
    found = moves(drive[:at] + turned(drive[at:], axis, degrees))
    assert found[: at + 1] == [None] * (at + 1)
    first = next(k for k, move in enumerate(found) if move is not None)
    assert first - at <= 10, "within a minute"
    move = found[min(first + 6, len(found) - 1)]
    assert move is not None
    assert move.axis == axis
    assert move.size / DEG == pytest.approx(degrees, rel=0.25)
    assert abs(first + 6 + 1 - move.blocks - at) <= 4


@pytest.mark.parametrize("sensor", [Sensor(), Sensor(accel=MIXED, zero=np.array([0.2, 0.1, 0.0]))])
def test_a_sensor_that_stays_has_not_moved_however_its_axes_are_mixed(sensor) -> None:
    assert moves(blocks(10.0, sensor, lost=0.1)) == [None] * (6000 // 64)


def test_a_straight_road_says_nothing_of_a_move_and_breaks_no_arithmetic() -> None:
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        assert moves(blocks(5.0, Sensor(), bends=0.0)) == [None] * (3000 // 64)


def entries(*changes: float, axis: int = YAW) -> list[EntryChange]:
    """Entries that a turn changes by as much, each off by so many deviations of half a degree."""
    std = 0.5 * DEG
    return [
        EntryChange(np.eye(3)[axis], np.full(2, -off * std), np.full(2, std**2)) for off in changes
    ]


def test_one_entry_alone_must_be_far_off_while_two_that_agree_need_not() -> None:
    assert likeliest_move(entries(0.3, -0.5), [4, 8]).log_odds < -8.0
    assert likeliest_move(entries(9.0, 0.0), [4, 8]).log_odds < 0.0
    both = likeliest_move(entries(7.0, 7.0), [4, 8])
    assert both.log_odds > 0.0
    assert both.axis == YAW
    assert both.size == pytest.approx(3.5 * DEG, rel=0.1)


def test_entries_that_speak_for_opposite_turns_are_no_move() -> None:
    assert likeliest_move(entries(8.0, -8.0), [4, 8]).log_odds < 0.0
