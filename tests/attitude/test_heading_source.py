"""A source of heading that goes wrong in mid-drive, beside a gyroscope that does not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from test_attitude_filter import DEG, RATE, Motion, settings

from imucald.attitude.estimate import AttitudeState
from imucald.attitude.filter import AttitudeFilter
from imucald.attitude.heading_source import AGREES_FOR, LOST_AFTER, HeadingSource, Verdict

FULL = AttitudeState.FULL
BROKEN = 60.0
SECONDS = 260.0


def town(t):
    """Bends to both sides of up to 150 deg, from the 10th second on."""
    moving = np.clip(t - 10.0, 0.0, None)
    yaw = 1.3 * np.sin(0.11 * moving) + 0.9 * np.sin(0.043 * moving)
    return Rotation.from_euler("ZYX", np.column_stack([yaw, 0.0 * t, 0.0 * t]))


def speed(t):
    return 10.0 * (1.0 - np.exp(-np.clip(t - 10.0, 0.0, None) / 4.0))


@pytest.fixture(scope="module")
def motion():
    return Motion(town, speed, SECONDS)


def true_heading(motion):
    """Clockwise from north [rad]."""
    return -Rotation.as_euler(motion.R, "ZYX")[:, 0]


def drive(motion, source, noise=1.0 * DEG):
    """Times, states, heading errors and deviations [rad], one a sample from the 20th second on.

    source: of time and true heading, what the source says.
    """
    truth = true_heading(motion)
    rng = np.random.default_rng(7)

    def heading(attitude, i, t):
        if i % 25 == 0:
            attitude.heading(t, float(source(t, truth[i]) + rng.normal(0.0, noise)))

    found = motion.feed(AttitudeFilter(settings(heading="signal")), extra=heading)
    kept = [(t, e, truth[i]) for i, (t, e) in enumerate(zip(motion.t, found, strict=True))
            if e is not None and t > 20.0]  # fmt: skip
    errors = [math.remainder(e.heading - true, 2.0 * math.pi) for _, e, true in kept]
    return (
        np.array([t for t, _, _ in kept]),
        np.array([e.state is FULL for _, e, _ in kept]),
        np.abs(errors),
        np.array([e.std[2] for _, e, _ in kept]),
    )


def frozen_at(motion, t):
    return float(true_heading(motion)[round(t * RATE)])


def test_a_sound_source_is_followed_throughout(motion):
    _, is_full, errors, std = drive(motion, lambda _, true: true)
    assert is_full.all()
    assert (errors < 3.0 * std + 0.1 * DEG).all()


@pytest.mark.parametrize("kind", ["frozen", "mirrored", "wandering", "of a third"])
def test_what_no_vehicle_does_is_never_followed_and_soon_doubted(motion, kind):
    at_break = frozen_at(motion, BROKEN)
    wrong = {
        "frozen": lambda _t, _true: at_break,
        "mirrored": lambda _t, true: -true,
        "wandering": lambda t, true: true + 1.5 * math.sin(0.05 * (t - BROKEN)),
        "of a third": lambda _t, true: true / 3.0,
    }[kind]
    t, is_full, errors, std = drive(motion, lambda t, x: x if t < BROKEN else wrong(t, x))
    assert errors.max() < 3.0 * DEG, "the gyroscope is right"
    assert not is_full[t > BROKEN + 40.0].any()
    assert (errors < 4.0 * std + 1.0 * DEG).all()


@pytest.mark.parametrize("back", [math.inf, 140.0])
def test_a_jump_leaves_the_heading_in_doubt_until_the_source_is_back(motion, back):
    """Both norths were proved over turns: one is wrong, and nothing shows which."""
    jump, broken = math.radians(60.0), 100.0
    t, is_full, errors, std = drive(motion, lambda t, x: x + jump * (broken < t < back))
    assert errors.max() < 3.0 * DEG
    early = t < broken + LOST_AFTER
    assert is_full[early].all(), "an outlier or two are none of the heading's business"
    doubted = (t > broken + LOST_AFTER + 1.0) & (t < min(back, SECONDS) + AGREES_FOR)
    assert not is_full[doubted].any()
    assert (std[doubted] >= jump - 5.0 * DEG).all(), "either may be right"
    assert is_full[-1] == (back < SECONDS)


@pytest.mark.parametrize("drift", [0.02, 0.05, 0.1, 0.3])
def test_a_source_that_drifts_makes_no_wrong_heading_good(motion, drift):
    """Its headings are not independent: else the gyroscope would seem to drift the other way."""

    def source(t, true):
        return true + drift * DEG * max(t - BROKEN, 0.0)

    _, is_full, errors, std = drive(motion, source)
    assert not (is_full & (errors > 4.0 * std)).any()
    if drift * (SECONDS - BROKEN) > 20.0:
        assert not is_full[-1]


def test_a_wrong_first_heading_is_left_where_the_source_has_proved_itself(motion):
    """An inertial navigation system is of no use before it is aligned."""
    t, is_full, errors, std = drive(motion, lambda t, true: true if t > 30.0 else 2.0)
    assert not (is_full & (errors > 4.0 * std + 1.0 * DEG))[t > 40.0].any()
    assert is_full[-1]
    assert errors[-1] < 1.0 * DEG


def test_outliers_are_left_out_and_nothing_else_changes(motion):
    def source(t, true):
        return true + (1.2 if int(t) % 10 == 7 else 0.0)

    _, is_full, errors, _ = drive(motion, source)
    assert is_full.all()
    assert errors.max() < 1.0 * DEG


@pytest.mark.parametrize("late", [0.0, 2.0])
def test_a_first_heading_turns_what_is_known_along(motion, late):
    """Roll and pitch are the same whatever north is."""

    def drive_with(offset):
        truth = true_heading(motion)

        def heading(attitude, i, t):
            if t > 120.0 and i % 25 == 0:
                attitude.heading(t, float(truth[i] + offset))

        bias = (0.0, 0.0, 0.0)
        attitude = AttitudeFilter(settings(heading="signal"))
        motion.accel += (0.1, -0.15, 0.0)
        try:
            return motion.feed(attitude, bias, extra=heading)[-1]
        finally:
            motion.accel -= (0.1, -0.15, 0.0)

    e, other = drive_with(late), drive_with(late + 2.0)
    assert (e.roll, e.pitch) == pytest.approx((other.roll, other.pitch), abs=1e-4 * DEG)
    assert e.std[:2] == pytest.approx(other.std[:2], rel=1e-4)


def test_headings_far_apart_prove_no_turn():
    source = HeadingSource(4.0)
    verdicts = {source.judge_heading(15.0 * k, 1.0, 1e-4, 1e-3, 0.3 * k) for k in range(1, 200)}
    assert verdicts == {Verdict.REFUSED}
    assert not source.doubt, "each may be an outlier"


@pytest.mark.parametrize("late", [0.5, 1.0, 1.5])
def test_a_source_that_is_late_is_followed_and_draws_nothing(motion, late):
    truth = true_heading(motion)

    def source(t, _true):
        return truth[max(round((t - late) * RATE), 0)]

    _, is_full, errors, std = drive(motion, source)
    assert is_full.all()
    assert (errors < 2.0 * std).all()


def test_a_north_that_was_refused_is_none_after_a_silence_of_the_gyroscope(motion):
    truth, broken, silent = true_heading(motion), 100.0, 150.0
    attitude = AttitudeFilter(settings(heading="signal"))
    for i, t in enumerate(motion.t.tolist()):
        if i % 5 == 0:
            attitude.speed(t, float(motion.v[i]))
        if not silent < t < silent + 1.5:
            attitude.gyro(t, motion.gyro[i].tolist())
        if i % 25 == 0:
            attitude.heading(t, float(truth[i] + math.radians(60.0) * (t > broken)))
        attitude.accel(t, motion.accel[i].tolist())
        if t > broken + 10.0:
            assert attitude.state(t) is not FULL
    assert attitude.state() is AttitudeState.RELATIVE_HEADING
