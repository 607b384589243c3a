"""Faults in samples and stamps: found where they are, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.samples import Series
from imucald.diagnosis.baseline import _rates
from imucald.diagnosis.direct.faults import clock_of, find_faults, invalid_spans
from imucald.diagnosis.direct.single_values import all_lost
from imucald.diagnosis.outcome import cause_of_fault
from imucald.diagnosis.recording import Recording
from imucald.model.model import VehicleModel

MODEL = VehicleModel().with_changes({"accel.rate_hz": 100.0, "speed.rate_hz": 10.0})
SECONDS = 300.0


def drive(seed=0, lsb=0.002) -> dict[str, Series]:
    """Noise on slow motion, as a sensor in a driving car has it; speed in whole km/h."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, SECONDS, 0.01) + 0.0003 * rng.exponential(size=round(SECONDS * 100))
    slow = np.cumsum(rng.standard_normal((len(t), 3)), axis=0) * 0.01
    slow -= slow.mean(axis=0)
    accel = slow + [0.0, 0.0, 9.81] + 0.2 * rng.standard_normal((len(t), 3))
    gyro = 0.1 * slow + 0.01 * rng.standard_normal((len(t), 3))
    ts = np.arange(0.0, SECONDS, 0.1)
    speed = 15.0 + 8.0 * np.sin(ts / 11.0)
    return {
        "accel": Series(t, np.round(accel / lsb) * lsb),
        "gyro": Series(t, np.round(gyro / 0.0005) * 0.0005),
        "speed": Series(ts, np.round(speed * 3.6) / 3.6),
    }


def causes(samples, model=MODEL) -> dict[str, object]:
    found = find_faults(samples, model, all_lost(samples))
    return {f"{f.cause}:{f.signal}": f for f in found}


@pytest.mark.parametrize("lsb", [0.002, 0.125])
def test_a_sound_drive_has_no_fault(lsb):
    assert causes(drive(lsb=lsb)) == {}


@pytest.mark.parametrize("share", [0.01, 0.03])
def test_values_that_pile_up_are_a_rail(share):
    samples = drive()
    x = samples["accel"].values.copy()
    rail = float(np.quantile(x[:, 0], 1.0 - share))
    x[:, 0] = np.minimum(x[:, 0], rail)
    samples["accel"] = Series(samples["accel"].t, x)
    found = causes(samples)
    assert list(found) == ["saturation:accel"]
    fault = found["saturation:accel"]
    assert f"have the value x {rail:.4g} m/s^2" in fault.text
    spans = invalid_spans([fault], samples, {})["accel"]
    hit = samples["accel"].t[x[:, 0] >= rail]
    assert all(any(a <= t <= b for a, b in spans) for t in hit)


def clipped(low, high) -> dict[str, Series]:
    """A drive whose accelerometer axes lie between these values (3,), with the codes of 0.002."""
    samples = drive()
    x = np.clip(samples["accel"].values, low, high)
    return samples | {"accel": Series(samples["accel"].t, np.round(x / 0.002) * 0.002)}


def test_a_range_that_all_axes_share_is_stated():
    """A converter has one code more below zero."""
    fault = causes(clipped(-10.002, 10.0))["saturation:accel"]
    assert fault.values["accel.full_scale"][0] == pytest.approx(10.0, abs=0.003)
    assert fault.changes == {"accel.full_scale": fault.values["accel.full_scale"][0]}


def test_a_range_of_one_axis_is_not_stated_because_the_key_holds_for_all_axes():
    """The file with the range of x made a simulation clip gravity too."""
    fault = causes(clipped([-1.3, -99.0, -99.0], [1.3, 99.0, 10.3]))["saturation:accel"]
    assert list(fault.values) == ["_accel.clipped"]
    assert fault.changes == {}
    assert "one range for all axes and signs" in fault.text


@pytest.mark.parametrize("lsb", [0.002, 0.125])
def test_an_axis_of_a_vector_of_one_length_ends_where_it_is_met_most_and_is_not_clipped(lsb):
    """Some software scales a force to the length of gravity: its upright axis cannot be longer."""
    samples = drive(lsb=1e-6)
    force = samples["accel"].values
    made = 9.81 * force / np.linalg.norm(force, axis=1)[:, None]
    samples["accel"] = Series(samples["accel"].t, np.round(made / lsb) * lsb)
    assert "saturation:accel" not in causes(samples)


def test_an_axis_is_clipped_also_where_a_third_of_it_is_on_the_rail():
    """Between the median and the rail values get rarer: it cuts a tail."""
    samples = drive()
    x = samples["accel"].values.copy()
    x[:, 0] = np.minimum(x[:, 0], float(np.quantile(x[:, 0], 0.67)))
    samples["accel"] = Series(samples["accel"].t, x)
    assert "saturation:accel" in causes(samples)


def test_an_axis_that_never_goes_beyond_zero_is_clipped_and_states_no_range():
    """A range of 0 is none that a model file can have: such drives ended by an error."""
    samples = drive()
    x = samples["accel"].values.copy()
    x[:, 0] = np.minimum(x[:, 0] - float(np.quantile(x[:, 0], 0.97)), 0.0)
    samples["accel"] = Series(samples["accel"].t, x)
    fault = causes(samples)["saturation:accel"]
    assert list(fault.values) == ["_accel.clipped"]
    assert fault.changes == {}


def test_readings_that_drop_to_zero_are_no_rail():
    samples = drive()
    x = samples["accel"].values.copy()
    rng = np.random.default_rng(1)
    for start in rng.choice(len(x) - 50, 60, replace=False):
        x[start : start + 10] = 0.0
    samples["accel"] = Series(samples["accel"].t, x)
    assert "saturation:accel" not in causes(samples)


def test_a_sensor_that_does_not_change_while_driving_is_stuck():
    samples = drive()
    t, x = samples["gyro"].t, samples["gyro"].values.copy()
    inside = (t > 100.0) & (t < 104.0)
    x[inside] = x[np.flatnonzero(inside)[0]]
    samples["gyro"] = Series(t, x)
    found = causes(samples)
    assert list(found) == ["stuck_signal:gyro"]
    assert found["stuck_signal:gyro"].values["_gyro.stuck_s"][0] == pytest.approx(4.0, abs=0.1)
    assert found["stuck_signal:gyro"].changes["gyro.stuck"][0]["start_s"] == pytest.approx(
        100, abs=1
    )


def test_a_value_on_a_rail_is_clipped_and_not_stuck():
    samples = drive()
    t, x = samples["gyro"].t, samples["gyro"].values.copy()
    x[(t > 100.0) & (t < 104.0)] = [0.9, 0.9, 0.9]
    x[:, 0] = np.minimum(x[:, 0], np.quantile(x[:, 0], 0.97))
    rail = float(x[:, 0].max())
    x[(t > 100.0) & (t < 104.0)] = [rail, 0.0, 0.0]
    samples["gyro"] = Series(t, x)
    assert list(causes(samples)) == ["saturation:gyro"]


def test_a_signal_of_one_number_is_on_its_rail_at_either_end():
    """Many short visits above show the rail; one long one below is the same rail."""
    samples = drive()
    t = samples["gyro"].t
    x = 0.3 * np.sin(t / 3.0) + samples["gyro"].values[:, 2]
    x[(t > 200.0) & (t < 203.0)] = -1.0
    rail = float(np.quantile(x, 0.97))
    samples["yaw_rate"] = Series(t, np.clip(x, -rail, rail))
    assert list(causes(samples)) == ["saturation:yaw_rate"]


def test_a_dead_zone_is_neither_stuck_nor_sent_twice():
    """It shows one value for seconds, again and again, also in frames that come close together."""
    samples = drive()
    t, x = samples["gyro"].t.copy(), samples["gyro"].values
    t[1::50] = t[:-1:50] + 0.0005
    turning = 0.06 * (np.sin(t / 2.0) + 0.8 * np.sin(t / 5.3))[:, None]
    x = 0.2 * (x - x.mean(axis=0)) + [0.1, 0.1, 1.0] * turning
    samples["gyro"] = Series(t, np.sign(x) * np.maximum(np.abs(x) - 0.06, 0.0))
    assert causes(samples) == {}
    again = np.random.default_rng(6).random(len(t)) < 0.01
    times = np.concatenate([t, t[again] + 0.0005])
    order = np.argsort(times, kind="stable")
    values = np.concatenate([samples["gyro"].values, samples["gyro"].values[again]])[order]
    samples["gyro"] = Series(times[order], values)
    assert "duplicated_frames:gyro" in causes(samples)


def test_a_cruise_behind_a_filter_is_not_stuck():
    """The filter takes the levels away; a speed that is held there goes on elsewhere."""
    samples = drive()
    t = samples["speed"].t
    v = 15.0 + 3.0 * np.sin(t / 11.0) + 0.01 * np.random.default_rng(4).standard_normal(len(t))
    cruise = (t > 200.0) & (t < 230.0)
    v[cruise] = v[np.flatnonzero(cruise)[0]]
    late = t >= 230.0
    moved = v.copy()
    moved[late] += v[np.flatnonzero(cruise)[0]] - v[np.flatnonzero(late)[0]]
    samples["speed"] = Series(t, moved)
    assert causes(samples) == {}
    samples["speed"] = Series(t, v)
    assert list(causes(samples)) == ["stuck_signal:speed"]


def test_frames_that_do_not_come_are_lost_and_not_stuck():
    """Two frames of one value on either side of a hole of 8 s."""
    samples = drive()
    t, x = samples["gyro"].t, samples["gyro"].values.copy()
    kept = (t < 100.0) | (t > 108.0)
    t, x = t[kept], x[kept]
    after = int(np.searchsorted(t, 104.0))
    x[after] = x[after - 1]
    samples["gyro"] = Series(t, x)
    assert list(causes(samples)) == ["dropouts:gyro"]


def test_zeros_at_standstill_are_natural():
    samples = drive()
    t, v = samples["speed"].t, samples["speed"].values.copy()
    v[(t > 50.0) & (t < 90.0)] = 0.0
    samples["speed"] = Series(t, v)
    assert causes(samples) == {}


def test_lost_frames_are_counted():
    samples = drive()
    kept = np.random.default_rng(5).random(len(samples["accel"].t)) > 0.02
    samples["accel"] = Series(samples["accel"].t[kept], samples["accel"].values[kept])
    found = causes(samples)
    assert list(found) == ["dropouts:accel"]
    assert found["dropouts:accel"].values["accel.loss"][0] == pytest.approx(0.02, abs=0.003)
    knowing = MODEL.with_changes({"accel.loss": 0.02})
    assert causes(samples, knowing) == {}, "the model file says so already"


def test_a_sender_that_changes_its_rate_loses_nothing():
    """Half the rate for 30 s, as phones do; as many lost at random are drop-outs."""
    samples = drive()
    t, x = samples["accel"].t, samples["accel"].values
    slow = (t > 100.0) & (t < 130.0)
    kept = ~slow | (np.arange(len(t)) % 2 == 0)
    samples["accel"] = Series(t[kept], x[kept])
    assert causes(samples) == {}
    kept = np.random.default_rng(8).random(len(t)) < kept.mean()
    samples["accel"] = Series(t[kept], x[kept])
    assert list(causes(samples)) == ["dropouts:accel"]


def test_a_pause_of_minutes_is_no_loss():
    samples = drive()
    t, x = samples["accel"].t, samples["accel"].values
    kept = (t < 100.0) | (t > 200.0)
    samples["accel"] = Series(t[kept], x[kept])
    assert causes(samples) == {}


def test_frames_that_come_twice_are_no_faster_clock():
    samples = drive()
    t, x = samples["accel"].t, samples["accel"].values
    again = np.random.default_rng(6).random(len(t)) < 0.01
    times = np.concatenate([t, t[again] + 0.001])
    order = np.argsort(times, kind="stable")
    samples["accel"] = Series(times[order], np.concatenate([x, x[again]])[order])
    found = causes(samples)
    assert list(found) == ["duplicated_frames:accel"]
    assert found["duplicated_frames:accel"].values["_accel.doubled"][0] == pytest.approx(
        0.01, abs=0.002
    )


@pytest.mark.parametrize("share", [0.01, 0.03])
def test_frames_that_share_a_stamp_and_differ_come_once_and_none_is_lost(share):
    """A logger's clock is coarse now and then: two frames get the stamp of the first."""
    samples = drive()
    t, x = samples["accel"].t.copy(), samples["accel"].values
    late = np.flatnonzero(np.random.default_rng(6).random(len(t) - 1) < share) + 1
    t[late] = t[late - 1]
    samples["accel"] = Series(t, x)
    assert causes(samples) == {}


def test_frames_that_come_twice_with_one_stamp_are_doubled():
    samples = drive()
    t, x = samples["accel"].t, samples["accel"].values
    twice = np.flatnonzero(np.random.default_rng(6).random(len(t)) < 0.01)
    samples["accel"] = Series(np.insert(t, twice, t[twice]), np.insert(x, twice, x[twice], axis=0))
    found = causes(samples)
    assert list(found) == ["duplicated_frames:accel"]
    assert found["duplicated_frames:accel"].text.startswith(f"{len(twice)} frames come twice")


def test_the_text_of_a_fault_names_its_signal():
    samples = drive()
    samples["yaw_rate"] = Series(samples["gyro"].t, samples["gyro"].values[:, 2])
    for name in ("accel", "yaw_rate"):
        t, x = samples[name].t, samples[name].values
        again = np.random.default_rng(6).random(len(t)) < 0.01
        times = np.concatenate([t, t[again] + 0.001])
        order = np.argsort(times, kind="stable")
        samples[name] = Series(times[order], np.concatenate([x, x[again]])[order])
    found = causes(samples)
    texts = {name: cause_of_fault(fault, VehicleModel()).text for name, fault in found.items()}
    assert texts["duplicated_frames:accel"].startswith("Accelerometer: ")
    assert texts["duplicated_frames:yaw_rate"].startswith("Yaw rate: ")


@pytest.mark.parametrize(("ppm", "found"), [(1500.0, True), (60.0, False), (50_000.0, False)])
def test_a_cycle_is_reported_beyond_what_crystals_have(ppm, found):
    samples = drive()
    t = samples["accel"].t
    samples["accel"] = Series(t * (1.0 + 1e-6 * ppm), samples["accel"].values)
    said = causes(samples)
    assert ("clock_drift:accel" in said) is found
    if found:
        value = said["clock_drift:accel"].values["accel.clock_drift_ppm"][0]
        assert value == pytest.approx(ppm, abs=20.0)


def test_who_is_asked_for_each_value_has_no_clock():
    """OBD-II answers: their stamps walk away from any cycle."""
    samples = drive()
    rng = np.random.default_rng(8)
    t = np.cumsum(rng.normal(0.42, 0.03, 700))
    samples["speed"] = Series(t, np.round(40.0 + 10.0 * np.sin(t / 11.0)) / 3.6)
    assert causes(samples) == {}


@pytest.mark.parametrize("seed", [8, 16, 23, 45])
def test_answers_whose_lateness_adds_up_have_no_clock(seed):
    """Asked again on the answer, in 0.10 or 0.13 s as an OBD-II dongle is: some walks stay near a
    cycle for minutes, and it is nobody's."""
    rng, samples = np.random.default_rng(seed), drive()
    is_slow = rng.random(1558) < 0.18
    slow, quick = rng.normal(0.129, 0.008, 1558), rng.normal(0.103, 0.006, 1558)
    t = np.cumsum(np.where(is_slow, slow, quick))
    samples["speed"] = Series(t, np.round(40.0 + 10.0 * np.sin(t / 11.0)) / 3.6)
    model = MODEL.with_changes({"speed.rate_hz": 1.0 / 0.105})
    assert "clock_drift:speed" not in causes(samples, model)


@pytest.mark.parametrize("seed", range(4))
def test_a_sender_that_is_late_by_chance_keeps_its_clock(seed):
    """Each frame is late by itself, by more than a logger's clock wanders: that adds up to none."""
    rng, samples = np.random.default_rng(seed), drive()
    t = 0.42 * (1.0 + 3000e-6) * np.arange(700) + rng.normal(0.0, 0.03, 700)
    samples["speed"] = Series(t, np.round(40.0 + 10.0 * np.sin(t / 11.0)) / 3.6)
    found = causes(samples, MODEL.with_changes({"speed.rate_hz": 1.0 / 0.42}))
    value = found["clock_drift:speed"].values["speed.clock_drift_ppm"][0]
    assert value == pytest.approx(3000.0, abs=100.0)


def test_a_speed_that_sticks_is_found_also_after_a_long_stop():
    """The usual length of a stretch without change is that of driving, not of standing."""
    samples = drive()
    t, v = samples["speed"].t, samples["speed"].values.copy()
    v[t < 100.0] = 0.0
    inside = (t > 200.0) & (t < 230.0)
    v[inside] = v[np.flatnonzero(inside)[0]]
    samples["speed"] = Series(t, v)
    found = causes(samples)
    assert list(found) == ["stuck_signal:speed"]
    assert found["stuck_signal:speed"].values["_speed.stuck_s"][0] == pytest.approx(30.0, abs=1.0)


def test_a_clock_that_wanders_still_shows_what_is_lost():
    """A logger's stamps walk by 60 ms to and fro: no cycle to be told, but whole cycles between."""
    samples = drive()
    t = samples["accel"].t
    kept = np.random.default_rng(5).random(len(t)) > 0.02
    wandering = t + 0.06 * np.sin(t / 20.0)
    samples["accel"] = Series(wandering[kept], samples["accel"].values[kept])
    found = causes(samples)
    assert list(found) == ["dropouts:accel"]
    assert found["dropouts:accel"].values["accel.loss"][0] == pytest.approx(0.02, abs=0.003)


def test_a_slow_sensor_that_stays_at_its_highest_is_clipped():
    """Ten samples a second give few at a rail, but each stay lasts."""
    samples = drive()
    t = np.arange(0.0, SECONDS, 0.1)
    rng = np.random.default_rng(4)
    smooth = np.convolve(rng.standard_normal(len(t) + 20), np.hanning(20), "valid")[: len(t)]
    up = 9.81 + 0.1 * rng.standard_normal(len(t))
    x = np.column_stack([smooth, 0.7 * np.roll(smooth, 900), up])
    x = np.round(x / 0.004) * 0.004
    slow = MODEL.with_changes({"accel.rate_hz": 10.0})
    assert causes(samples | {"accel": Series(t, x)}, slow) == {}
    clipped = x.copy()
    clipped[:, 0] = np.minimum(x[:, 0], np.quantile(x[:, 0], 0.98))
    found = causes(samples | {"accel": Series(t, clipped)}, slow)
    assert list(found) == ["saturation:accel"]


def test_a_sensor_that_is_stuck_across_a_stop_is_found():
    samples = drive()
    ts = samples["speed"].t
    speed = np.where((ts > 110.0) & (ts < 130.0), 0.0, samples["speed"].values)
    samples["speed"] = Series(ts, speed)
    x = samples["gyro"].values.copy()
    inside = (samples["gyro"].t > 105.0) & (samples["gyro"].t < 135.0)
    x[inside] = x[np.flatnonzero(inside)[0]]
    samples["gyro"] = Series(samples["gyro"].t, x)
    found = causes(samples)
    assert list(found) == ["stuck_signal:gyro"]
    assert found["stuck_signal:gyro"].values["_gyro.stuck_s"][0] == pytest.approx(30.0, abs=1.0)


def test_a_stuck_speed_does_not_put_the_blame_on_what_stands_still():
    """The speed stays at 40 km/h while the vehicle stops, and its yaw rate holds still."""
    samples = drive()
    rng = np.random.default_rng(8)
    t = samples["speed"].t
    yaw = np.round(0.1 * np.sin(t / 7.0) / 0.001 + rng.standard_normal(len(t))) * 0.001
    samples["yaw_rate"] = Series(t, np.where((t > 110.0) & (t < 150.0), 0.0, yaw))
    stuck = (t > 100.0) & (t < 160.0)
    samples["speed"] = Series(t, np.where(stuck, 11.0, samples["speed"].values))
    assert "stuck_signal:yaw_rate" not in causes(samples)


def test_a_dead_zone_repeats_itself_and_is_neither_a_second_frame_nor_stuck():
    """Stamps of a bus: some frames come early. Below 2 deg/s the gyroscope shows nothing."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 300.0, 0.1)
    t[1::40] -= 0.08
    rate = 0.05 * np.sin(t[:, None] / np.array([3.0, 5.0, 7.0]))
    rate[(t % 60.0) < 25.0] = 0.0
    rate = np.sign(rate) * np.maximum(np.abs(rate) - 0.035, 0.0)
    made = {
        "accel": Series(t, rng.standard_normal((len(t), 3)) + np.array([0.0, 0.0, 9.81])),
        "gyro": Series(t, rate),
        "speed": Series(t, 15.0 + np.sin(t)),
    }
    found = {fault.cause for fault in find_faults(made, VehicleModel())}
    assert not found & {"duplicated_frames", "stuck_signal"}


def test_late_frames_lose_no_cycle():
    """Frames that wait for others on the bus, by a tenth of the cycle and now and then by one."""
    samples = drive()
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 1200.0, 0.01) * (1.0 + 260e-6)
    late = np.maximum.accumulate(t + 0.0015 * rng.exponential(size=len(t)))
    accel = np.resize(samples["accel"].values, (len(t), 3))
    kept = rng.random(len(t)) > 2e-4
    found = causes({**samples, "accel": Series(late[kept], accel[kept])})
    ppm, se, _ = found["clock_drift:accel"].values["accel.clock_drift_ppm"]
    assert ppm == pytest.approx(260.0, abs=2.0)
    assert se < 2.0


def with_jitter(lost: float, seed: int = 3) -> dict[str, Series]:
    """As a candump of a bus: the accelerometer's frames each 10 ms to the microsecond, stamped
    late by up to 0.8 ms, some of them lost."""
    samples, rng = drive(), np.random.default_rng(seed)
    n = len(samples["accel"].t)
    kept = rng.random(n) >= lost
    t = 0.01 * np.arange(n) + rng.uniform(0.0, 0.0008, n)
    return {**samples, "accel": Series(t[kept], samples["accel"].values[kept])}


@pytest.mark.parametrize("lost", [0.0, 0.05])
def test_the_rate_of_a_plain_car_is_that_of_the_stamps_however_many_frames_are_lost(lost):
    """The median of the steps is 2000 ppm off where one frame in twenty is lost."""
    recording = Recording("log", with_jitter(lost), SECONDS, 1, {})
    assert _rates([recording])["accel"] == pytest.approx(100.0, rel=2e-6)


def test_the_rate_of_frames_that_come_in_batches_is_their_mean_rate():
    """Most steps are those within a batch: their median made a rate of 1000 Hz of one of 100 Hz."""
    t, place = drive()["accel"].t, np.arange(round(100 * SECONDS))
    late = Series(t[np.minimum(place // 10 * 10 + 9, len(t) - 1)] + 2e-5 * (place % 10), t)
    rates = _rates([Recording("log", {"accel": late}, SECONDS, 1, {})])
    assert rates["accel"] == pytest.approx(100.0, rel=1e-3)


def test_where_frames_are_lost_no_clock_error_is_certain():
    model = MODEL.with_changes({"accel.rate_hz": 100.2})
    assert causes(with_jitter(0.0), model)["clock_drift:accel"].changes
    fault = causes(with_jitter(0.05), model)["clock_drift:accel"]
    assert not fault.changes
    assert cause_of_fault(fault, model).certainty == "likely"


def test_the_deviation_of_a_cycle_is_that_of_stamps_that_wander():
    """A logger's clock that walks to and fro: the cycles of many drives scatter by what each says
    of itself."""
    rng, said = np.random.default_rng(11), []
    for _ in range(40):
        walk = 2e-5 * np.cumsum(rng.standard_normal(30_000))
        clock = clock_of(0.01 * np.arange(30_000) + walk)
        assert clock is not None
        said.append(((clock.cycle_s - 0.01) / 0.01, clock.se))
    error, se = np.array(said).T
    assert 0.7 < np.sqrt(np.mean((error / se) ** 2)) < 1.6


def with_coarse_stamps(step: float, cycle: float, lost: float, seed: int) -> dict[str, Series]:
    """The gyroscope's frames come each cycle, late by some tenths of a millisecond; the logger's
    clock goes in steps and rounds down."""
    rng, samples = np.random.default_rng(seed), drive()
    count = round(SECONDS / cycle)
    t = (rng.random() + np.arange(count)) * cycle * (1.0 + 1e-6 * rng.uniform(-100.0, 100.0))
    t = np.maximum.accumulate(t + 0.001 * rng.exponential(size=count))
    kept = rng.random(count) >= lost
    values = np.resize(samples["gyro"].values, (count, 3))
    return {**samples, "gyro": Series(np.floor(t[kept] / step) * step, values[kept])}


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("cycle", [0.01, 0.02, 0.05])
@pytest.mark.parametrize("step", [0.001, 0.01, 1.0 / 64.0, 0.02])
def test_stamps_that_are_rounded_down_lose_no_frame(step, cycle, seed):
    model = MODEL.with_changes({"gyro.rate_hz": 1.0 / cycle})
    found = causes(with_coarse_stamps(step, cycle, 0.0, seed), model)
    assert "dropouts:gyro" not in found
    assert "clock_drift:gyro" not in found


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(
    ("step", "cycle"),
    [(0.001, 0.01), (0.01, 0.01), (0.01, 0.02), (0.01, 0.05), (1.0 / 64.0, 0.05), (0.02, 0.02)],
)
def test_what_is_lost_is_counted_also_with_stamps_that_are_rounded_down(step, cycle, seed):
    model = MODEL.with_changes({"gyro.rate_hz": 1.0 / cycle})
    found = causes(with_coarse_stamps(step, cycle, 0.03, seed), model)
    assert found["dropouts:gyro"].values["gyro.loss"][0] == pytest.approx(0.03, abs=0.006)


@pytest.mark.parametrize("apart", [0.0, 2e-5, 8e-5])
@pytest.mark.parametrize("many", [2, 3, 10, 30])
def test_frames_that_are_handed_over_in_batches_are_not_lost(many, apart):
    """An adapter stamps them as they are read: closely one after the other, after the last one."""
    samples = drive()
    for name in ("accel", "gyro"):
        t, place = samples[name].t, np.arange(len(samples[name].t))
        last = np.minimum(place // many * many + many - 1, len(t) - 1)
        samples[name] = Series(t[last] + apart * (place % many), samples[name].values)
    found = causes(samples)
    assert not [key for key in found if key.startswith(("dropouts", "clock_drift"))]


@pytest.mark.parametrize("seed", range(4))
def test_a_speed_that_is_asked_for_loses_no_frame(seed):
    """As in a measured drive: each answer is asked for after the one before, in 0.40 s, and one in
    seventy takes twice as long."""
    rng, samples = np.random.default_rng(seed), drive()
    late = np.where(rng.random(1400) < 1.0 / 70.0, 0.4, 0.0)
    t = np.cumsum(rng.normal(0.4, 0.02, 1400) + late)
    samples["speed"] = Series(t, np.round(40.0 + 10.0 * np.sin(t / 11.0)) / 3.6)
    assert "dropouts:speed" not in causes(samples, MODEL.with_changes({"speed.rate_hz": 2.5}))
