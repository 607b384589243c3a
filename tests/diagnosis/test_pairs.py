"""Errors of a signal that depend on another, put into simulated drives by formulas of this file."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.stats import norm
from table_rows import left

from imucald.core.samples import Series
from imucald.diagnosis.cause_keys import mount_of
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.chance import beyond_chance, moderated
from imucald.diagnosis.left_over.courses import by_course
from imucald.diagnosis.left_over.pairs import (
    ERRORS,
    SPEEDS,
    STAMPS,
    TO_ONE_SIDE,
    _by_part,
    _can_be_asked,
    _in_time,
    _test,
    conditions,
    may_be,
    off_cycle,
)
from imucald.diagnosis.left_over.remains import Remains
from imucald.diagnosis.result import Kind
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import drive_of
from imucald.simulation import random_model, simulate

MINUTES = 15.0
SEED = 5


@cache
def sound():
    model = random_model(SEED)
    return model, dict(simulate(model, SEED, MINUTES).samples)


def found(put=None):
    model, samples = sound()
    samples = dict(samples)
    if put is not None:
        put(samples, mount_of(model))
    state = State([drive_of(samples)], model, model, {})
    return beyond_chance(left(Kind.GOES_WITH_ANOTHER, Remains.of_state(state)))


def uneven_gain(s, R, share=0.08):
    """Turning left reads `share` more than turning right."""
    t, w = s["gyro"].t, s["gyro"].values @ R.T
    w[:, 2] *= 1.0 + 0.5 * share * np.sign(w[:, 2])
    s["gyro"] = Series(t, w @ R)


def late_when_it_pulls(s, R):
    """The speed is late by 0.4 s while it rises, and not while it falls."""
    t, v = s["speed"].t, s["speed"].values
    rises = np.gradient(np.convolve(v, np.ones(50) / 50.0, "same")) > 0.0
    s["speed"] = Series(t, np.where(rises, np.interp(t - 0.4, t, v), v))


def zero_by_speed(s, R):
    """The zero to the left goes from -0.3 to 0.3 m/s^2 with the speed."""
    t, x = s["accel"].t, s["accel"].values
    v = np.interp(t, s["speed"].t, s["speed"].values)
    s["accel"] = Series(t, x + 0.3 * np.outer(np.tanh((v - 10.0) / 5.0), R[1]))


def after_effect(s, R):
    """The zero forward is 0.25 m/s^2 to the side of the last hard pull or braking."""
    t, x = s["accel"].t, s["accel"].values
    along = np.interp(t, s["speed"].t, np.gradient(s["speed"].values, s["speed"].t))
    along = np.convolve(along, np.ones(200) / 200.0, "same")
    rows = np.where(np.abs(along) > 1.5 * np.std(along), np.arange(len(along)), 0)
    s["accel"] = Series(t, x + 0.25 * np.outer(np.sign(along[np.maximum.accumulate(rows)]), R[0]))


def outer_wheel(s, R):
    """The speed is that of the outer wheel, 0.75 m beside the middle, whichever it is."""
    t, v = s["speed"].t, s["speed"].values
    rate = np.interp(t, s["gyro"].t, np.convolve(s["gyro"].values @ R[2], np.ones(50) / 50, "same"))
    s["speed"] = Series(t, v + 0.75 * np.abs(rate))


def shaken(s, R):
    """The zero forward goes by 0.8 m/s^2 from the smoothest to the most shaken ten seconds."""
    t, x = s["accel"].t, s["accel"].values
    power = np.sum(np.diff(x, axis=0, prepend=x[:1]) ** 2, axis=1)
    n = round(10.0 / float(np.median(np.diff(t))))
    mean = np.convolve(power, np.ones(n) / n, "same")
    low, high = np.quantile(mean, [0.05, 0.95])
    s["accel"] = Series(t, x + 0.8 * np.outer((mean - low) / (high - low), R[0]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("put", "signal", "what"),
    [(after_effect, "accel", ("the last hard acceleration", "accelerating")),
     (outer_wheel, "speed", ("sideways position",)),
     (shaken, "accel", ("shaking",)),
     (uneven_gain, "gyro", ("the direction of turning", "the amount of turning")),
     (late_when_it_pulls, "speed", ("accelerating", "acceleration")),
     (zero_by_speed, "accel", ("the speed", "crawling"))],
)  # fmt: skip
def test_an_error_that_goes_with_another_signal_is_seen_there(put, signal, what):
    """A gain that goes with the side of a turn is a zero that goes with its amount."""
    (own,) = [s for s in found(put) if s.signal == signal]
    assert own.kind == Kind.GOES_WITH_ANOTHER
    assert any(each in own.text for each in what)


@pytest.mark.slow
def test_a_sound_drive_leaves_nothing_that_goes_with_another_signal():
    assert found() == []


@pytest.mark.slow
def test_less_than_a_correct_gain_may_differ_is_not_reported():
    assert not any("gain" in s.text for s in found(lambda s, R: uneven_gain(s, R, 0.01)))


@pytest.mark.parametrize("signal", ["gyro", "accel", "speed"])
def test_what_a_signal_shows_too_much_changes_residuals_as_if_it_had_been_logged(signal):
    model, samples = sound()
    more = {"gyro": 0.01, "accel": 0.3, "speed": 0.5}[signal]
    R = mount_of(model)
    changed, t = dict(samples), samples[signal].t
    wave = more * np.sin(0.3 * t)
    own = np.outer(wave, R[1]) if signal != "speed" else wave
    changed[signal] = Series(t, samples[signal].values + own)
    base, logged = (Forward(drive_of(s), model, 300) for s in (samples, changed))
    delay = getattr(model, signal).delay_s
    on_grid = more * np.sin(0.3 * (base.t + delay))
    added = np.outer(on_grid, [0.0, 1.0, 0.0]) if signal != "speed" else on_grid
    before = base.residuals({}).of
    one, other = base.residuals({}, added={signal: added}).of, logged.residuals({}).of
    shown = {n for n, x in before.items() if np.std(other[n] - x) > 0.01 * np.std(x)}
    assert shown
    for name in shown:
        change = other[name] - before[name]
        assert np.std(one[name] - before[name] - change) <= 0.02 * np.std(change), name


def test_conditions_run_from_one_end_to_the_other():
    model, samples = sound()
    f = Forward(drive_of(samples), model, 300)
    v = np.interp(f.t, f.knots, np.abs(f.drive.knots.values))
    some = conditions(f)
    assert {*SPEEDS, *TO_ONE_SIDE, "shaking in 3 s"} <= set(some)
    for name in ("the speed", TO_ONE_SIDE[0]):
        assert np.quantile(some[name][v > 0.05], [0.05, 0.95]) == pytest.approx([-0.5, 0.5])
    assert np.corrcoef(some[TO_ONE_SIDE[0]], f.yaw_rate())[0, 1] > 0.5


def test_a_vehicle_that_is_the_same_in_a_mirror_errs_to_neither_side():
    model = sound()[0]
    (gain,) = (e for e in ERRORS if e.text == "the gyroscope's gain")
    assert may_be(gain, TO_ONE_SIDE[0], model) < may_be(gain, "shaking in 3 s", model)


def test_tyres_make_delays_of_turning_that_go_with_the_speed():
    late = {e.signal: e for e in ERRORS if e.kind == "delay"}
    assert not _can_be_asked(late["gyro"], "crawling")
    assert _can_be_asked(late["speed"], "crawling")
    assert _can_be_asked(late["gyro"], "shaking in 3 s")


def test_parts_of_a_segment_add_up_to_it():
    a, b = np.random.default_rng(1).standard_normal((2, 5, 10, 3))
    assert _by_part(_in_time(a), _in_time(b)).sum(axis=1) == pytest.approx((a * b).sum(axis=1))


@pytest.mark.parametrize("lasting", [False, True])
def test_of_noise_chances_are_no_smaller_than_they_say(lasting):
    """Independent parts, and noise that lasts for a segment."""
    rng = np.random.default_rng(2)
    below = 0
    for _ in range(2000):
        h = rng.exponential(1.0, (30, 4))
        z = rng.standard_normal((30, 4))
        if lasting:
            z = np.sqrt(0.5) * (z + rng.standard_normal((30, 1)))
        found = _test(1.5 * z * np.sqrt(h), h)
        below += found.chance(found.over, found.free) < 0.01
    assert below < 30


def test_a_value_is_found_with_its_deviations():
    rng = np.random.default_rng(3)
    h = np.full((50, 4), 2.0)
    found = _test(0.5 * h + np.sqrt(h) * rng.standard_normal(h.shape), h)
    assert found.value == pytest.approx(0.5, abs=3.0 / np.sqrt(h.sum()))
    assert found.sigma(found.over) == pytest.approx(found.value * np.sqrt(h.sum()), rel=0.3)
    assert found.chance(found.over, found.free) < norm.sf(5.0)
    assert found.gain > 20.0


@pytest.mark.parametrize("segments", [8, 14, 40])
def test_questions_about_the_same_noise_that_borrow_from_each_other_are_no_surer_than_they_say(
    segments,
):
    """Eighty columns that overlap, beside noise that is louder in some segments and lasts there."""
    rng, below, asked = np.random.default_rng(4), 0, 0
    for _ in range(150):
        loud = np.exp(0.5 * rng.standard_normal((segments, 1, 1)))
        lasting = rng.standard_normal((segments, 1, 20)) + rng.standard_normal((segments, 4, 20))
        noise = loud * lasting
        columns = rng.standard_normal((segments, 4, 20, 80)) + rng.standard_normal((1, 1, 1, 80))
        u = (noise[..., None] * columns).sum(axis=2)
        h = (columns**2).sum(axis=2)
        found = [_test(u[:, :, e], h[:, :, e]) for e in range(80)]
        over, free = moderated(
            np.array([x.over for x in found]), np.array([x.free for x in found]),
            4.0 * segments - 1.0,
        )  # fmt: skip
        chances = [x.chance(a, b) for x, a, b in zip(found, over, free, strict=True)]
        below, asked = below + sum(c < 1e-3 for c in chances), asked + len(chances)
    assert below / asked < 2e-3


# stamps ------------------------------------------------------------------------------------------


def test_an_even_cycle_is_not_left_by_lost_frames_nor_by_a_pause():
    t = np.delete(0.5 * np.arange(400), [7, 90, 91, 300])
    assert off_cycle(t) == pytest.approx(0.0, abs=1e-9)
    t[200:] += 123.3
    assert off_cycle(t) == pytest.approx(0.0, abs=0.2)


def test_a_clock_that_runs_evenly_and_wrong_leaves_no_cycle():
    assert off_cycle(1.0003 * np.arange(1000.0)) == pytest.approx(0.0, abs=1e-9)


def test_stamps_that_are_set_leave_their_cycle_by_as_much():
    t = np.arange(1000.0)
    late = off_cycle(t + 0.3 * (t >= 500.0))
    assert late[500] - late[499] == pytest.approx(0.3, abs=0.01)


def wander(t):
    return 0.4 * np.sin(2.0 * np.pi * t / 97.0)


def wrong_stamps(s, R):
    t, v = s["speed"].t, s["speed"].values
    s["speed"] = Series(t + wander(t), v)


def late_sender(s, R):
    """It wanders, and stamps rightly."""
    t, v = s["speed"].t, s["speed"].values
    s["speed"] = Series(t + wander(t), np.interp(t + wander(t), t, v))


@pytest.mark.slow
def test_stamps_that_wander_are_seen_and_a_sender_that_wanders_is_not_reported():
    assert any(STAMPS in s.text for s in found(wrong_stamps))
    assert found(late_sender) == []


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.4, 0.0])
def test_a_speed_that_is_late_from_some_moment_on_with_even_stamps_is_seen(step):
    model, samples = sound()
    t, v = samples["speed"].t, samples["speed"].values
    late = np.interp(t - step * (t > t[0] + 500.0), t, v)
    runs_wrong = t if step else t + 2e-4 * (t - t[0])
    state = State([drive_of({**samples, "speed": Series(runs_wrong, late)})], model, model, {})
    found = beyond_chance(by_course(Remains.of_state(state)))
    assert [s.parameter for s in found] == (["speed.delay_s"] if step else [])
