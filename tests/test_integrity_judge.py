"""The judge of integrity: known series give known seconds, known edits give known samples."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from benchmarks.integrity import __main__ as command
from benchmarks.integrity import faults
from benchmarks.integrity.bases import Base, measured
from benchmarks.integrity.bus import configuration, frames
from benchmarks.integrity.cases import QUICK, ROWS, Case, cases, put
from benchmarks.integrity.diagram import diagram
from benchmarks.integrity.force import ENTRIES, Response, left_over
from benchmarks.integrity.force import misleading as beyond_limits
from benchmarks.integrity.judge import (
    Allowed,
    Seconds,
    coverage,
    judged,
    lost_again,
    misleading,
    points,
    until_told,
)
from benchmarks.integrity.outcome import rows
from benchmarks.integrity.page import report, written
from benchmarks.integrity.sent import sent
from benchmarks.measured import DATA
from benchmarks.mount_accuracy.drives import FULL

from imucald.can.logs.log_reader import LogReader
from imucald.core.rotations import rotation_from_vector, vector_from_rotation
from imucald.core.samples import Series
from imucald.inputs.wiring import compile_router
from imucald.mount.estimate import HOUSING, Correction
from imucald.runtime.estimators import estimator_for
from imucald.runtime.pipeline import Pipeline
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine, open_config
from imucald.simulation import random_model, simulate
from imucald.simulation.imu import gain_matrix

AT_ONCE = Allowed()
SEED = 650_000


def series(n=100, **changed):
    """n seconds of driving, all good, without error, 0.1 deg stated."""
    sound = Seconds(
        moving=np.ones(n, dtype=bool),
        good=np.ones(n),
        is_fine=np.zeros(n, dtype=bool),
        error=np.zeros((n, 3)),
        beyond_crown=np.zeros(n),
        std=np.full((n, 3), 0.1),
        reference_std=np.zeros(3),
        wrong=np.zeros(n),
    )
    return replace(sound, **changed)


def yaw_off(degrees, first, stop, n=100):
    error = np.zeros((n, 3))
    error[first:stop, 2] = degrees
    return error


# misleading ------------------------------------------------------------------------------------


def test_seconds_beyond_the_alert_limit_are_misleading_while_they_are_sent_as_good():
    good = np.ones(100)
    good[62:] = 0.0
    verdict = judged(series(error=yaw_off(2.0, 50, 100), good=good), 40.0, AT_ONCE)
    assert verdict.misleading == 12.0
    assert verdict.alert.clock == 12.0
    assert not verdict.at_end
    assert verdict.good == 22.0


def test_what_was_wrong_before_the_fault_is_not_the_faults():
    verdict = judged(series(error=yaw_off(2.0, 10, 30)), 40.0, AT_ONCE)
    assert verdict.misleading == 0.0
    assert verdict.alert.clock == 0.0


def test_an_error_within_four_stated_deviations_is_not_misleading():
    error = yaw_off(2.0, 50, 100)
    assert misleading(series(error=error, std=np.full((100, 3), 0.51))).sum() == 0.0
    assert misleading(series(error=error, std=np.full((100, 3), 0.49))).sum() == 50.0


def test_an_error_within_one_degree_is_not_misleading_however_small_the_deviation():
    assert misleading(series(error=yaw_off(0.99, 0, 100))).sum() == 0.0
    assert misleading(series(error=yaw_off(1.01, 0, 100))).sum() == 100.0


def test_roll_is_held_against_the_road_that_it_drove():
    error = np.zeros((100, 3))
    error[:, 0] = 1.5  # the road leans so
    assert misleading(series(error=error)).sum() == 0.0
    assert misleading(series(beyond_crown=error[:, 0])).sum() == 100.0


def test_what_the_reference_may_be_off_widens_the_limit():
    error = yaw_off(1.5, 0, 100)
    assert misleading(series(error=error, reference_std=np.full(3, 0.6))).sum() == 0.0


def test_an_angle_without_truth_misleads_nobody():
    assert misleading(series(error=np.full((100, 3), np.nan))).sum() == 0.0


def test_wrong_values_count_by_their_share_of_the_frames():
    wrong = np.zeros(100)
    wrong[60], wrong[61] = 0.25, 1.0
    assert judged(series(wrong=wrong), 60.0, AT_ONCE).misleading == 1.25


# time to alert ---------------------------------------------------------------------------------


def test_time_to_alert_by_driving_leaves_out_standing():
    good = np.ones(100)
    good[80:] = 0.0
    moving = np.ones(100, dtype=bool)
    moving[55:70] = False
    alert = judged(
        series(error=yaw_off(2.0, 50, 100), good=good, moving=moving), 50.0, AT_ONCE
    ).alert
    assert alert.clock == 30.0
    assert alert.driving == 15.0


def test_a_fault_that_is_never_reported_is_misleading_at_the_end():
    verdict = judged(series(error=yaw_off(2.0, 50, 100)), 50.0, AT_ONCE)
    assert verdict.at_end
    assert math.isinf(verdict.alert.clock)
    assert math.isinf(verdict.alert.driving)


def test_an_error_that_was_learnt_away_is_reported_when_it_is_gone():
    verdict = judged(series(error=yaw_off(2.0, 50, 75)), 50.0, AT_ONCE)
    assert verdict.alert.clock == 25.0
    assert not verdict.at_end


def test_only_what_outlasts_the_allowed_time_is_late():
    error = yaw_off(2.0, 50, 100)
    assert judged(series(error=error), 50.0, AT_ONCE).beyond == 50.0
    assert judged(series(error=error), 50.0, Allowed(clock=2.0)).beyond == 48.0
    moving = np.zeros(100, dtype=bool)
    moving[60:] = True
    late = judged(series(error=error, moving=moving), 50.0, Allowed(driving=20.0)).beyond
    assert late == 20.0  # 10 s of standing, then 20 of driving


def test_misleading_time_begins_at_the_first_good_frame_after_the_onset():
    t = np.arange(10.0)
    good = np.array([1, 1, 0, 0, 1, 1, 1, 0, 1, 1], dtype=bool)
    assert until_told(t, good, 0.5) == (1.0, 2.0)
    assert until_told(t, good, 2.0) == (4.0, 7.0)
    assert until_told(t, good, 7.5) == (8.0, math.inf)
    assert until_told(t, np.zeros(10, dtype=bool), 3.0) == (3.0, 3.0)


def test_good_that_is_lost_counts_once_for_each_time():
    t = np.arange(20.0) * 0.5
    quality = np.array([0, 0, 2, 2, 3, 0, 0, 3, 3, 3, 3, 3, 3, 4, 4, 4, 3, 3, 3, 3])
    assert lost_again(t, quality) == (1, 1)
    assert lost_again(t, np.zeros(20, dtype=np.int64)) == (0, 0)


def test_coverage_counts_good_seconds_only():
    error = yaw_off(0.25, 0, 40)
    error[:20, 2] = 0.35
    good = np.ones(100)
    good[:10] = 0.0
    assert coverage(series(error=error, good=good), 0.0) == ([90, 90, 60], 80, 90)


# the diagram -----------------------------------------------------------------------------------


def test_the_diagram_counts_the_points_beyond_bound_and_limit():
    found = points(series(error=yaw_off(2.0, 50, 100)), 0.0)
    assert sum(found.values()) == 100
    text = diagram([{"points": found}, {"points": {"70,70": 5}}])
    words = [e.text for e in ElementTree.fromstring(text).iter() if e.tag.endswith("text")]
    assert "105 s sent as usable or fine, 50 s of them misleading (47.62 %)" in words


# faults in samples -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drive():
    return simulate(random_model(SEED), SEED, 6.0)


@pytest.fixture(scope="module")
def base(drive):
    model = random_model(SEED)
    R = drive.truth.R_vehicle_from_sensor()
    return Base(
        "drive",
        drive.samples,
        360.0,
        R,
        lean=drive.truth.mean_crown() - FULL.crown,
        accel_bias=model.accel.bias,
        gyro_bias=model.gyro.bias,
        seed=SEED,
    )


def put_at(start, variant=0, is_seen=False):
    return faults.Put(start, variant, 1.0, is_seen, np.random.default_rng(0))


@pytest.mark.parametrize(("variant", "angle"), [(0, "roll"), (1, "pitch"), (2, "yaw")])
def test_a_remount_of_samples_is_what_the_simulation_makes_of_one(base, variant, angle):
    changes = {"mount.shifts": [{"t_s": 200.0, f"{angle}_deg": 45.0}]}
    other = simulate(random_model(SEED).with_changes(changes), SEED, 6.0)
    faulty = faults.remount(45.0)(base, put_at(200.0, variant))
    R = other.truth.R_vehicle_from_sensor()
    np.testing.assert_allclose(faulty.turn(210.0) @ base.R_vehicle_from_sensor, R, atol=1e-12)
    for channel, scale in (("accel", 9.81), ("gyro", 0.3)):
        off = faulty.samples[channel].values - other.samples[channel].values
        # scale errors of 0.3 % rms and what warms up are the sensor's and do not turn along
        assert np.abs(off).max() < 0.03 * scale
        assert np.abs(off[faulty.samples[channel].t < 199.0]).max() < 1e-12


def test_a_turn_that_the_gyroscope_sees_adds_up_to_its_angle(base):
    seen = faults.remount(45.0)(base, put_at(200.0, 2, is_seen=True))
    unseen = faults.remount(45.0)(base, put_at(200.0, 2))
    t = base.samples["gyro"].t
    before = (t > 199.9) & (t < 200.6)
    extra = (seen.samples["gyro"].values - base.samples["gyro"].values)[before]
    about_up = extra @ base.R_vehicle_from_sensor.T
    turned = float(np.sum(about_up[:-1, 2] * np.diff(t[before])))
    assert math.degrees(turned) == pytest.approx(45.0, abs=1.0)
    late = t > 201.0
    difference = seen.samples["gyro"].values[late] - unseen.samples["gyro"].values[late]
    assert np.abs(difference).max() < 1e-9


def test_a_creep_comes_to_its_rate(base):
    faulty = faults.creep(72.0)(base, put_at(0.0, 1))
    np.testing.assert_allclose(
        np.degrees(vector_from_rotation(faulty.turn(300.0))), [0.0, 6.0, 0.0], atol=1e-9
    )


def test_a_frozen_sensor_says_its_last_value(base):
    faulty = faults.frozen_sensor(base, put_at(100.0))
    assert faulty.judged == ("accel", "gyro")
    for channel in faulty.judged:
        sound, frozen = base.samples[channel], faulty.samples[channel]
        at = int(np.searchsorted(sound.t, 100.0))
        assert (frozen.values[at:] == sound.values[at - 1]).all()
        assert np.array_equal(frozen.values[:at], sound.values[:at])
    assert 100.0 <= faulty.onset < 100.1


def test_a_clipped_axis_piles_up_two_percent(base):
    faulty = faults.clipped_axis(base, put_at(0.0, 1))
    changed = faulty.samples["accel"].values != base.samples["accel"].values
    assert changed.mean(axis=0) == pytest.approx([0.0, 0.02, 0.0], abs=0.003)


def test_two_percent_of_what_comes_after_the_start_are_clipped(base):
    start = 0.6 * base.duration_s
    faulty = faults.clipped_axis(base, put_at(start, 1))
    sound, clipped = base.samples["accel"], faulty.samples["accel"]
    changed = (clipped.values != sound.values)[:, 1]
    assert not changed[sound.t < start].any()
    assert changed[sound.t >= start].mean() == pytest.approx(0.02, abs=0.003)


def test_time_to_tell_of_clipping_runs_from_a_minute_that_is_clipped():
    """1 % are cut off at the lower end all the time, at the upper one from 200 s to 204 s."""
    t = np.arange(30000) / 100.0
    values = 0.1 * np.random.default_rng(0).standard_normal((len(t), 3))
    values[20000:20400] += 5.0
    speed = Series(t, np.full(len(t), 10.0))
    made = Base("made", {"accel": Series(t, values), "speed": speed}, 300.0, np.eye(3))
    faulty = faults.clipped_axis(made, put_at(0.0, 0))
    assert faulty.onset < 10.0
    assert 140.0 < faulty.runs_from < 142.0


def test_a_drive_without_a_clipped_minute_has_nothing_to_tell(base):
    parked = {
        **base.samples,
        "speed": Series(base.samples["speed"].t, 0.0 * base.samples["speed"].values),
    }
    faulty = faults.clipped_axis(replace(base, samples=parked), put_at(0.0, 1))
    assert faulty.onset > base.duration_s


def test_driving_backwards_turns_the_vehicle_round(base):
    faulty = faults.reversing(base, put_at(0.0))
    assert "reverse" not in faulty.samples
    np.testing.assert_allclose(faulty.turn(0.0) @ [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], atol=1e-12)
    assert np.array_equal(
        faulty.samples["lateral_accel"].values, -base.samples["lateral_accel"].values
    )
    assert faulty.samples["yaw_rate"] is base.samples["yaw_rate"]
    wheels, sound = faulty.samples["wheel_speeds"].values, base.samples["wheel_speeds"].values
    assert np.array_equal(wheels[:, 0], sound[:, 1])
    assert np.array_equal(wheels[:, 2], sound[:, 3])


def test_a_fault_that_no_signal_shows_is_distinguished_and_judged_by_no_bar():
    mirrored = next(row for row in ROWS if row.name == "all accelerometer signs")
    assert mirrored.is_shown(frozenset({"accel", "gyro", "speed", "yaw_rate"}))
    assert not mirrored.is_shown(frozenset({"accel", "gyro", "speed"}))
    hidden = line(mirrored.name, misleading=900.0, beyond=900.0, base="alone", shown=False)
    text = report([line(mirrored.name), hidden])
    assert "all accelerometer signs: 1 drives (alone), good and wrong for" in text
    assert "misleading later than the allowed time to alert in 0.00 %" in text


# what is sent ----------------------------------------------------------------------------------


def test_frames_say_the_state_and_the_rotation_that_the_pipeline_holds(base):
    """The probes' way is no other than the pipeline's own."""
    loaded = configuration(frozenset(base.samples), True)
    bus = frames(base.samples, base.duration_s, loaded, random_model(SEED), SEED)
    found = sent(bus, loaded, base.seconds)
    assert found.crash is None
    pipeline = Pipeline(estimator_for(loaded.config))
    stream = bus.t - bus.t[0]
    routed = compile_router(loaded).columns(stream, bus)
    held, _ = pipeline.run(routed.samples, {}, float(stream[-1]))
    middle = np.floor((np.arange(base.seconds) + 0.5 - bus.t[0]) * 10.0).astype(int)
    applied = held.rows_in(HOUSING, middle)[:, :9].reshape(-1, 3, 3)
    good = np.isfinite(applied).all(axis=(1, 2))
    assert 30 < good.sum() < base.seconds
    for k in np.flatnonzero(good):
        between = vector_from_rotation(applied[k] @ found.rotation[k].T)
        assert np.degrees(np.abs(between)).max() < 0.01  # the probes' step: 0.002 of 30 m/s^2
    assert np.array_equal(np.isfinite(found.rotation).all(axis=(1, 2)), good)
    for k, correction in enumerate(found.correction[:-1]):
        assert (correction is not None) == good[k]
        if correction is not None:
            assert correction.rotation == tuple(applied[k].ravel())
    t = found.accel.t
    assert len(t) == len(base.samples["accel"].t)
    ticks = np.floor((t - bus.t[0]) * 10.0).astype(int)
    assert np.mean(found.accel.quality == held.quality[ticks]) == 1.0


def test_a_sound_drive_is_right_and_a_turned_reference_is_not(base):
    loaded = configuration(frozenset(base.samples), True)
    bus = frames(base.samples, base.duration_s, loaded, random_model(SEED), SEED)
    found = sent(bus, loaded, base.seconds)
    sound = rows(base, faults.none(base, put_at(0.0)), found)
    assert sound.good.sum() > 30.0
    assert misleading(sound).sum() == 0.0
    turned = faults.remount(10.0)(base, put_at(0.0, 2))
    assert misleading(rows(base, turned, found)).sum() == pytest.approx(sound.good.sum())


@pytest.mark.slow
def test_a_measured_log_in_the_judges_frames_gives_what_its_own_frames_give():
    log = measured("second_world/01_none")
    if log is None:
        pytest.skip("the drives of second_world are not here")
    loaded = configuration(frozenset(log.samples), False)
    found = sent(frames(log.samples, log.duration_s, loaded, None, 0), loaded, log.seconds)
    folder = DATA / "second_world" / "01_none"
    engine = make_engine(open_config(folder / "car.yaml"))
    Replay(engine, LogReader([folder / "can.log.gz"], engine.router.matches)).run()
    R = engine.pipeline.estimator.estimate().R_vehicle_from_sensor
    between = np.degrees(vector_from_rotation(R @ found.rotation[-1].T))
    assert np.abs(between).max() < 0.05


# running ---------------------------------------------------------------------------------------


def test_every_fault_is_put_in_at_all_times_and_on_all_axes():
    size = replace(QUICK, drives=20, logs=0)
    wanted = [c for c in cases(size, ("remount",)) if c.row == "remount 10 deg"]
    assert len(wanted) == 40
    stop_at_the_end = Base("", {"speed": _speed(1200)}, 1200.0, np.eye(3), seed=1)
    starts = [put(case, stop_at_the_end).start for case in wanted]
    assert min(starts) >= 60.0
    assert max(starts) <= 960.0
    counts, _ = np.histogram(starts, [60.0, 150.0, 300.0, 600.0, 960.0])
    assert (counts >= 8).all()
    assert {(c.number % 3, c.number % 5) for c in wanted} == {
        (a, b) for a in range(3) for b in range(5)
    }
    assert len({c.key for c in cases(size, command.PARTS)}) == len(list(cases(size, command.PARTS)))


def _speed(seconds):
    from imucald.core.samples import Series

    return Series(np.arange(float(seconds)), np.full(seconds, 10.0))


def test_a_run_that_was_broken_off_goes_on(tmp_path, monkeypatch, capsys):
    done = []

    def one(case):
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(case.key)
        return case, line(case.row) | {"key": case.key, "base": case.base}

    results = tmp_path / "results.jsonl"
    command_line = ["integrity", "--quick", "--only", "creep", "--logs", "0"]
    monkeypatch.setattr(command, "case_outcome", one)
    monkeypatch.setattr("sys.argv", [*command_line, "--results", str(results)])
    assert command.main() == 130
    assert "goes on" in capsys.readouterr().err
    first = list(done)
    results.write_text(results.read_text() + '{"key": "cut o')  # as a lost power supply leaves it
    done.clear()
    assert command.main() == 0
    assert len(first) == 2
    assert len(done) == 1
    assert not set(first) & set(done)
    kept = [json.loads(x) for x in results.read_text().splitlines() if x.endswith("}")]
    assert [x["key"] for x in kept] == first + done


def test_seeds_that_were_tuned_on_are_refused(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["integrity", "--first", "41000"])
    assert command.main() == 2
    assert "41000 was tuned on" in capsys.readouterr().err


def line(row, **changed):
    """An outcome without anything wrong."""
    sound = {
        "row": row, "key": row, "base": "1", "judged": 3600.0, "good": 3000.0, "fine": 0.0,
        "misleading": 0.0, "beyond": 0.0, "at_end": False, "alert_clock": 1.0,
        "alert_driving": 1.0, "hits": [2900, 2900, 2900], "within": 2999, "known": 3000,
        "exposed": True, "crash": None, "level": "error", "suspects": 0, "not_available": 0,
        "usable_after": 60, "fine_after": 100, "points": {},
    }  # fmt: skip
    return sound | changed


def test_bars_are_met_by_sound_results_and_by_no_others():
    sound = [line(row.name) for row in ROWS] + [line("no fault")]
    assert "NOT MET" not in report(sound)
    wrong = {
        "frozen axis": {"alert_clock": 2.1},
        "dead axis": {"beyond": 0.5},
        "remount 10 deg": {"at_end": True},
        "remount 4 deg": {"alert_driving": None},
        "creep 18 deg/h": {"within": 2900},
        "cross-axis 2 %": {"hits": [2900, 2600, 2900]},
        "handedness": {"fine": 1.0},
        "speed x 3.6": {"level": "warning"},
        "gyroscope 57.3 times": {"crash": "LinAlgError"},
        "no fault": {"suspects": 1},
    }
    for name, changed in wrong.items():
        text = report([line(name, **changed) if x["row"] == name else x for x in sound])
        missed = [x for x in text.splitlines() if "NOT MET" in x]
        assert missed, name
        assert all(name in x or x.startswith("- 7") for x in missed), missed


def test_all_faults_weigh_the_same():
    lines = [line("frozen axis", good=100.0, beyond=100.0, misleading=100.0)]
    lines += [line("creep 5 deg/h", good=9900.0) for _ in range(10)]
    assert "in 50.00 % of the time sent as good" in report(lines)


def test_drives_with_nothing_sent_count_neither_way():
    silent = line("frozen axis", exposed=False, alert_clock=0.0)
    late = line("frozen axis", alert_clock=10.0)
    assert "reported within 2 s in 0 % (bar 100)" in report([silent, late])


def test_figures_stand_between_the_pages_marks():
    page = "head\n<!-- integrity -->\nold\n<!-- end of integrity -->\ntail"
    assert written(page, "new") == (
        "head\n<!-- integrity -->\n\nnew\n\n<!-- end of integrity -->\ntail"
    )
    assert Case("no fault", "1", 0, 60.0).key == "quiet/no fault/1/0/60"


# what a consumer gets ----------------------------------------------------------------------------


def test_cross_talk_is_what_a_true_force_leaves_on_the_other_axes():
    R = rotation_from_vector([0.3, -1.1, 2.0])  # vehicle from sensor
    unit = Response(
        accel=np.eye(3) + 0.02 * np.random.default_rng(3).standard_normal((3, 3)),
        gyro=rotation_from_vector([0.01, 0.0, 0.0]),
        zero=np.array([0.1, -0.2, 0.05]),
    )
    found = dict(zip(ENTRIES, left_over(Correction.turning(R), unit, R, R), strict=True))
    for name, (i, j) in {"xy": (0, 1), "yx": (1, 0), "zx": (2, 0), "zy": (2, 1)}.items():
        true = np.zeros(3)
        true[j] = 5.0
        sent_force = R @ (unit.accel @ (R.T @ true))
        assert found[name] == pytest.approx(math.degrees(sent_force[i] / 5.0))
    at_rest = R @ (unit.accel @ (R.T @ [0.0, 0.0, 9.80665]) + unit.zero)
    assert [found["zero x"], found["zero y"]] == pytest.approx(at_rest[:2])
    rate = R @ (unit.gyro @ (R.T @ [0.0, 0.0, 0.4]))
    assert found["rate xz"] == pytest.approx(math.degrees(rate[0] / 0.4))
    assert found["rate yz"] == pytest.approx(math.degrees(rate[1] / 0.4))


def test_a_matrix_and_an_offset_that_undo_a_units_errors_leave_nothing():
    R = rotation_from_vector([0.3, -1.1, 2.0])
    errors = 0.03 * np.random.default_rng(4).standard_normal((2, 3, 3))
    unit = Response(np.eye(3) + errors[0], np.eye(3) + errors[1], np.array([0.2, -0.1, 0.3]))
    W, V = R @ np.linalg.inv(unit.accel), R @ np.linalg.inv(unit.gyro)
    right = Correction.with_matrices(R, W, V, W @ unit.zero)
    assert np.abs(left_over(right, unit, R, R)).max() < 1e-12
    without = Correction.with_matrices(R, W, V)
    assert left_over(without, unit, R, R)[4:6] == pytest.approx((W @ unit.zero)[:2])


def test_a_rotation_that_undoes_the_error_of_the_axes_leaves_nothing():
    R, turn = rotation_from_vector([0.3, -1.1, 2.0]), rotation_from_vector([0.0, 0.0, 0.07])
    assert (
        np.abs(
            left_over(Correction.turning(R @ turn.T), Response(accel=turn, gyro=turn), R, R)
        ).max()
        < 1e-12
    )


def test_a_lean_of_the_roads_is_set_aside_in_the_level_zero():
    R, lean = np.eye(3), rotation_from_vector([0.02, 0.0, 0.0])
    assert abs(left_over(Correction.turning(lean @ R), Response(), R, lean @ R)[5]) < 1e-12
    assert abs(left_over(Correction.turning(lean @ R), Response(), R, R)[5]) == pytest.approx(
        9.80665 * math.sin(0.02)
    )


@pytest.mark.parametrize(("entry", "size"), [(0, 1.1), (5, 0.21), (7, 1.1)])
def test_an_entry_beyond_its_limit_and_four_deviations_misleads(entry, size):
    left, narrow = np.zeros((10, 8)), np.full((10, 8), 0.04)
    left[4:, entry] = -size
    assert beyond_limits(left, narrow).sum() == 6
    assert beyond_limits(left, np.full((10, 8), 0.3)).sum() == 0
    assert beyond_limits(0.8 * left, narrow).sum() == 0
    assert beyond_limits(np.full((10, 8), np.nan), narrow).sum() == 0


@pytest.mark.parametrize("edit", [faults.mixture, faults.antisymmetric(0.04)])
def test_an_edited_unit_answers_as_it_is_said_to(base, edit):
    faulty = edit(base, put_at(0.0, 1))
    sound, edited = base.samples, faulty.samples
    expected = sound["accel"].values @ faulty.response.accel.T + faulty.response.zero
    np.testing.assert_allclose(edited["accel"].values, expected, atol=1e-12)
    expected = sound["gyro"].values @ faulty.response.gyro.T
    np.testing.assert_allclose(edited["gyro"].values, expected, atol=1e-12)
    assert np.abs(faulty.response.accel - np.eye(3)).max() > 0.01


def test_a_units_errors_are_those_that_the_simulation_puts_in(base):
    model = random_model(SEED).with_changes({"accel.cross_axis": [0.03, 0, 0, 0, -0.02, 0]})
    answer = gain_matrix(model.accel)
    assert answer[0, 1] == 0.03
    assert answer[2, 0] == -0.02
    other = simulate(model, SEED, 2.0)
    sound = simulate(random_model(SEED), SEED, 2.0)
    K = answer @ np.linalg.inv(gain_matrix(random_model(SEED).accel))
    bias = np.array(model.accel.bias)
    expected = (sound.samples["accel"].values - bias) @ K.T + bias
    assert np.abs(other.samples["accel"].values - expected).mean() < 0.01  # steps and warming up
