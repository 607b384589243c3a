"""Method D as published: every formula, each rule of the choice."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imucald.config.attitude import ChoiceSettings
from imucald.travel_direction.method_d import (
    PublishedDirection,
    correlation_angle,
    difference,
    level_heading,
    levelling_angles,
    projected,
    tilt,
    tilt_angle,
    tilt_heading,
    y_angle,
)
from imucald.travel_direction.step_cycles import POINTS, StepCycle

G = 9.80665
DEG = math.pi / 180.0
LEAN = st.floats(-1.2, 1.2)
PHASE = 2.0 * np.pi * np.arange(POINTS) / POINTS


def cycle_of(direction, lean=(0.0, 0.0), lead=90.0, sway=0.0) -> StepCycle:
    """One step, walking `direction` [rad, clockwise from y] in level axes, terminal leaning."""
    forward = 0.8 * np.cos(PHASE + math.radians(lead))
    side = sway * np.cos(0.5 * PHASE)
    s, c = math.sin(direction), math.cos(direction)
    level = np.column_stack(
        [forward * s + side * c, forward * c - side * s, G + 1.5 * np.cos(PHASE)]
    )
    # leaning: first about x, then about the new y, as a terminal in a hand does
    terminal = Rotation.from_euler("xy", [lean[0], lean[1]]).apply(level)
    return StepCycle(0.0, 0.5, terminal, np.zeros((POINTS, 3)), np.zeros((POINTS, 2)))


# tilt ------------------------------------------------------------------------------------------


def test_tilt_is_that_of_the_text():
    x, y, z = 1.0, 2.0, 3.0
    pitch, roll = tilt(np.array([x, y, z]))
    assert math.tan(pitch) == pytest.approx(y / math.hypot(x, z))
    assert math.tan(roll) == pytest.approx(x / math.hypot(y, z))


@pytest.mark.parametrize(
    ("raised", "clockwise"),
    [((0.0, 1.0), 0.0), ((1.0, 0.0), 90.0), ((0.0, -1.0), 180.0), ((-1.0, 0.0), 270.0)],
)
def test_the_raised_edge(raised, clockwise):
    """(x, y) of the edge that is up: the text's accelerometer reads -g there."""
    mean = np.array([2.0 * raised[0], 2.0 * raised[1], 9.6])
    heading = tilt_heading(*tilt(-mean), 30.0 * DEG)
    assert math.degrees(difference(heading, (clockwise + 30.0) * DEG)) < 1e-9


def test_the_angle_is_the_texts():
    pitch, roll = -0.3, 0.2
    first = (math.degrees(math.atan2(roll, pitch)) + 180.0) % 360.0  # [0070]
    second = (math.degrees(math.atan2(pitch, roll)) + 180.0) % 360.0  # [0072]
    assert tilt_angle(pitch, roll) == pytest.approx(math.radians(first))
    heading = tilt_heading(pitch, roll, 1.0)
    assert heading == pytest.approx((math.radians(first) + 1.0) % (2.0 * math.pi))  # [0079]
    from_east = 0.5 * math.pi - heading
    assert difference(from_east, math.radians(second) - 1.0) < 1e-12  # [0081]


# projection and compass ------------------------------------------------------------------------


@given(st.tuples(LEAN, LEAN, st.floats(-2.0, 2.0)), st.tuples(LEAN, LEAN, LEAN))
def test_the_projection_is_the_texts_and_levels_the_mean(mean, v):
    m = np.array(mean)
    if np.linalg.norm(m) < 0.1:
        m[2] = 1.0
    a, b = levelling_angles(m)
    levelled = projected(m, a, b)
    assert levelled == pytest.approx([0.0, 0.0, np.linalg.norm(m)], abs=1e-9)
    X, Y, Z = v
    sa, ca, sb, cb = math.sin(a), math.cos(a), math.sin(b), math.cos(b)
    expected = (
        X * ca + Y * sa * sb + Z * cb * sa,
        Y * cb - Z * sb,
        -X * sa + Y * ca * sb + Z * cb * ca,
    )
    assert projected(np.array(v), a, b) == pytest.approx(expected, abs=1e-12)
    turn = Rotation.from_euler("y", a) * Rotation.from_euler("x", b)
    assert expected == pytest.approx(turn.apply(v), abs=1e-9)


@given(st.floats(0.0, 359.0), st.floats(-80.0, 80.0), st.floats(-180.0, 180.0))
def test_the_compass_is_that_of_the_upper_edge(heading_deg, pitch_deg, roll_deg):
    """The terminal points its y axis somewhere, raises it and turns about it: face down too."""
    turn = Rotation.from_euler("ZXY", [-heading_deg, pitch_deg, roll_deg], degrees=True)
    field = turn.inv().apply([0.0, 20.0, -45.0])
    mean = turn.inv().apply([0.0, 0.0, G])
    found = level_heading(field, mean) + y_angle(mean)
    assert math.degrees(difference(found, math.radians(heading_deg))) < 1e-6


# correlation -----------------------------------------------------------------------------------


@given(st.floats(0.0, 6.28), st.floats(-1.0, 1.0), st.floats(60.0, 120.0))
def test_the_correlation_finds_the_direction_of_a_clean_step(direction, lean, lead):
    angle = correlation_angle(cycle_of(direction, (lean, 0.0), lead).accel)
    assert angle is not None
    assert math.degrees(difference(angle, direction)) < 0.5


@pytest.mark.parametrize("quadrant", [30.0, 120.0, 210.0, 300.0])
def test_signs_give_the_quadrant(quadrant):
    found = correlation_angle(cycle_of(math.radians(quadrant)).accel)
    assert found is not None
    assert math.degrees(found) == pytest.approx(quadrant, abs=1e-6)


def test_a_terminal_at_rest_has_no_correlation():
    assert correlation_angle(np.tile([0.0, 0.0, G], (POINTS, 1))) is None


# choice ----------------------------------------------------------------------------------------

STEEP, FLAT = (-20.0 * DEG, 0.0), (-1.0 * DEG, 0.0)  # the upper edge is raised


def taken(*cycles, choice=ChoiceSettings()):  # noqa: B008
    direction = PublishedDirection(choice)
    return [direction.take_cycle(cycle, compass) for cycle, compass in cycles]


def test_tilt_decides_where_the_terminal_leans():
    (result,) = taken((cycle_of(0.1, STEEP), 0.0))
    assert result.used_tilt
    assert result.heading == result.tilt_heading
    assert math.degrees(difference(result.heading, 0.0)) < 1.0


def test_correlation_decides_where_it_lies_flat():
    (result,) = taken((cycle_of(1.0, FLAT), 0.5))
    assert not result.used_tilt
    assert result.heading == result.correlation_heading
    assert math.degrees(difference(result.heading, 1.5)) < 1.0


def test_a_contradiction_of_two_cycles_is_for_the_correlation():
    """Leaning one way, walking another: believed at the second time."""
    against = cycle_of(90.0 * DEG, STEEP)
    first, second, third = taken((against, 0.0), (against, 0.0), (against, 0.0))
    assert first.used_tilt
    assert not second.used_tilt
    assert not third.used_tilt


def test_a_single_contradiction_is_not():
    agreeing, against = cycle_of(0.0, STEEP), cycle_of(90.0 * DEG, STEEP)
    results = taken((agreeing, 0.0), (against, 0.0), (agreeing, 0.0), (against, 0.0))
    assert all(result.used_tilt for result in results)


@pytest.mark.parametrize(("turn_deg", "is_turn"), [(59.0, False), (61.0, True)])
def test_a_turn_is_a_compass_that_moved_by_more(turn_deg, is_turn):
    against = cycle_of(90.0 * DEG, STEEP)
    results = taken((against, 0.0), (against, turn_deg * DEG))
    assert results[1].is_turn is is_turn
    assert results[1].used_tilt is is_turn  # on a turn contradiction does not count


def test_on_a_turn_a_flat_terminal_is_for_the_correlation():
    flat = cycle_of(0.0, FLAT)
    assert not taken((flat, 0.0), (flat, 2.0))[1].used_tilt


def test_all_presets_are_presets():
    lean = cycle_of(0.0, (-10.0 * DEG, 0.0))
    against = cycle_of(90.0 * DEG, STEEP)
    assert not taken((lean, 0.0), choice=ChoiceSettings(tilt_deg=11.0))[0].used_tilt
    settings = ChoiceSettings(turn_deg=20.0, tilt_on_turn_deg=11.0)
    assert not taken((lean, 0.0), (lean, 0.5), choice=settings)[1].used_tilt
    settings = ChoiceSettings(differ_deg=100.0)
    assert taken((against, 0.0), (against, 0.0), choice=settings)[1].used_tilt
