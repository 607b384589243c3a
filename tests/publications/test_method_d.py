"""Method D as the package has it against the text, paragraph by paragraph."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gait import CARRYINGS, walk
from imucald.config.attitude import ChoiceSettings, TravelDirectionSettings
from imucald.travel_direction.direction import Step, TravelDirection
from imucald.travel_direction.method_d import (
    PublishedDirection,
    correlation_angle,
    level_heading,
    levelling_angles,
    projected,
    tilt,
    y_angle,
)
from imucald.travel_direction.step_cycles import POINTS, StepCycle
from publications import method_d as text
from publications.recordings import recording, table

G = 9.80665
RNG = np.random.default_rng(20130930)
FULL = 2.0 * math.pi


def leans(count: int) -> list[np.ndarray]:
    """Mean specific forces: flat, on edge, upside down, at random."""
    fixed = [(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, -1, 0), (0, 0, -1), (1e-6, 0, -1), (0.6, -0.8, 0)]
    found = [np.array(v, dtype=float) * G for v in fixed]
    return found + list(RNG.normal(0.0, 1.0, (count, 3)) * G)


def apart(a: float | None, b: float | None) -> float:
    if a is None or b is None:
        return 0.0 if a is b else math.inf
    return abs(math.remainder(a - b, FULL))


# Formulas ---------------------------------------------------------------------------------------


def test_0058_pitch_and_roll() -> None:
    for A in leans(200):
        assert tilt(A) == pytest.approx(text.pitch_roll(A), abs=1e-9)


def test_d4_the_projection_levels_with_its_own_angles_and_not_with_those_of_0093() -> None:
    for A in leans(100):
        alpha, beta = text.levelling_angles(A)
        assert levelling_angles(A) == pytest.approx((alpha, beta), abs=1e-9)
        v = RNG.normal(0.0, 3.0, 3)
        assert projected(v, alpha, beta) == pytest.approx(text.projected(v, alpha, beta), abs=1e-9)
        size = float(np.linalg.norm(A))
        assert text.projected(A, alpha, beta) == pytest.approx([0.0, 0.0, size], abs=1e-9 * size)
    A = Rotation.from_euler("xy", [20.0, 20.0], degrees=True).apply([0.0, 0.0, G])
    literal = text.projected(A, *text.pitch_roll(A))
    assert math.degrees(math.atan2(math.hypot(literal[0], literal[1]), literal[2])) > 20.0


def test_0003_the_compass_is_the_horizontal_projection_of_the_head() -> None:
    for A in leans(100):
        field = RNG.normal(0.0, 30e-6, 3)
        heading, to_y = level_heading(field, A), y_angle(A)
        if to_y is None:  # the head points up or down
            assert abs(A[1]) / np.linalg.norm(A) > 0.99
            continue
        assert heading is not None
        assert apart(to_y, text.plane_angle(A)) < 1e-9
        assert apart(heading + to_y, text.compass_angle(field, A)) < 1e-9


BY_ANOTHER_READER = [
    # reading at rest / g and north, in terminal axes; azimuth of y, tilt heading, azimuth of the
    # plane's y [deg]
    ((0.25489, -0.17365, -0.95125), (0.82223, -0.47879, 0.30772), 119.09, 243.195, 301.754),
    ((-0.33037, 0.25882, -0.90767), (-0.92465, 0.10426, 0.36627), 276.196, 224.064, 101.578),
    ((-0.99027, 0.0, 0.13917), (-0.11483, 0.565, -0.81707), 55.598, 325.598, 55.598),
    ((0.98106, 0.08716, 0.17299), (-0.16897, 0.82174, 0.54424), 34.424, 120.795, 60.726),
    ((-0.17101, 0.93969, 0.2962), (-0.80711, -0.30603, 0.5049), 153.479, 145.472, 124.998),
    ((0.27165, 0.90631, 0.32374), (-0.94188, 0.18129, 0.28282), 64.598, 78.229, 101.85),
    ((-0.04494, -0.96593, 0.25489), (0.91312, 0.06377, 0.40266), 284.263, 106.23, 293.929),
    ((-0.55667, 0.76604, 0.32139), (0.8274, 0.54587, 0.13201), 328.128, 294.049, 275.132),
    # by a third reader: 35/35, 70/40, exactly on edge, face down with a lean to each side
    ((0.46985, 0.57358, 0.67101), (-0.27452, -0.62751, 0.72861), 140.0, 178.684, 161.882),
    ((0.21985, 0.93969, 0.262), (0.92643, -0.11698, -0.35782), 250.0, 260.283, 288.256),
    ((1.0, 0.0, 0.0), (0.0, 0.96593, 0.25882), 15.0, 105.0, 15.0),
    ((0.32139, 0.34202, -0.88302), (0.75531, 0.46985, 0.4569), 60.0, 103.148, 232.904),
    ((-0.39713, 0.34202, -0.85165), (-0.4458, -0.88302, -0.14674), 200.0, 150.522, 29.062),
]  # fmt: skip
"""Face down, on edge, steep, hanging: worked out from the publication by ones who had seen neither
the package's method D nor `publications.method_d`."""


@pytest.mark.parametrize(("up", "north", "head_deg", "tilt_deg", "plane_deg"), BY_ANOTHER_READER)
def test_another_readers_vectors(up, north, head_deg, tilt_deg, plane_deg) -> None:
    A = G * np.array(up)
    field = 20e-6 * np.array(north) - 44e-6 * np.array(up)
    head, by_tilt, plane = (math.radians(deg) for deg in (head_deg, tilt_deg, plane_deg))
    compass, by_waves = text.compass_angle(field, A), level_heading(field, A)
    near = math.radians(0.01)
    assert apart(compass, head) < near
    assert apart(compass - text.plane_angle(A), plane) < near
    assert apart(text.azimuth_first(text.angle_first(*text.pitch_roll(-A)), head), by_tilt) < near
    assert apart(by_waves, plane) < near
    to_y = y_angle(A)
    assert to_y is not None
    assert by_waves is not None
    assert apart(by_waves + to_y, head) < near


def test_0107_to_0130_the_correlation() -> None:
    for k in range(40):
        accel = RNG.normal(0.0, 1.0, (POINTS, 3)).cumsum(axis=0) * 0.3
        accel += leans(0)[k % 7] + RNG.normal(0.0, 1.0, 3)
        assert apart(correlation_angle(accel), text.correlation_angle(accel)) < 1e-9


def test_d2_both_formula_pairs_are_of_an_accelerometer_that_reads_minus_g_upwards() -> None:
    """[0070] with [0079] clockwise from north, [0072] with [0081] the other way from east."""
    for A in leans(200)[7:]:
        compass = float(RNG.uniform(0.0, FULL))
        pitch, roll = text.pitch_roll(-A)
        first = text.azimuth_first(text.angle_first(pitch, roll), compass)
        second = text.azimuth_second(text.angle_second(pitch, roll), compass)
        assert apart(first, 0.5 * math.pi - second) < 1e-9
        # the edge that is up reads +g; angles stand for their sines, so nearly level
        flat = np.array([1e-4 * A[0], 1e-4 * A[1], G])
        pitch, roll = text.pitch_roll(-flat)
        first = text.azimuth_first(text.angle_first(pitch, roll), compass)
        assert apart(first, math.atan2(A[0], A[1]) + compass) < 1e-6


# The whole method -------------------------------------------------------------------------------


def random_cycle() -> StepCycle:
    phase = FULL * np.arange(POINTS) / POINTS
    way, amount = float(RNG.uniform(0.0, FULL)), float(RNG.uniform(0.2, 1.5))
    level = np.column_stack([amount * math.sin(way) * np.cos(phase + 1.7),
                             amount * math.cos(way) * np.cos(phase + 1.7),
                             G + 1.5 * np.cos(phase)])  # fmt: skip
    lean = Rotation.from_euler("xy", RNG.normal(0.0, 8.0, 2), degrees=True)
    accel = lean.apply(level) + RNG.normal(0.0, 0.1, (POINTS, 3))
    return StepCycle(0.0, 0.5, accel, np.zeros((POINTS, 3)), np.zeros((POINTS, 2)))


PRESETS = {
    "as published": {},
    "turn 20": {"turn": 20.0},
    "tilt on turn 15": {"tilt_on_turn": 15.0},
    "differ 90": {"differ": 90.0},
    "tilt 15": {"tilt": 15.0},
}


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_0037_to_0053_the_choice_under_each_preset(name: str) -> None:
    presets = PRESETS[name]
    choice = ChoiceSettings(**{f"{key}_deg": value for key, value in presets.items()})
    ours, theirs = PublishedDirection(choice), text.Choice(**presets)
    compass, tilts = 0.0, 0
    for _ in range(300):
        compass += float(RNG.choice([RNG.normal(0.0, 0.1), RNG.normal(0.0, 1.2)]))
        cycle = random_cycle()
        by_tilt, by_waves, pitch, roll = text.heading_of_cycle(cycle.accel, compass % FULL)
        expected = theirs.take(compass % FULL, by_tilt, by_waves, pitch, roll)
        mean = cycle.accel.mean(axis=0)
        found = ours.take_cycle(cycle, (compass - text.plane_angle(mean)) % FULL)
        assert apart(found.compass, compass) < 1e-9
        assert apart(found.tilt_heading, by_tilt) < 1e-9
        assert apart(found.correlation_heading, by_waves) < 1e-9
        assert (found.used_tilt, found.is_turn) == expected[1:]
        assert apart(found.heading, expected[0]) < 1e-9
        tilts += found.used_tilt
    assert 20 < tilts < 280


def steps_of(samples: dict, settings: TravelDirectionSettings | None = None) -> list[Step]:
    """Feed {channel: (t, values)} in order of time."""
    travel = TravelDirection(settings or TravelDirectionSettings())
    order = ("gyro", "mag", "heading", "accel")
    events = sorted(
        (t, order.index(channel), v)
        for channel, (times, values) in samples.items()
        if channel in order
        for t, v in zip(times.tolist(), values.tolist(), strict=True)
    )
    steps = []
    for t, rank, v in events:
        step = travel.sample(t, order[rank], v if isinstance(v, list) else (v,))
        if step is not None:
            steps.append(step)
    return steps


def carried(w) -> dict:
    return {"accel": (w.t, w.accel), "gyro": (w.t, w.gyro), "mag": (w.t, w.mag)}


@pytest.mark.parametrize("pause_s", [10.0, 60.0])
def test_d1_the_compass_of_a_cycle_is_of_the_cycle(pause_s: float) -> None:
    """Stand facing 120 deg, set off facing 0 deg: claim 1, "in the current cycle"."""
    t = np.arange(0.0, pause_s + 12.0, 0.02)
    walking = t > pause_s + 0.5
    phase = FULL * 1.8 * (t - pause_s - 0.5)
    way = np.where(t < pause_s, math.radians(120.0), 0.0)
    accel = np.column_stack([0.0 * t, 0.8 * np.cos(phase + 1.7) * walking,
                             G + 1.5 * np.cos(phase) * walking])  # fmt: skip
    mag = 1e-6 * np.column_stack([-20.0 * np.sin(way), 20.0 * np.cos(way), 0.0 * t - 44.0])
    steps = steps_of({"accel": (t, accel), "mag": (t, mag)})
    assert len(steps) > 15
    for step in steps:
        assert apart(step.compass, 0.0) < math.radians(0.5)
        assert step.published is not None
        assert not step.published.is_turn


def test_d1_a_broken_cycle_leaves_nothing_behind() -> None:
    """A swing too slow for a step, facing east; then steps, facing north."""
    t = np.arange(0.0, 12.0, 0.02)
    slow = t < 4.0
    phase = np.where(slow, FULL * 0.5 * t, FULL * 1.8 * (t - 4.0))
    way = np.where(slow, math.radians(90.0), 0.0)
    accel = np.column_stack([0.0 * t, 0.8 * np.cos(phase + 1.7), G + 1.5 * np.cos(phase)])
    mag = 1e-6 * np.column_stack([-20.0 * np.sin(way), 20.0 * np.cos(way), 0.0 * t - 44.0])
    steps = [s for s in steps_of({"accel": (t, accel), "mag": (t, mag)}) if s.t > 4.7]
    assert steps
    assert max(apart(step.compass, 0.0) for step in steps) < math.radians(0.5)


def test_d1_a_magnetometer_that_falls_silent_is_not_quoted_for_long() -> None:
    w = walk(CARRYINGS[1], seconds=30.0, seed=4)
    heard = w.t < 15.0
    steps = steps_of({"accel": (w.t, w.accel), "mag": (w.t[heard], w.mag[heard])})
    assert all(step.compass is not None for step in steps if step.t < 15.0)
    assert all(step.compass is None for step in steps if step.t > 17.0)


@pytest.mark.parametrize("carrying", CARRYINGS, ids=lambda c: c.name)
def test_d2_a_terminal_that_reads_minus_g_upwards_says_so_and_is_understood(carrying) -> None:
    w = walk(carrying, seconds=40.0, seed=4)
    plain = steps_of(carried(w))
    turned = carried(w) | {"accel": (w.t, -w.accel)}
    found = steps_of(turned, TravelDirectionSettings(convention="gravity"))
    assert len(found) == len(plain) > 30
    for a, b in zip(plain, found, strict=True):
        assert apart(a.heading, b.heading) < 1e-9
        assert a.published is not None
        assert b.published is not None
        assert apart(a.published.heading, b.published.heading) < 1e-9


def test_d2_a_compass_that_counts_the_other_way_says_so_and_is_understood() -> None:
    """[0081]: angle - compass; a heading signal that counts counter-clockwise."""
    w = walk(CARRYINGS[1], seconds=40.0, seed=4)
    way = w.course
    plain = {"accel": (w.t, w.accel), "heading": (w.t, way % FULL)}
    other = plain | {"heading": (w.t, -way % FULL)}
    a = steps_of(plain)
    b = steps_of(other, TravelDirectionSettings(compass="counter_clockwise"))
    assert len(a) == len(b) > 30
    for one, two in zip(a, b, strict=True):
        assert apart(one.heading, two.heading) < 1e-9


# The terminal's attitude ------------------------------------------------------------------------

ANY_ANGLE = st.floats(-180.0, 180.0)
ATTITUDE = st.tuples(ANY_ANGLE, ANY_ANGLE, ANY_ANGLE)
HELD = [  # turns of the terminal about its x, y, z axes: screen up, face down, on edge, steep
    (0, 0, 0), (20, 15, 0), (35, 35, 0), (40, 50, 0), (0, 60, 0), (75, 75, 0), (200, 0, 0),
    (160, 0, 180), (180, 20, 70), (0, 90, 0), (0, -90, 10), (2, 88, 0), (80, 0, 0), (-80, 170, 0),
]  # fmt: skip
WAY = math.radians(30.0)


def held_walk(turns, declination: float = 0.0):
    """Steps of a walk to WAY by magnetometer and by heading signal, and the terminal's attitude.

    The attitude (terminal to east, north, up) is the only thing that force, field and heading are
    made from; nothing of them is of (3) to (5).
    """
    facing = Rotation.from_euler("z", -WAY)
    attitude = facing * Rotation.from_euler("XYZ", turns, degrees=True)
    t = np.arange(0.0, 4.0, 0.02)
    phase = FULL * 1.8 * t
    ahead = 0.8 * np.cos(phase + 1.7)
    force = np.column_stack([ahead * math.sin(WAY), ahead * math.cos(WAY), G + 1.5 * np.cos(phase)])
    accel = (t, attitude.inv().apply(force))
    earth = Rotation.from_euler("z", -declination).apply([0.0, 20e-6, -44e-6])
    mag = (t, np.tile(attitude.inv().apply(earth), (len(t), 1)))
    R = attitude.as_matrix()
    heading = (t, np.full(len(t), math.atan2(R[0, 1], R[1, 1]) % FULL))
    settings = TravelDirectionSettings(
        method="published", declination_deg=math.degrees(declination)
    )
    by_mag = steps_of({"accel": accel, "mag": mag}, settings)
    return R, by_mag, steps_of({"accel": accel, "heading": heading}, settings)


def headings_of_the_text(R) -> tuple[float, float]:
    """Compass and tilt heading by [0003], [0056], [0070], [0079], from the attitude alone."""
    compass = math.atan2(R[0, 1], R[1, 1])
    pitch, roll = math.asin(np.clip(R[2, 1], -1, 1)), math.asin(np.clip(R[2, 0], -1, 1))
    return compass, text.azimuth_first(text.angle_first(-pitch, -roll), compass)


def check_held_walk(turns, declination: float = 0.0) -> None:
    R, by_mag, by_heading = held_walk(turns, declination)
    compass, by_tilt = headings_of_the_text(R)
    upright = math.hypot(R[0, 1], R[1, 1])
    is_level = math.hypot(R[2, 0], R[2, 1]) < 0.05  # no edge is raised
    near = math.radians(0.2) / max(upright, 0.1)  # a cycle's mean leans a little
    assert len(by_mag) == len(by_heading) >= 4
    for one, other in zip(by_mag[2:], by_heading[2:], strict=True):
        assert one.published is not None
        assert apart(one.published.correlation_heading, WAY) < math.radians(0.5)
        if upright < 0.09:
            assert one.compass is other.compass is other.heading is None
            assert one.published.tilt_heading is None
            assert apart(one.heading, WAY) < math.radians(0.5)
        elif upright > 0.11:
            assert other.published is not None
            for step in (one, other):
                assert apart(step.compass, compass) < near
                assert apart(step.published.correlation_heading, WAY) < math.radians(0.5) + near
                assert not step.published.is_turn
                if not is_level:
                    assert apart(step.published.tilt_heading, by_tilt) < 20.0 * near
            assert one.published.used_tilt == other.published.used_tilt


@pytest.mark.parametrize("turns", HELD)
def test_n1_magnetometer_and_heading_signal_mean_the_same_however_it_is_held(turns) -> None:
    check_held_walk(turns)
    check_held_walk(turns, declination=0.2)


@settings(max_examples=60, deadline=None)
@given(ATTITUDE)
def test_n1_at_every_attitude(turns) -> None:
    check_held_walk(turns)


@pytest.mark.parametrize(
    ("turns", "raised_deg"),
    [((200, 0, 0), 30), ((160, 0, 180), 210), ((20, 0, 0), 30), ((0, 90, 0), 300)],
)
def test_0066_the_tilt_heading_is_that_of_the_raised_edge(turns, raised_deg: float) -> None:
    """Face down too, where the lean is not to the side. By what is up in the attitude."""
    R, by_mag, by_heading = held_walk(turns)
    edges = [sign * R[:, axis] for axis in (0, 1) for sign in (-1.0, 1.0)]
    up = max(edges, key=lambda edge: edge[2])
    if math.hypot(up[0], up[1]) > 0.1:
        assert math.degrees(math.atan2(up[0], up[1])) % 360.0 == pytest.approx(raised_deg)
    for step in (*by_mag[2:], *by_heading[2:]):
        assert step.published is not None
        assert apart(step.published.tilt_heading, math.radians(raised_deg)) < math.radians(1.0)


@pytest.mark.parametrize("roll", [35.0, 85.0, 95.0, 145.0])
def test_0070_as_printed_means_the_lowered_edge_face_down(roll: float) -> None:
    """[0066] says the raised one, which from 90 deg on points the other way.

    As printed the heading does not jump where a terminal that stands on edge leans back and forth.
    """
    R, by_mag, by_heading = held_walk((0.0, roll, 0.0))
    up = -R[:, 0]
    assert up[2] > 0.0
    raised = math.degrees(math.atan2(up[0], up[1])) % 360.0
    assert raised == pytest.approx(300.0 if roll < 90.0 else 120.0)
    for step in (*by_mag[2:], *by_heading[2:]):
        assert step.published is not None
        assert apart(step.published.tilt_heading, math.radians(300.0)) < math.radians(1.0)


@pytest.mark.parametrize("lean", [90.0, -90.0, 87.0])
def test_an_upper_edge_that_points_up_has_no_heading_and_none_is_made_up(lean: float) -> None:
    _, by_mag, by_heading = held_walk((lean, 0.0, 0.0))
    for one, other in zip(by_mag[2:], by_heading[2:], strict=True):
        assert one.compass is other.compass is other.published is other.heading is None
        assert apart(one.heading, WAY) < math.radians(0.5)  # the waves need no upper edge


def test_a_change_of_lean_alone_does_not_turn_the_compass() -> None:
    """(30, 20) to (40, 75), its upper edge facing north throughout."""
    found = []
    for turns in ((30, 20, 0), (40, 75, 0)):
        R, by_mag, _ = held_walk(turns)
        compass = by_mag[-1].compass
        assert compass is not None
        found.append(compass - math.atan2(R[0, 1], R[1, 1]))
    assert apart(*found) < math.radians(1.0)


# Measured ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_ped_ethz_every_step_is_the_texts() -> None:
    """867 cycles: headings, choice and turns of a chain of its own on the package's cycles."""
    samples = recording("ped_ethz")
    travel = TravelDirection(TravelDirectionSettings())
    cycles: list[StepCycle] = []
    keep = travel.published.take_cycle

    def taken(cycle: StepCycle, level: float):
        cycles.append(cycle)
        return keep(cycle, level)

    travel.published.take_cycle = taken  # type: ignore[method-assign]
    steps = []
    order = ("gyro", "mag", "accel")
    events = sorted(
        (t, order.index(c), v)
        for c in order
        for t, v in zip(*(column.tolist() for column in samples[c]), strict=True)
    )
    for t, rank, v in events:
        step = travel.sample(t, order[rank], v)
        if step is not None:
            steps.append(step)
    assert len(steps) == len(cycles) == 867
    t_mag, field = samples["mag"]
    theirs, choices = text.Choice(), 0
    for step, cycle in zip(steps, cycles, strict=True):
        inside = (t_mag >= cycle.t0) & (t_mag < cycle.t1)
        compass = text.compass_angle(field[inside].mean(axis=0), cycle.accel.mean(axis=0))
        assert apart(step.compass, compass) < 1e-9
        by_tilt, by_waves, pitch, roll = text.heading_of_cycle(cycle.accel, compass)
        heading, used_tilt, is_turn = theirs.take(compass, by_tilt, by_waves, pitch, roll)
        assert step.published is not None
        assert apart(step.published.tilt_heading, by_tilt) < 1e-9
        assert apart(step.published.correlation_heading, by_waves) < 1e-9
        assert (step.published.used_tilt, step.published.is_turn) == (used_tilt, is_turn)
        assert apart(step.published.heading, heading) < 1e-9
        choices += used_tilt
    assert 50 < choices < 817
    errors = against_gnss(steps)
    assert np.median(errors) < 40.0  # 36.7 when first measured; bounded by one cycle's sway
    assert np.percentile(errors, 90) < 100.0


def against_gnss(steps: list[Step]) -> np.ndarray:
    """Errors of the published heading [deg] where GNSS tells the course."""
    course = table("ped_ethz", "gnss_course.csv.gz")
    good = (course["speed_mps"] > 0.7) & (course["horizontal_accuracy_m"] < 12.0)
    times, angles = course["time_s"][good], np.radians(course["course_deg_from_north"][good])
    found = []
    for step in steps:
        i = int(np.searchsorted(times, step.t))
        if 0 < i < len(times) and times[i] - times[i - 1] <= 2.5 and step.published is not None:
            found.append(math.degrees(apart(step.published.heading, angles[i])))
    return np.array(found)
