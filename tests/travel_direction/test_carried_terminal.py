"""Simulated walks with truth: steps, both methods, and what goes wrong with terminals."""

from __future__ import annotations

import math

import numpy as np
import pytest

from gait import CARRYINGS, walk
from imucald.config.attitude import StepSettings, TravelDirectionSettings
from imucald.travel_direction.direction import TravelDirection, TravelState
from imucald.travel_direction.north import NorthFilter
from imucald.travel_direction.step_cycles import StepCycles

BY_NAME = {carrying.name: carrying for carrying in CARRYINGS}


def run(w, settings=None, gyro=True, mag=True, heading=None):
    travel = TravelDirection(settings or TravelDirectionSettings())
    steps = []
    for i, t in enumerate(w.t.tolist()):
        if gyro:
            travel.gyro(t, w.gyro[i].tolist())
        if mag:
            travel.mag(t, w.mag[i].tolist())
        if heading is not None:
            travel.heading(t, float(heading[i]))
        step = travel.accel(t, w.accel[i].tolist())
        if step is not None:
            steps.append(step)
    return travel, steps


def errors(w, steps, heading, after=15.0):
    found = []
    for step in steps:
        value = heading(step)
        if value is not None and step.t > after:
            middle = step.t - 0.5 * step.duration
            course = float(np.interp(middle, w.t, w.course))
            found.append(math.degrees(abs(math.remainder(value - course, 2.0 * math.pi))))
    return np.array(found)


@pytest.mark.parametrize("name", sorted(BY_NAME))
def test_steps_are_counted_however_it_is_carried(name):
    for speed, is_left in ((0.9, False), (1.7, True)):
        w = walk(BY_NAME[name], speed, is_left, seconds=50.0, seed=3)
        travel, _ = run(w)
        assert abs(travel.steps - w.steps) <= max(1, 0.03 * w.steps)


def test_nobody_walks_while_standing():
    rng = np.random.default_rng(1)
    cycles = StepCycles(StepSettings())
    for k in range(3000):
        x, y, z = (float(c) for c in rng.normal(0.0, 0.08, 3))
        cycles.add_sample(0.02 * k, (x, y + 3.0, z + 9.3))
    assert cycles.steps == 0


def test_steps_are_counted_without_a_gyroscope():
    w = walk(BY_NAME["in front, tilted"], 1.3, seconds=40.0, seed=5)
    travel, steps = run(w, gyro=False)
    assert abs(travel.steps - w.steps) <= max(1, 0.03 * w.steps)
    assert all(step.alternative is None for step in steps)
    assert all(step.heading == step.published.heading for step in steps)


@pytest.mark.parametrize("name", ["in front, flat", "sideways, tilted", "trouser pocket"])
@pytest.mark.parametrize("is_left", [False, True])
def test_the_alternative_finds_the_direction(name, is_left):
    w = walk(BY_NAME[name], 1.3, is_left, seconds=90.0, seed=2, disturbance_ut=1.0)
    _, steps = run(w)
    found = errors(w, steps, lambda step: step.alternative)
    assert np.median(found) < 15.0
    assert np.percentile(found, 90) < 35.0


@pytest.mark.parametrize("name", ["in front, flat", "trouser pocket"])
@pytest.mark.parametrize("seed", [2, 4])
def test_a_turn_while_time_stands_is_not_believed_away(name, seed):
    """The clock of the stamps is set back by 0.9 s while somebody turns round."""
    w = walk(BY_NAME[name], 1.3, seconds=90.0, seed=seed, disturbance_ut=1.0)
    course, span = np.unwrap(w.course), round(3.0 / (w.t[1] - w.t[0]))
    turn = np.abs(course[span:] - course[:-span]) * (w.t[:-span] > 30.0) * (w.t[:-span] < 65.0)
    back = w.t[int(np.argmax(turn))] + 1.0
    travel, stream, found = TravelDirection(TravelDirectionSettings()), 0.0, []
    for i, t in enumerate(w.t.tolist()):
        stream = max(stream, t - 0.9 if t >= back else t)  # as `runtime.timebase` has it
        travel.gyro(stream, w.gyro[i].tolist())
        travel.mag(stream, w.mag[i].tolist())
        step = travel.accel(stream, w.accel[i].tolist())
        if step is not None and step.alternative is not None and 2.0 < t - back < 15.0:
            true = float(np.interp(t - 0.5 * step.duration, w.t, w.course))
            found.append(abs(math.remainder(step.alternative - true, 2.0 * math.pi)))
    assert turn.max() > math.radians(150.0)
    assert math.degrees(np.median(found)) < 25.0


def test_the_published_method_finds_a_terminal_held_towards_the_face():
    w = walk(BY_NAME["in front, tilted"], 1.2, seconds=60.0, seed=4, hard_iron_ut=0.0,
             disturbance_ut=0.5)  # fmt: skip
    _, steps = run(w)
    assert np.median(errors(w, steps, lambda step: step.published.tilt_heading)) < 8.0
    assert np.median(errors(w, steps, lambda step: step.published.heading)) < 20.0


def test_a_heading_signal_is_a_compass_too():
    w = walk(BY_NAME["in front, flat"], 1.3, seconds=60.0, seed=6)
    _, steps = run(w, mag=False, heading=w.course + 0.05)
    assert np.median(errors(w, steps, lambda step: step.alternative)) < 15.0
    assert np.median(errors(w, steps, lambda step: step.compass)) < 5.0


def test_without_a_compass_steps_are_counted_and_no_heading_is_made_up():
    w = walk(BY_NAME["in front, flat"], 1.3, seconds=20.0, seed=6)
    travel, steps = run(w, mag=False)
    assert steps
    assert all(step.heading is None for step in steps)
    assert travel.state(steps[-1].t + 0.1) is TravelState.NO_COMPASS


def test_the_state_shows_standing_walking_and_silence():
    w = walk(BY_NAME["in front, flat"], 1.3, seconds=20.0, seed=6)
    travel, steps = run(w)
    assert travel.state(steps[-1].t + 0.1) in (TravelState.WALKING, TravelState.TURNING)
    assert travel.state(float(w.t[-1])) is TravelState.STANDING
    assert travel.state(float(w.t[-1]) + 5.0) is TravelState.NOT_AVAILABLE


def test_the_method_of_the_settings_is_sent():
    w = walk(BY_NAME["in front, flat"], 1.3, seconds=20.0, seed=6)
    for method in ("alternative", "published"):
        _, steps = run(w, TravelDirectionSettings(method=method))
        last = steps[-1]
        expected = last.alternative if method == "alternative" else last.published.heading
        assert last.heading == expected


def test_declination_turns_every_heading():
    w = walk(BY_NAME["in front, flat"], 1.3, seconds=20.0, seed=6)
    plain = run(w)[1][-1]
    turned = run(w, TravelDirectionSettings(declination_deg=math.degrees(0.1)))[1][-1]
    for name in ("compass", "alternative"):
        change = math.remainder(getattr(turned, name) - getattr(plain, name), 2.0 * math.pi)
        assert change == pytest.approx(0.1, abs=1e-9)


def test_a_gap_begins_anew():
    w = walk(BY_NAME["in front, flat"], 1.3, seconds=20.0, seed=6)
    travel, _ = run(w)
    counted = travel.steps
    travel.gap()
    assert travel.steps == counted
    assert travel.last is None


def test_hard_iron_is_distinguished_from_the_earths_field():
    """A terminal that turns once: the field goes round, the iron does not."""
    north = NorthFilter()
    iron = np.array([8.0, -12.0, 5.0]) * 1e-6
    for k in range(3000):
        t = 0.02 * k
        angle = 0.15 * t
        s, c = math.sin(angle), math.cos(angle)
        # terminal to level: turned to the left by the angle; the field is in P's y, and down
        level = (c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
        field = np.array([s * 20e-6, c * 20e-6, -45e-6]) + iron
        north.add_field(t, tuple(field.tolist()), level)
    assert 1e-6 * north.x[0:2] == pytest.approx(iron[:2], abs=1e-6)
    assert north.yaw == pytest.approx(0.0, abs=0.05)


def test_steps_survive_damaged_samples():
    cycles = StepCycles(StepSettings())
    for k, value in enumerate([0.0, 1e9, -1e9, 0.0, 5.0] * 100):
        cycles.add_sample(0.02 * k, (value, 0.0, 0.0))
    cycles.add_sample(1.0, (0.0, 0.0, 9.8))  # older than the last
    assert cycles.steps >= 0
