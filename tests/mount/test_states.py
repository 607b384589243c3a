"""States, reasons, and the test for a moved sensor."""

from __future__ import annotations

import math

import numpy as np
import pytest
from msgspec.structs import replace

from imucald.config.calibration import CalibrationSettings, StateLimits
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import Missing, MountState
from imucald.mount.estimator import FullEstimator
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.road_segments import ScoreSeries
from imucald.mount.shift import NO_STEPS, UNEVEN_STD, largest_change
from imucald.mount.states import (
    SLACK,
    YOUNG_SLACK,
    Manoeuvres,
    MountKnowledge,
    judged,
    targets_in_force,
    waiting_for,
)
from imucald.simulation import random_model, simulate
from mount_settings import full

SETTINGS = EstimatorSettings()
DEG = math.radians(1.0)


def known(yaw_deg: float, tilt_deg: float = 0.3, straight: int = 5) -> MountKnowledge:
    std = (tilt_deg * DEG, tilt_deg * DEG, yaw_deg * DEG)
    return MountKnowledge(gravity=True, std=std, straight=straight, lefts=2, rights=2)


def test_states_by_standard_deviation():
    waiting = MountState.WAITING
    assert judged(MountKnowledge(), waiting, SETTINGS) == MountState.WAITING
    assert judged(known(5.0), waiting, SETTINGS) == MountState.LEVELLED
    assert judged(known(0.9), waiting, SETTINGS) == MountState.USABLE
    assert judged(known(0.2), waiting, SETTINGS) == MountState.FINE
    assert judged(known(0.2, tilt_deg=5.0), waiting, SETTINGS) == MountState.LEVELLED


def test_a_small_standard_deviation_without_manoeuvres_is_not_believed():
    assert judged(known(0.2, straight=2), MountState.LEVELLED, SETTINGS) == MountState.LEVELLED


@pytest.mark.parametrize(
    ("state", "limit", "slack"),
    [
        (MountState.USABLE, SETTINGS.limits.usable_yaw, YOUNG_SLACK),
        (MountState.FINE, SETTINGS.limits.fine_yaw, SLACK),
    ],
)
def test_a_state_is_left_only_well_beyond_its_limit(state, limit, slack):
    just_over = known(math.degrees(limit) * (slack - 0.05))
    assert judged(just_over, MountState.LEVELLED, SETTINGS) != state
    assert judged(just_over, state, SETTINGS) == state
    assert judged(known(math.degrees(limit) * (slack + 0.05)), state, SETTINGS) != state


def test_beside_past_drives_a_deviation_grows_by_contradiction():
    wide = known(math.degrees(SETTINGS.limits.usable_yaw) * (SLACK + 0.05))
    assert judged(wide, MountState.USABLE, SETTINGS) == MountState.USABLE
    assert judged(replace(wide, has_past=True), MountState.USABLE, SETTINGS) < MountState.USABLE


def test_more_driving_is_the_reason_for_yaw_until_it_has_not_helped_for_long():
    usable = replace(known(0.4), yaw_seen=0.05 * DEG, cross_axis=0.008)
    text, code = waiting_for(usable, SETTINGS)["yaw"]
    assert text == "more driving (up axis ±0.8 deg, fine below ±0.6 deg)"
    assert code == Missing.MORE_DRIVING
    text, code = waiting_for(replace(usable, driven_s=2000.0), SETTINGS)["yaw"]
    assert "axes seem 0.8 % mixed" in text
    assert "accelerometer_bias" in text
    assert code == Missing.OTHER
    levelled = replace(known(1.6), yaw_seen=0.2 * DEG, cross_axis=0.04, driven_s=2000.0)
    text, code = waiting_for(levelled, SETTINGS)["yaw"]
    assert "axes seem 4.0 % mixed" in text
    assert code is Missing.OTHER
    still = replace(levelled, std=known(0.4).std, yaw_seen=0.4 * DEG)
    assert waiting_for(still, SETTINGS)["yaw"][0].startswith("more driving (up axis")


def test_where_no_signal_shows_turns_that_is_the_reason_for_roll():
    tilted = replace(known(0.4), std=(5.0 * DEG, 0.1 * DEG, 0.1 * DEG), turning=False)
    assert waiting_for(tilted, SETTINGS)["roll"][0].startswith("a gyroscope, a yaw rate or")


def test_what_no_driving_shows_of_yaw_may_be_more_than_the_limit():
    """The limit would choose mounts whose seen errors are small by chance, whatever the unseen."""
    hidden = replace(known(2.7), yaw_seen=0.2 * DEG, cross_axis=0.04)
    levelled, usable = MountState.LEVELLED, MountState.USABLE
    assert judged(hidden, levelled, SETTINGS) == usable
    assert judged(replace(hidden, std=known(2.9).std), levelled, SETTINGS) == levelled
    assert judged(replace(hidden, std=known(3.8).std), usable, SETTINGS) == usable
    assert judged(replace(hidden, std=known(4.0).std), usable, SETTINGS) == levelled
    assert judged(replace(hidden, yaw_seen=0.4 * DEG), levelled, SETTINGS) == levelled
    assert judged(replace(hidden, cross_axis=0.01), levelled, SETTINGS) == levelled
    with_past = replace(hidden, has_past=True)  # it joins in mid-drive, and ends no good state
    assert judged(with_past, levelled, SETTINGS) == usable
    assert judged(replace(with_past, std=known(3.8).std), usable, SETTINGS) == usable
    stated = EstimatorSettings(CalibrationSettings(states=StateLimits(usable_yaw_deg=1.0)))
    assert judged(hidden, levelled, stated) == levelled


@pytest.mark.parametrize(
    ("cross_axis", "stated", "degrees"), [(0.04, None, 2.8), (0.01, None, 1.0), (0.04, 1.0, 1.0)]
)
def test_the_target_of_yaw_is_the_limit_that_is_in_force(cross_axis, stated, degrees):
    settings = EstimatorSettings(CalibrationSettings(states=StateLimits(usable_yaw_deg=stated)))
    levelled = MountState.LEVELLED
    for yaw, state in ((0.99 * degrees, MountState.USABLE), (1.01 * degrees, levelled)):
        found = replace(known(yaw), yaw_seen=0.2 * DEG, cross_axis=cross_axis)
        assert judged(found, levelled, settings) == state
        targets = targets_in_force(found, levelled, settings)
        assert math.degrees(targets.usable[2]) == pytest.approx(degrees)
        assert targets.usable[:2] == settings.targets.usable[:2]
        assert targets.fine == settings.targets.fine


def test_the_target_in_force_stands_in_the_estimate():
    estimator = FullEstimator(full())
    usual = estimator.estimate().targets
    estimator._known = replace(known(2.7), yaw_seen=0.2 * DEG, cross_axis=0.04)
    estimator.gap()  # what was estimated is made anew
    now = estimator.estimate().targets
    assert now.usable[2] == pytest.approx(2.8 * usual.usable[2])
    assert now.fine == usual.fine


def test_a_cross_axis_error_that_becomes_less_ends_no_good_state():
    limit = SETTINGS.limits.usable_yaw
    hidden = replace(known(3.4), yaw_seen=0.2 * DEG, cross_axis=1.03 * limit)
    less = replace(hidden, cross_axis=0.97 * limit)
    levelled, usable = MountState.LEVELLED, MountState.USABLE
    assert judged(hidden, usable, SETTINGS) == usable
    assert judged(less, usable, SETTINGS) == usable
    assert judged(replace(less, std=known(2.7).std), levelled, SETTINGS) == levelled
    assert judged(replace(hidden, cross_axis=limit / SLACK * 0.99), usable, SETTINGS) == levelled


def test_one_reason_per_angle():
    reasons = waiting_for(known(3.0, tilt_deg=1.0, straight=1), SETTINGS)
    assert reasons["yaw"] == (
        "acceleration or braking above 1 m/s2 (1 of 3 seen)",
        Missing.ACCELERATION,
    )
    assert reasons["pitch"][1] == Missing.ACCELERATION
    assert reasons["roll"][1] == Missing.TURNS
    assert waiting_for(known(0.1), SETTINGS) == {}


def test_the_missing_side_of_turns_is_named():
    base = known(3.0, tilt_deg=1.0)
    only_right = MountKnowledge(True, base.std, 5, lefts=0, rights=3)
    only_left = MountKnowledge(True, base.std, 5, lefts=3, rights=0)
    assert waiting_for(only_right, SETTINGS)["roll"] == ("left turns (none yet)", Missing.LEFT_TURN)
    assert waiting_for(only_left, SETTINGS)["roll"] == (
        "right turns (none yet)",
        Missing.RIGHT_TURN,
    )


def test_what_is_absent_comes_first():
    assert (
        waiting_for(MountKnowledge(accelerometer=False), SETTINGS)["yaw"][1]
        == Missing.ACCELEROMETER
    )
    assert waiting_for(MountKnowledge(frozen=True), SETTINGS)["roll"][1] == Missing.LEARNING_FROZEN
    silent = MountKnowledge(True, (0.001, 0.001, math.inf), speed=False)
    assert waiting_for(silent, SETTINGS)["yaw"][1] == Missing.SPEED


def test_manoeuvres_are_counted_once_each():
    driven = Manoeuvres()
    push = np.zeros(100)
    push[10:30] = 1.5  # a launch
    push[15] = 0.9  # with a gear change in it
    push[50:53] = 1.5  # a bump
    push[60:80] = -2.0  # a braking
    turn = np.zeros(100)
    turn[40:60] = 1.0
    driven.add(push, turn)
    assert (driven.straight, driven.lefts, driven.rights) == (2, 1, 0)


def test_a_manoeuvre_over_the_edge_of_two_hops_counts_once():
    driven = Manoeuvres()
    driven.add(np.concatenate([np.zeros(29), np.full(3, 1.5)]), np.zeros(32))
    driven.add(np.concatenate([np.full(10, 1.5), np.zeros(22)]), np.zeros(32))
    assert driven.straight == 1


def flow(kind: str, values: np.ndarray, std: float) -> ScoreSeries:
    information = np.full(len(values), 1.0 / std**2)
    return ScoreSeries(kind, information * values, information)


def drawn(seed: int, std: float = 0.4 * DEG, n: int = 40) -> list[ScoreSeries]:
    """All sources, without a shift."""
    rng = np.random.default_rng(seed)
    return [flow(kind, std * rng.standard_normal(n), std) for kind in UNEVEN_STD]


def with_change(
    series: list[ScoreSeries], changes: dict[str, float], segments: int
) -> list[ScoreSeries]:
    """The same with a change of some sources [rad] in the last segments."""
    out = []
    for f in series:
        score = f.score.copy()
        score[-segments:] += f.information[-segments:] * changes.get(f.kind, 0.0)
        out.append(ScoreSeries(f.kind, score, f.information))
    return out


def excess(series: list[ScoreSeries], steps: np.ndarray = NO_STEPS) -> float:
    change = largest_change(series, steps=steps)
    assert change is not None
    return change.excess


@pytest.mark.parametrize(("angle", "degrees"), [("roll", 1.6), ("pitch", -1.6), ("yaw", 1.6)])
def test_a_change_is_found_on_its_axis_with_its_size(angle, degrees):
    changes = {kind: degrees * DEG for kind in UNEVEN_STD if kind.startswith(angle)}
    change = largest_change(with_change(drawn(1), changes, 6))
    assert change is not None
    assert change.excess > 1.0
    assert change.axis == ("roll", "pitch", "yaw").index(angle)
    assert change.size == pytest.approx(degrees * DEG, rel=0.3)
    assert 4 <= change.segments <= 8


@pytest.mark.parametrize(("angle", "axis"), [("roll", 0), ("pitch", 1)])
def test_on_rough_roads_a_change_has_to_be_larger(angle, axis):
    changes = {kind: 1.6 * DEG for kind in UNEVEN_STD if kind.startswith(angle)}
    series = with_change(drawn(1), changes, 6)
    rough = largest_change(series, (axis,), unevenness=(3.0, 3.0))
    usual, other = largest_change(series, (axis,)), (3.0, 1.0) if axis else (1.0, 3.0)
    assert rough is not None
    assert usual is not None
    assert rough.excess < 0.8 * usual.excess
    assert largest_change(series, (axis,), unevenness=other) == usual


def test_noise_alone_is_no_shift():
    assert sum(excess(drawn(seed)) >= 1.0 for seed in range(200)) <= 1


def test_one_wild_piece_is_no_shift():
    assert excess(with_change(drawn(2), {"yaw_dvdt": 20.0 * DEG}, 1)) < 1.0


def test_in_yaw_two_sources_that_agree_say_more_than_one_that_stands_out_as_far():
    """Wind moves dv/dt alone: what is a shift in both sources is none in one."""
    both = {"yaw_turn": 0.8 * DEG, "yaw_dvdt": 0.8 * DEG}
    for seed in range(10):
        agreed = excess(with_change(drawn(seed), both, 10))
        assert agreed > 1.0
        for kind in both:
            alone = {kind: 0.8 * 2.0**0.5 * DEG}
            assert excess(with_change(drawn(seed), alone, 10)) < 0.7 * agreed


def test_sources_of_yaw_that_contradict_one_another_show_no_shift():
    apart = {"yaw_turn": 0.8 * DEG, "yaw_dvdt": -0.8 * DEG}
    assert excess(with_change(drawn(3), apart, 10)) < 1.0


def test_a_large_change_of_yaw_in_one_source_is_a_shift_after_all():
    """On a straight road nothing else speaks."""
    series = with_change(drawn(4), {"yaw_dvdt": 3.0 * DEG}, 6)
    for f in series:
        if f.kind == "yaw_turn":
            f.score[-6:] = f.information[-6:] = 0.0
    assert excess(series) > 1.0


@pytest.mark.parametrize("axis", [0, 1])
def test_a_step_in_gravity_of_the_same_sign_speaks_for_a_change_of_roll_or_pitch(axis):
    """What is too small for a shift is one with a step, but not with one the other way."""
    angle = ("roll", "pitch")[axis]
    changes = {kind: 1.0 * DEG for kind in UNEVEN_STD if kind.startswith(angle)}
    series = with_change([f for f in drawn(5) if f.axis == axis], changes, 6)
    steps = {sign: NO_STEPS.copy() for sign in (1, -1)}
    steps[1][:, axis, 0] = 5.0
    steps[-1][:, axis, 1] = -5.0
    assert 0.3 < excess(series) < 1.0
    assert excess(series, steps[1]) > 1.0
    assert excess(series, steps[-1]) == excess(series)
    steps[1] = np.roll(steps[1], 1, axis=1)
    assert excess(series, steps[1]) == excess(series), "a step about the other axis"


def test_a_step_in_gravity_alone_is_no_change():
    steps = NO_STEPS.copy()
    steps[:, :, 0] = 9.0
    for seed in range(20):
        quiet = [f for f in drawn(seed, 0.2 * DEG) if f.axis < 2]
        assert excess(quiet, steps) < 1.0


def test_too_little_before_says_nothing():
    assert largest_change([flow("yaw_turn", np.zeros(4), DEG)]) is None


@pytest.mark.slow
def test_a_moved_sensor_is_suspect_then_found_again():
    seed, start = 77, 420.0
    shift = {"t_s": start, "yaw_deg": 5.0}
    model = random_model(seed, standing_first=True).with_changes({"mount.shifts": [shift]})
    made = simulate(model, seed, 14.0)
    estimator = FullEstimator(full())
    states: list[tuple[float, MountState]] = []
    served = None
    for row in ticks_from_samples(made.samples, 0, 8400).tolist():
        estimator.step(row)
        if not states or estimator.state != states[-1][1]:
            states.append((row[0], estimator.state))
        if estimator.state in {MountState.SUSPECT, MountState.RECALIBRATING}:
            assert estimator.correction is not None  # the last good one is still served
            if served is not None:
                R, last = (c.matrix() for c in (estimator.correction, served))
                assert np.abs(R - last).max() < 0.002
        served = estimator.correction
    suspect = [t for t, state in states if state == MountState.SUSPECT]
    assert len(suspect) == 1
    assert start < suspect[0] < start + 120.0
    assert states[-1][1] in {MountState.USABLE, MountState.FINE}
    (shift_found,) = estimator.estimate().details["shifts"]
    assert shift_found["angle"] == "yaw"
    assert abs(abs(shift_found["size_deg"]) - 5.0) < 2.0
    x, y, z = shift_found["turn_deg"]
    assert abs(abs(z) - 5.0) < 1.0
    assert math.copysign(1.0, z) == math.copysign(1.0, shift_found["size_deg"])
    assert max(abs(x), abs(y)) < 1.5
    R = estimator.estimate().R_vehicle_from_sensor
    assert R is not None
    apart = np.degrees(np.abs(made.truth.R_vehicle_from_sensor() - R).max())
    assert apart < 1.5
