"""Health of every sample: stuck, clipped, in another unit, and what only looks like it."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from imucald.core.samples import GRAVITY, Series
from imucald.motion.hops import Carry, hop_rows
from imucald.motion.sample_health import SampleHealth, _Sensor
from imucald.motion.sensor_judges import USUAL_HOPS, Runs
from imucald.motion.signal_health import SOUND_S, SignalFault

HZ = 100.0
ACCEL_STEP, GYRO_STEP = 0.002, math.radians(0.01)
AXES = {"accel": 3, "gyro": 3}


def drive(
    seconds: float = 180.0, hz: float = HZ, seed: int = 0, grain: float = 1.0
) -> dict[str, Series]:
    """Samples of a sound unit in a car that stands for 20 s in each minute, else drives.

    Manoeuvres as slow noise, vibration while driving, white sensor noise, steps of a bus. grain:
    how many times coarser the steps are.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds * hz)
    t = (np.arange(n) + 0.5) / hz
    moves = (t % 60.0 >= 20.0).astype(float)

    def slow(rms: float, axes: int = 3) -> np.ndarray:
        phase = rng.uniform(0, 2 * math.pi, (axes, 40))
        f = rng.uniform(0.02, 0.6, (axes, 40))
        waves = np.cos(2 * math.pi * f[:, :, None] * t + phase[:, :, None]).sum(axis=1)
        return rms * (waves * math.sqrt(2.0 / 40)).T

    def noise(rms: float) -> np.ndarray:
        return rms * rng.standard_normal((n, 3))

    force = np.array([0.3, -0.2, GRAVITY]) + moves[:, None] * (slow(1.0) + noise(0.3)) + noise(0.02)
    rate = 0.003 + moves[:, None] * (slow(0.08) + noise(0.01)) + noise(0.0015)
    return {
        "accel": Series(t, np.round(force / (grain * ACCEL_STEP)) * (grain * ACCEL_STEP)),
        "gyro": Series(t, np.round(rate / (grain * GYRO_STEP)) * (grain * GYRO_STEP)),
        "speed": Series(t[::10], 10.0 * moves[::10]),
    }


def edited(samples: Mapping[str, Series], channel: str, edit: Any) -> dict[str, Series]:
    """Samples with a channel's values (N, 3) changed in place by a function of times and values."""
    values = samples[channel].values.copy()
    edit(samples[channel].t, values)
    return {**samples, channel: Series(samples[channel].t, values)}


def watched(samples: Mapping[str, Series], axes: Mapping[str, int] = AXES) -> SampleHealth:
    health = SampleHealth(axes)
    health.columns(samples, 0, int(10 * samples["speed"].t[-1]))
    return health


def reported(health: SampleHealth) -> list[tuple[str, str, str]]:
    return [(e.channel, str(e.fault), e.axes) for e in health.events]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("hz", [10.0, 50.0, 100.0, 200.0])
def test_a_sound_unit_is_sound(hz: float, seed: int) -> None:
    assert not reported(watched(drive(hz=hz, seed=seed)))


@pytest.mark.parametrize("grain", [10.0, 25.0, 60.0])
def test_coarse_steps_are_no_fault(grain: float) -> None:
    """Steps up to 0.12 m/s^2 and 0.6 deg/s: at rest the same value comes for seconds."""
    samples = drive(300.0, grain=grain)
    still = np.diff(samples["gyro"].values[:2000], axis=0)
    assert grain < 50.0 or (still == 0.0).mean() > 0.8, "nothing is tested otherwise"
    assert not reported(watched(samples))


@pytest.mark.parametrize("seed", range(4))
def test_a_coarse_axis_that_is_held_for_seconds_is_on_no_rail(seed: int) -> None:
    """Launches and bends of some seconds at one value, whose noise is less than a step."""
    samples = drive(600.0, seed=seed, grain=60.0)
    rng = np.random.default_rng(100 + seed)

    def held(t: np.ndarray, values: np.ndarray) -> None:
        levels = np.repeat(rng.normal(0.0, 1.0, len(t) // 300 + 1), 300)[: len(t)]
        force = levels + 0.03 * rng.standard_normal(len(t))
        values[:, 0] = np.round(force / (60.0 * ACCEL_STEP)) * (60.0 * ACCEL_STEP)

    assert not reported(watched(edited(samples, "accel", held)))


def test_a_value_that_is_sent_several_times_is_no_fault() -> None:
    samples = drive(hz=200.0)
    held = {
        c: Series(s.t, np.repeat(s.values[::20], 20, axis=0)) if c != "speed" else s
        for c, s in samples.items()
    }
    assert not reported(watched(held)), "of a sensor of 10 Hz in frames of 200 Hz"


def test_a_sensor_whose_values_are_sent_several_times_is_stuck_within_two_seconds() -> None:
    samples = drive(hz=200.0, seed=1)
    values = np.repeat(samples["accel"].values[::20], 20, axis=0)
    values[samples["accel"].t >= 130.0] = values[samples["accel"].t < 130.0][-1]
    health = watched({**samples, "accel": Series(samples["accel"].t, values)})
    (event,) = health.events
    assert 130.0 < event.since < 132.0
    assert health.faults == {"accel": {SignalFault.STUCK: "xyz"}}


def test_an_engine_that_stops_does_not_make_a_coarse_sensor_stuck() -> None:
    samples = drive(120.0, grain=60.0)

    def engine(t: np.ndarray, values: np.ndarray) -> None:
        idles = (t % 60.0 < 10.0)[:, None]
        shaken = values + idles * 0.3 * np.random.default_rng(1).standard_normal(values.shape)
        values[:] = np.round(shaken / 0.12) * 0.12

    assert not reported(watched(edited(samples, "accel", engine)))


@pytest.mark.parametrize("start", [50.0, 101.3, 130.0])
@pytest.mark.parametrize("axis", range(6))
def test_a_frozen_axis_is_reported_within_two_seconds_also_at_rest(axis: int, start: float) -> None:
    channel, i = ("accel", "gyro")[axis // 3], axis % 3

    def freeze(t: np.ndarray, values: np.ndarray) -> None:
        values[t >= start, i] = values[t < start, i][-1]

    health = watched(edited(drive(), channel, freeze))
    event = health.events[0]
    assert (event.channel, event.fault) == (channel, SignalFault.STUCK)
    assert event.axes == "xyz"[i]
    assert start < event.since < start + 2.0
    assert event.until is None
    assert set(health.faults) == {channel}


def test_a_dead_axis_from_the_start_is_reported_after_some_driving() -> None:
    health = watched(edited(drive(), "gyro", lambda _, v: v[:, 1].fill(0.0)))
    assert reported(health) == [("gyro", "stuck", "y")]


def test_the_third_axis_of_a_planar_sensor_is_not_looked_at() -> None:
    samples = edited(drive(), "accel", lambda _, v: v[:, 2].fill(GRAVITY))
    assert reported(watched(samples)) == [("accel", "stuck", "z")]
    assert not reported(watched(samples, {"accel": 2, "gyro": 3}))


def test_a_sensor_is_used_again_when_it_has_been_sound_for_long_enough() -> None:
    def pause(t: np.ndarray, values: np.ndarray) -> None:
        values[(t >= 100.0) & (t < 106.0)] = values[t < 100.0][-1]

    health = watched(edited(drive(), "accel", pause))
    (event,) = health.events
    assert event.axes == "xyz"
    assert event.until is not None
    assert 106.0 + SOUND_S <= event.until <= 107.0 + SOUND_S
    assert not health.faults


def disturbed(t: np.ndarray, values: np.ndarray) -> None:
    """0.16 s of one value beyond the usual range, each second for two minutes."""
    beyond = round(1.1 * float(values[:, 0].max()) / ACCEL_STEP) * ACCEL_STEP
    values[(t >= 60.0) & (t < 180.0) & (t % 1.0 < 0.16), 0] = beyond


def test_a_value_that_driving_no_longer_reaches_is_no_rail_after_some_minutes() -> None:
    samples = drive(480.0)
    health = watched(edited(samples, "accel", disturbed))
    saturated = [e for e in health.events if e.fault is SignalFault.SATURATED]
    assert saturated, "nothing is tested otherwise"
    assert "accel" not in health.faults
    assert all(e.until is not None and e.until < 180.0 + 240.0 for e in saturated)
    assert (
        SignalFault.SATURATED in watched(edited(drive(180.0), "accel", disturbed)).faults["accel"]
    )


def test_rails_are_forgotten_when_the_calibration_begins_again() -> None:
    samples = edited(drive(240.0), "accel", disturbed)
    health, until, end = SampleHealth(AXES), 1900, 1900 + round(20.0 * SOUND_S)

    def between(first: int, last: int) -> dict[str, Series]:
        use = {c: (s.t >= 0.1 * first) & (s.t < 0.1 * last) for c, s in samples.items()}
        return {c: Series(s.t[use[c]], s.values[use[c]]) for c, s in samples.items()}

    health.columns(between(0, until), 0, until)
    assert SignalFault.SATURATED in health.faults["accel"]
    health.forget_rails()
    health.columns(between(until, end), until, end)
    assert "accel" not in health.faults


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_an_axis_that_cannot_go_on_is_saturated_until_it_goes_beyond(
    axis: int, side: float
) -> None:
    channel, i = ("accel", "gyro")[axis // 3], axis % 3
    samples = drive(300.0)
    rail = float(np.quantile(side * samples[channel].values[:, i], 0.99))
    clipped = edited(
        samples,
        channel,
        lambda _, v: v[:, i].__isub__(side * np.maximum(side * v[:, i] - rail, 0.0)),
    )
    health = watched(clipped)
    assert {(e.channel, e.fault) for e in health.events} <= {
        (channel, SignalFault.SATURATED), (channel, SignalFault.STUCK),
    }  # fmt: skip
    first = next(e for e in health.events if e.fault is SignalFault.SATURATED)
    assert first.axes == "xyz"[i]
    assert health.faults[channel][SignalFault.SATURATED] == "xyz"[i], "for as long as it lasts"
    reached = samples[channel].t[side * samples[channel].values[:, i] > rail][0]
    assert first.since < reached + 90.0, "60 s of driving"

    def freed(t: np.ndarray, values: np.ndarray) -> None:
        late = t >= 200.0
        values[late] = samples[channel].values[late]

    assert not watched(edited(clipped, channel, freed)).faults


@pytest.mark.parametrize(
    ("channel", "factor"), [("accel", 1.0 / GRAVITY), ("accel", GRAVITY), ("gyro", 57.3)]
)
@pytest.mark.parametrize("start", [65.2, 90.0, 130.0, 159.9])
def test_a_change_of_unit_is_reported_within_two_seconds(
    channel: str, factor: float, start: float
) -> None:
    def change(t: np.ndarray, values: np.ndarray) -> None:
        values[t >= start] *= factor

    health = watched(edited(drive(), channel, change))
    assert reported(health)[0] == (channel, "implausible", "xyz")
    assert start < health.events[0].since < start + 2.0
    assert SignalFault.IMPLAUSIBLE in health.faults[channel]


@pytest.mark.parametrize("channel", ["accel", "gyro"])
@pytest.mark.parametrize("share", [0.9, 0.9999, 2.0])
def test_an_axis_that_was_stuck_for_long_is_on_no_rail_afterwards(
    channel: str, share: float
) -> None:
    """At a value of its own range, at its largest, and beyond."""
    samples = drive(400.0)
    y = samples[channel].values[:, 1]
    value = float(y[np.argsort(y)[min(int(share * len(y)), len(y) - 1)]])
    value *= max(share, 1.0)

    def hold(t: np.ndarray, values: np.ndarray) -> None:
        values[(t >= 150.0) & (t < 270.0), 1] = value

    health = watched(edited(samples, channel, hold))
    assert (channel, "stuck", "y") in reported(health), "nothing is tested otherwise"
    assert "saturated" not in {fault for _, fault, _ in reported(health)}
    assert not health.faults, "it is sound again"


def test_an_axis_that_was_stuck_at_its_rail_is_reported_by_later_bends() -> None:
    samples = drive(400.0)
    rail = float(np.quantile(samples["accel"].values[:, 1], 0.99))

    def clip(t: np.ndarray, values: np.ndarray) -> None:
        values[(t >= 40.0) & (t < 60.0), 1] = rail
        values[:, 1] = values[:, 1].clip(None, rail)

    health = watched(edited(samples, "accel", clip))
    assert health.faults["accel"][SignalFault.SATURATED] == "y"


def test_a_unit_that_is_put_right_is_used_again() -> None:
    def change(t: np.ndarray, values: np.ndarray) -> None:
        values[(t >= 90.0) & (t < 110.0)] *= 57.3

    health = watched(edited(drive(), "gyro", change))
    assert not health.faults
    assert all(e.until is not None and e.until < 111.0 + SOUND_S + 1.0 for e in health.events)


def across_a_hole(samples: Mapping[str, Series], at: float) -> SampleHealth:
    """What comes after a time is reported to come after a hole."""
    health = SampleHealth(AXES)
    for begin, end in ((0.0, at), (at, samples["speed"].t[-1])):
        part = {}
        for channel, series in samples.items():
            inside = (series.t >= begin) & (series.t < end)
            part[channel] = Series(series.t[inside], series.values[inside])
        health.columns(part, round(10 * begin), int(10 * end))
        if end == at:
            health.gap()
    return health


@pytest.mark.parametrize(("lasts", "is_used"), [(4.0, True), (1e9, False)])
def test_a_unit_is_that_of_before_where_driving_shakes_as_before(
    lasts: float, is_used: bool
) -> None:
    """A terminal that is taken in hand while parked, and a sender that changed its unit."""

    def shake(t: np.ndarray, values: np.ndarray) -> None:
        values[(t >= 76.0) & (t < 76.0 + lasts)] *= 57.3

    health = across_a_hole(edited(drive(), "gyro", shake), 80.0)
    assert reported(health) == [("gyro", "implausible", "xyz")]
    assert is_used == (not health.faults)
    if is_used:
        driven_s = 0.5 * USUAL_HOPS
        assert health.events[0].until < 80.0 + driven_s + SOUND_S + 2.0


def test_a_rough_road_is_no_change_of_unit() -> None:
    def rough(t: np.ndarray, values: np.ndarray) -> None:
        values[t >= 100.0] += np.random.default_rng(5).standard_normal(values[t >= 100.0].shape) * (
            30.0 * (0.01 if abs(values[0, 2]) < 5.0 else 0.1)
        )

    samples = drive()
    both = edited(edited(samples, "gyro", rough), "accel", rough)
    assert not reported(watched(both))


def test_live_and_columns_say_the_same_at_the_same_time() -> None:
    """Bit for bit: one by one, in whole columns, and in pieces of any length."""
    samples = drive(239.1)

    def trouble(t: np.ndarray, values: np.ndarray) -> None:
        values[(t >= 70.0) & (t < 80.0), 1] = values[0, 1]
        values[:, 0] = values[:, 0].clip(None, np.quantile(values[:, 0], 0.985))
        values[t >= 200.0] *= 0.1

    samples = edited(samples, "accel", trouble)
    last = 2390
    whole = SampleHealth(AXES)
    whole.columns(samples, 0, last)
    assert len(whole.events) >= 3
    rng = np.random.default_rng(3)
    pieces, k = SampleHealth(AXES), 0
    rows = {c: np.floor(s.t * 10.0).astype(int) for c, s in samples.items()}
    done = dict.fromkeys(samples, 0)
    while k < last:
        stop = min(k + int(rng.integers(0, 40)), last)
        part = {}
        for c, s in samples.items():
            end = int(np.searchsorted(rows[c], stop, side="right"))
            inside = int(np.searchsorted(rows[c], stop))
            end = int(rng.integers(max(inside, done[c]), end + 1))  # in the middle of a tick
            part[c] = Series(s.t[done[c] : end], s.values[done[c] : end])
            done[c] = end
        pieces.columns(part, k, stop)
        k = stop
    live = SampleHealth(AXES)
    events = sorted((t, c, i) for c, s in samples.items() for i, t in enumerate(s.t.tolist()))
    k = 0
    for t, c, i in events:
        while k < min(math.floor(t * 10.0), last):
            live.close(k)
            k += 1
        value = samples[c].values[i]
        live.add_sample(c, value.tolist() if value.ndim else [float(value)])
    expected = [e.as_dict() for e in whole.events]
    assert [e.as_dict() for e in live.events] == expected
    assert [e.as_dict() for e in pieces.events] == expected
    assert live.faults == whole.faults == pieces.faults


def test_time_that_jumped_ends_a_run() -> None:
    samples = drive(60.0)
    health = watched(samples)
    health.gap()
    frozen = {
        "accel": Series(60.0 + np.arange(80) / HZ, np.tile(samples["accel"].values[-1], (80, 1)))
    }
    health.columns(frozen, 600, 608)
    assert not reported(health)


@pytest.mark.parametrize("length", [20.0, 63.7, 181.3])
def test_a_recording_that_is_played_again_and_again_is_no_fault(length: float) -> None:
    """Its largest values come back to the last bit; a loop of any length, not of whole hops."""
    once, times = drive(length, seed=4), math.ceil(600.0 / length)
    looped = {}
    for c, s in once.items():
        period = len(once["accel"].t) / HZ
        t = np.concatenate([s.t + k * period for k in range(times)])
        looped[c] = Series(t, np.tile(s.values, (times,) + (1,) * (s.values.ndim - 1)))
    if length < 30.0:
        looped["speed"] = Series(looped["speed"].t, np.full(len(looped["speed"].t), 10.0))
    assert not reported(watched(looped))


def test_a_rail_that_comes_after_larger_values_is_reported_at_its_first_bends() -> None:
    samples = drive(300.0)
    rail = float(np.quantile(samples["accel"].values[:, 1], 0.99))

    def clip(t: np.ndarray, values: np.ndarray) -> None:
        late = t >= 150.0
        values[late, 1] = values[late, 1].clip(None, rail)

    health = watched(edited(samples, "accel", clip))
    event = health.events[0]
    assert (event.fault, event.axes) == (SignalFault.SATURATED, "y")
    beyond = samples["accel"].t[(samples["accel"].values[:, 1] > rail) & (samples["accel"].t > 150)]
    assert beyond[0] < event.since < beyond[0] + 30.0


def test_a_clipped_axis_in_a_loop_is_reported() -> None:
    once = drive(60.0, seed=2)
    rail = float(np.quantile(once["gyro"].values[:, 2], 0.98))
    once = edited(once, "gyro", lambda _, v: v.clip(None, [9.0, 9.0, rail], out=v))
    twice = {
        c: Series(np.concatenate([s.t, s.t + 60.0]), np.concatenate([s.values, s.values]))
        for c, s in once.items()
    }
    assert reported(watched(twice)) == [("gyro", "saturated", "z")]


def smooth_bends(top: float) -> dict[str, Series]:
    """A gyroscope without noise in bends; its rate never goes beyond `top` [rad/s]."""
    samples = drive(400.0)
    t = samples["gyro"].t
    moves = t % 60.0 >= 20.0
    rate = moves * (0.3 * np.sin(2 * np.pi * t / 17.0) + 0.05 * np.sin(2 * np.pi * t / 3.1))
    rate = rate.clip(None, top)
    stepped = np.round(rate / GYRO_STEP) * GYRO_STEP
    stepped -= np.where(rate < top, GYRO_STEP * (np.arange(len(t)) % 2), 0.0)  # it is alive

    def smooth(_: np.ndarray, values: np.ndarray) -> None:
        values[:, 2] = stepped

    return edited(samples, "gyro", smooth)


def test_a_smooth_axis_that_is_held_by_its_rail_for_long_is_saturated_and_not_only_stuck() -> None:
    assert not reported(watched(smooth_bends(9.0)))
    health = watched(smooth_bends(0.2))
    first = next(e for e in health.events if e.fault is SignalFault.SATURATED)
    assert first.axes == "z"
    assert first.since < 45.0, "as the axis leaves it after 15 s of driving: a bend from 37 to 41 s"
    assert health.faults["gyro"][SignalFault.SATURATED] == "z", "until something lies beyond"


def test_a_loose_contact_that_drops_to_zero_for_a_moment_is_stuck_and_on_no_rail() -> None:
    """Gravity's axis is never near zero else: a jump over values that never come."""
    samples = drive(400.0)
    rng = np.random.default_rng(5)
    begins = rng.choice(np.arange(10000, 38000), 60, replace=False)

    def drop(_: np.ndarray, values: np.ndarray) -> None:
        for k in begins.tolist():
            values[k : k + int(rng.integers(8, 90)), 2] = 0.0

    events = watched(edited(samples, "accel", drop)).events
    assert {e.fault for e in events} <= {SignalFault.STUCK, SignalFault.IMPLAUSIBLE}
    assert {e.axes for e in events if e.fault is SignalFault.STUCK} == {"z"}
    assert min(e.since for e in events) < samples["accel"].t[begins.min()] + 1.5


@pytest.mark.parametrize("samples_late", [4, 30, 90])
def test_a_sender_that_repeats_a_value_whose_successor_is_late_is_sound(samples_late: int) -> None:
    rng = np.random.default_rng(6)
    begins = rng.choice(np.arange(5000, 38000), 200, replace=False)

    def repeat(_: np.ndarray, values: np.ndarray) -> None:
        for k in begins.tolist():
            values[k : k + samples_late] = values[k]

    assert not reported(watched(edited(drive(400.0), "accel", repeat)))


@pytest.mark.parametrize("seed", range(3))
def test_a_sensor_that_is_laid_down_in_a_parked_vehicle_has_no_other_unit(seed: int) -> None:
    """A hand's turns, and then hardly a change of a coarse gyroscope; the force is noise."""
    samples = drive(120.0, seed=seed)
    rng = np.random.default_rng(seed)

    def handled(t: np.ndarray, values: np.ndarray) -> None:
        hand = 0.05 * rng.standard_normal(values.shape)
        rare = 0.001 * (rng.random(values.shape) < 0.02)
        parked = t < 20.0
        values[parked] = np.where(t[parked, None] < 10.0, hand[parked], rare[parked])
        values[:] = np.round(values / 0.001) * 0.001

    assert not reported(watched(edited(samples, "gyro", handled)))


def test_a_rough_road_is_no_unit_beside_an_accelerometer_that_is_too_coarse_to_feel_it() -> None:
    samples = drive(200.0)
    shaken = edited(
        samples,
        "gyro",
        lambda t, values: np.multiply(
            values, np.where(t % 60.0 < 20.0, 0.3, 2.0)[:, None], out=values
        ),
    )

    def coarse(_: np.ndarray, values: np.ndarray) -> None:
        values[:] = np.round(values / 2.0) * 2.0

    fault = [one for one in reported(watched(edited(shaken, "accel", coarse))) if one[0] == "gyro"]
    assert not fault


def test_a_filtered_axis_whose_step_is_coarser_than_what_noise_is_left_may_stay() -> None:
    """A consumer's gyroscope below 1 Hz, in steps of 0.02 deg/s."""
    samples = drive(600.0)
    part = 1.0 - np.exp(-2.0 * np.pi / HZ)

    def filtered(_: np.ndarray, values: np.ndarray) -> None:
        for k in range(1, len(values)):
            values[k] = values[k - 1] + part * (values[k] - values[k - 1])
        values[:] = np.round(values / 0.00035) * 0.00035

    assert not reported(watched(edited(samples, "gyro", filtered)))


def test_a_first_sample_after_a_gap_ends_no_run():
    """A sensor that starts later than the speed gave 50 runs without a sample: a division by 0."""
    runs = Runs()
    for _ in range(60):
        runs.add_runs(1, 0, 0)
    assert runs.limit() == math.inf


def test_axes_of_a_fault_are_in_their_order() -> None:
    """One axis is stuck, and an earlier one held a value between two jumps, in one hop."""
    sensor = _Sensor("accel", 3, deque())
    flags = iter((([False], [True], [False]), ([True], [False], [False]), ([False],) * 3))
    for judge in sensor.judges:
        judge.judge = lambda *_: next(flags)
    rows = hop_rows(np.full((1, 3), 9.81), np.zeros(1, np.int64), 1, Carry.none(3))
    found = sensor.judge(rows, np.array([True]), np.zeros((1, 2)))
    assert found[0][SignalFault.STUCK] == "xy"
