"""Attitude and travel direction on CAN: frames in, frames out, live as in replay."""

from __future__ import annotations

import gzip
import json
import math
import re
import tempfile
from collections import defaultdict
from importlib import resources
from pathlib import Path

import cantools.database
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine_bus import columns_of, frames_of, load
from gait import CARRYINGS, walk
from imucald.cli import main
from imucald.commands.terminal import _beside
from imucald.core.errors import ConfigError
from imucald.core.rotations import rotation_from_angles
from imucald.inputs.wiring import compile_router
from imucald.mount.estimate import Correction, MountEstimate, MountState
from imucald.runtime.consumers import ORDER, consumers_for
from imucald.runtime.engine import Engine
from imucald.runtime.output.output_frames import OutputFrames
from imucald.runtime.session import make_engine

G = 9.80665
DATA = Path(__file__).parents[3] / "shared" / "data"
DBC = """VERSION ""
NS_ :
BS_:
BU_: IMU

BO_ 512 ACC: 6 IMU
 SG_ X : 0|16@1- (0.002,0) [0|0] "m/s^2" IMU
 SG_ Y : 16|16@1- (0.002,0) [0|0] "m/s^2" IMU
 SG_ Z : 32|16@1- (0.002,0) [0|0] "m/s^2" IMU

BO_ 513 GYR: 6 IMU
 SG_ GX : 0|16@1- (0.01,0) [0|0] "deg/s" IMU
 SG_ GY : 16|16@1- (0.01,0) [0|0] "deg/s" IMU
 SG_ GZ : 32|16@1- (0.01,0) [0|0] "deg/s" IMU

BO_ 514 SPD: 2 IMU
 SG_ V : 0|16@1+ (0.01,0) [0|0] "m/s" IMU

BO_ 516 MAG: 6 IMU
 SG_ MX : 0|16@1- (0.02,0) [0|0] "uT" IMU
 SG_ MY : 16|16@1- (0.02,0) [0|0] "uT" IMU
 SG_ MZ : 32|16@1- (0.02,0) [0|0] "uT" IMU
"""
CAR = """
database: bus.dbc
signals:
  accelerometer: {x: ACC.X, y: ACC.Y, z: ACC.Z}
  gyroscope: {x: GYR.GX, y: GYR.GY, z: GYR.GZ}
  speed: SPD.V
attitude: {enabled: true, rate: 5}
"""
PHONE = """
database: bus.dbc
signals:
  accelerometer: {x: ACC.X, y: ACC.Y, z: ACC.Z}
  gyroscope: {x: GYR.GX, y: GYR.GY, z: GYR.GZ}
  magnetometer: {x: MAG.MX, y: MAG.MY, z: MAG.MZ}
travel_direction: {enabled: true}
"""
MOUNT = rotation_from_angles(0.3, -0.5, 2.0)


class FixedEstimator:
    """Knows the mount from the first second on, and a little better from the tenth."""

    state = MountState.FINE

    def __init__(self):
        self.ticks = 0

    @property
    def correction(self):
        if self.ticks < 10:
            return None
        off = rotation_from_angles(0.0, 0.0, 0.01) if self.ticks < 100 else np.eye(3)
        return Correction.turning(off @ MOUNT)

    def step(self, tick):
        self.ticks += 1

    def gap(self):
        pass

    def estimate(self):
        return MountEstimate(self.state, MOUNT, 1e-6 * np.eye(3))


def engine_for(loaded):
    output = OutputFrames(loaded.config)
    router = compile_router(loaded)
    return Engine(router, FixedEstimator, output, consumers=consumers_for(loaded, output))


def raw(message, *values):
    data = message.encode(
        {s.name: v for s, v in zip(message.signals, values, strict=True)}, strict=False
    )
    return message.frame_id, bytes(data)


@pytest.fixture(scope="module")
def bus():
    return cantools.database.load_string(DBC, "dbc")


@pytest.fixture(scope="module")
def out_dbc():
    text = (resources.files("imucald") / "data" / "imucald_out.dbc").read_text("utf-8")
    return cantools.database.load_string(text, "dbc")


def car_frames(bus, seconds=60.0, rate=25.0):
    """Standing on a slope of 6 %, then driving up it, straight; sensor axes by MOUNT.

    With a sensor's noise: values that never change while it drives are those of a dead sensor.
    """
    slope = math.atan(0.06)
    rng = np.random.default_rng(3)
    frames = []
    for k in range(round(seconds * rate)):
        t = k / rate
        a = 2.0 if 20.0 < t < 28.0 else 0.0
        v = 2.0 * min(max(t - 20.0, 0.0), 8.0)
        force = MOUNT.T @ [a + G * math.sin(slope), 0.0, G * math.cos(slope)]
        force = force + 0.006 * rng.standard_normal(3)
        rate_deg = MOUNT.T @ [0.2, -0.3, 0.1] + 0.01 * rng.standard_normal(3)
        if k % 5 == 0:
            frames.append((t, *raw(bus.get_message_by_name("SPD"), v)))
        frames.append((t, *raw(bus.get_message_by_name("GYR"), *rate_deg)))
        frames.append((t, *raw(bus.get_message_by_name("ACC"), *force)))
    return frames


def phone_frames(bus, w):
    frames = []
    for i, t in enumerate(w.t.tolist()):
        frames.append((t, *raw(bus.get_message_by_name("GYR"), *np.degrees(w.gyro[i]))))
        frames.append((t, *raw(bus.get_message_by_name("MAG"), *(w.mag[i] * 1e6))))
        frames.append((t, *raw(bus.get_message_by_name("ACC"), *w.accel[i])))
    return frames


def by_name(out_dbc, frames):
    found = defaultdict(list)
    for can_id, data in frames:
        message = out_dbc.get_message_by_frame_id(can_id)
        raw_values = message.decode(data, decode_choices=False, scaling=False)
        values = message.decode(data, decode_choices=False)
        for signal in message.signals:
            if signal.length == 16 and signal.name != "StepCount":
                absent = -32768 if signal.is_signed else 65535
                if raw_values[signal.name] == absent:
                    values[signal.name] = None
        found[message.name].append(values)
    return found


def live(engine, frames):
    return [out for frame in frames for out in engine.frame(*frame)]


def test_a_drive_up_a_slope_comes_out_as_one(tmp_path, bus, out_dbc):
    engine = engine_for(load(CAR, tmp_path, DBC))
    found = by_name(out_dbc, live(engine, car_frames(bus)))
    angles = found["IMUCALD_Attitude"]
    assert len(angles) == pytest.approx(5 * 60, abs=2)
    assert [angles[0][k] for k in ("Roll", "Pitch", "Heading", "State")] == [None, None, None, 0]
    assert {a["State"] for a in angles} == {0, 1, 3}
    last = {**angles[-1], **found["IMUCALD_AttitudeDeviation"][-1]}
    assert last["Pitch"] == pytest.approx(-math.degrees(math.atan(0.06)), abs=0.15)
    assert last["Roll"] == pytest.approx(0.0, abs=0.15)
    assert 0.0 < last["DeviationPitch"] < 0.7
    assert last["DeviationHeading"] > 0.0
    rates, grade = found["IMUCALD_Rates"][-1], found["IMUCALD_Grade"][-1]
    assert [rates[f"FreeRate{a}"] for a in "XYZ"] == pytest.approx([0.0, 0.0, 0.0], abs=0.03)
    assert grade["Grade"] == pytest.approx(6.0, abs=0.4)
    assert grade["DeviationGrade"] > 0.0
    assert grade["DeviationRate"] > 0.0
    counters = [a["Counter"] for a in angles]
    assert counters == [k % 16 for k in range(len(counters))]
    name, content = engine.consumers[0].summary()
    assert name == "attitude"
    assert content["pitch_deg"] == pytest.approx(last["Pitch"], abs=0.05)
    assert json.dumps(content, allow_nan=False)


@pytest.mark.parametrize("method", ["filter", "compensation"])
def test_the_corrected_acceleration_is_gravity_also_while_speed_changes(
    tmp_path, bus, out_dbc, method
):
    """Method B's result (its title), on the bus and in JSON, in vehicle axes."""
    text = CAR.replace("rate: 5", f"rate: 5, method: {method}, compensation: {{send: true}}")
    engine = engine_for(load(text, tmp_path, DBC))
    found = by_name(out_dbc, live(engine, car_frames(bus)))
    free, slope = found["IMUCALD_FreeAcceleration"], math.atan(0.06)
    assert len(free) == len(found["IMUCALD_Attitude"])
    assert (free[0]["FreeAccelX"], free[0]["State"]) == (None, 0)
    gravity = [G * math.sin(slope), 0.0, G * math.cos(slope)]
    # 20 s of rest are too short for B alone to know the gyroscope's error: 0.3 deg/s at 16 m/s
    bound = 0.05 if method == "filter" else 0.09
    for one in free[5 * 22 : 5 * 27]:  # 2 m/s2 all the while
        assert [one[f"FreeAccel{a}"] for a in "XYZ"] == pytest.approx(gravity, abs=bound)
    content = engine.consumers[0].summary()[1]["free_acceleration_mps2"]
    assert content == pytest.approx(gravity, abs=bound)
    plain = engine_for(load(CAR, tmp_path, DBC))
    assert "IMUCALD_FreeAcceleration" not in by_name(out_dbc, live(plain, car_frames(bus, 30.0)))


def test_deviations_are_no_smaller_than_the_mounts(tmp_path, bus, out_dbc):
    engine = engine_for(load(CAR, tmp_path, DBC))
    tilt = math.radians(0.8)
    known = engine.pipeline.estimator.estimate()
    unsure = MountEstimate(known.state, MOUNT, np.diag([tilt**2, 4 * tilt**2, 1e-6]))
    engine.pipeline.estimator.estimate = lambda: unsure
    found = by_name(out_dbc, live(engine, car_frames(bus)))
    deviation = found["IMUCALD_AttitudeDeviation"][-1]
    assert 0.8 <= deviation["DeviationRoll"] < 1.1
    assert 1.6 <= deviation["DeviationPitch"] < 1.8
    assert deviation["State"] == 2  # settling: 1.6 deg is too much
    assert found["IMUCALD_Grade"][-1]["DeviationGrade"] > 100.0 * math.tan(2 * tilt)


@pytest.mark.parametrize("method", ["filter", "compensation"])
def test_live_is_replay_bit_for_bit(tmp_path, bus, method):
    text = CAR.replace("rate: 5", f"rate: 10, method: {method}")
    loaded = load(text, tmp_path, DBC)
    frames = car_frames(bus, 40.0)
    frames = [f for f in frames if not 30.0 < f[0] < 33.0]  # a hole
    frames += [(t + 100.0, i, d) for t, i, d in frames[:600]]  # the clock is set
    one, other = engine_for(loaded), engine_for(loaded)
    expected = live(one, frames)
    rng = np.random.default_rng(4)
    found, start = [], 0
    while start < len(frames):
        stop = start + int(rng.integers(1, 500))
        found += frames_of(other.columns(columns_of(frames[start:stop])))
        start = stop
    assert found == expected
    assert one.consumers[0].summary() == other.consumers[0].summary()
    silent = engine_for(loaded)
    silent.columns(columns_of(frames), keep=False)
    assert silent.sent == one.sent


def test_a_silent_sensor_is_not_available(tmp_path, bus, out_dbc):
    frames = [f for f in car_frames(bus, 40.0) if f[1] == 514 or f[0] < 30.0]
    found = by_name(out_dbc, live(engine_for(load(CAR, tmp_path, DBC)), frames))
    assert found["IMUCALD_Attitude"][-1]["State"] == 0
    assert found["IMUCALD_Attitude"][-1]["Roll"] is None
    assert found["IMUCALD_Rates"][-1]["FreeRateX"] is None


def test_a_walk_comes_out_step_by_step(tmp_path, bus, out_dbc):
    w = walk(CARRYINGS[1], 1.3, seconds=40.0, seed=8, turns_deg=(), disturbance_ut=0.5)
    loaded = load(PHONE, tmp_path, DBC)
    frames = phone_frames(bus, w)
    sent = live(make_engine(loaded), frames)
    found = by_name(out_dbc, sent)["IMUCALD_TravelDirection"]
    last = [row for row in found if row["State"] in (2, 3)][-1]
    assert abs(last["StepCount"] - w.steps) <= 2
    course = math.degrees(w.course[len(w.course) // 2])
    assert abs(math.remainder(last["TravelHeading"] - course, 360.0)) < 30.0
    assert found[0]["TravelHeading"] is None
    assert found[-1]["State"] == 1
    other = make_engine(loaded)
    assert frames_of(other.columns(columns_of(frames))) == sent


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (CAR.replace("  gyroscope: {x: GYR.GX, y: GYR.GY, z: GYR.GZ}\n", ""), "signals.gyroscope"),
        (CAR.replace("rate: 5", "filter: {heading: magnetometer}"), "signals.magnetometer"),
        (CAR.replace("rate: 5", "filter: {heading: signal}"), "signals.heading"),
        (CAR.replace(", z: ACC.Z}", "}"), "all three axes"),
        (CAR + "travel_direction: {enabled: true}\n", "signals.magnetometer or signals.heading"),
    ],
)
def test_a_missing_input_is_one_clear_line(tmp_path, text, reason):
    with pytest.raises(ConfigError, match=reason) as error:
        make_engine(load(text, tmp_path, DBC))
    assert "config.yaml:" in str(error.value)


@pytest.mark.parametrize("state", [MountState.SUSPECT, MountState.RECALIBRATING])
def test_of_a_mount_that_is_doubted_there_is_no_attitude_and_after_it_a_new_one(
    state, tmp_path, bus, out_dbc
):
    engine = engine_for(load(CAR, tmp_path, DBC))
    found = {}
    for t, can_id, data in car_frames(bus, 70.0):
        engine.pipeline.estimator.state = state if 40.0 <= t < 50.0 else MountState.USABLE
        for one in by_name(out_dbc, engine.frame(t, can_id, data))["IMUCALD_Attitude"]:
            found[t] = one
    states = {t: one["State"] for t, one in found.items()}
    assert {s for t, s in states.items() if 30.0 < t < 40.0} == {3}
    doubted = [one for t, one in found.items() if 41.5 < t < 50.0]
    assert len(doubted) > 10
    assert all(one["State"] == 0 and one["Roll"] is None for one in doubted)
    assert {s for t, s in states.items() if 50.5 < t < 52.5} <= {0, 1, 2}, "it begins again"
    assert {s for t, s in states.items() if t > 65.0} == {3}


def test_of_a_restored_mount_the_attitude_is_settling(tmp_path, bus, out_dbc):
    engine = engine_for(load(CAR, tmp_path, DBC))
    engine.pipeline.estimator.state = MountState.RESTORED
    frames = by_name(out_dbc, live(engine, car_frames(bus)))["IMUCALD_Attitude"]
    assert frames[-1]["State"] == 2
    assert frames[-1]["Pitch"] is not None


def test_what_cannot_be_is_left_out_and_counted(tmp_path):
    loaded = load(CAR + "travel_direction: {enabled: false}\n", tmp_path, DBC)
    engine = engine_for(loaded)
    (consumer,) = engine.consumers
    rotation = Correction.turning(MOUNT)
    rng = np.random.default_rng(2)
    for k in range(2000):
        t = 0.02 * k
        consumer.sample(t, "speed", (0.0,), rotation)
        consumer.sample(t, "gyro", tuple(rng.normal(0.0, 0.001, 3).tolist()), rotation)
        consumer.sample(t, "accel", tuple((MOUNT.T @ [0.0, 0.0, G]).tolist()), rotation)
        if k % 100 == 50:
            for bad in (1e30, math.inf, -math.inf, math.nan):
                consumer.sample(t, "gyro", (0.0, bad, 0.0), rotation)
                consumer.sample(t, "accel", (bad, 0.0, 0.0), rotation)
                consumer.sample(t, "speed", (bad,), rotation)
                consumer.sample(t, "heading", (bad,), rotation)
                consumer.sample(t, "mag", (bad, 0.0, 0.0), rotation)
    assert consumer.rejected == 20 * 20
    _, content = consumer.summary()
    assert content["state"] == "relative_heading"
    assert content["roll_deg"] == pytest.approx(0.0, abs=0.05)


@pytest.mark.slow
@given(st.lists(st.tuples(
    st.sampled_from(ORDER), st.floats(0.0, 3.0),
    st.tuples(*[st.floats(allow_nan=True, allow_infinity=True) | st.floats(-20, 20)] * 3),
), max_size=300))  # fmt: skip
@settings(max_examples=60, deadline=None)
def test_nothing_from_a_bus_breaks_a_consumer(samples):
    with tempfile.TemporaryDirectory() as name:
        text = PHONE.replace("enabled: true", "enabled: true}\nattitude: {enabled: true")
        engine = engine_for(load(text, Path(name), DBC))
    attitude, travel = engine.consumers
    t = 0.0
    impossible = {attitude: 0, travel: 0}
    for k, (channel, pause, values) in enumerate(samples):
        t += pause * pause * 0.1
        rotation = Correction.turning(rotation_from_angles(0.1, 0.2, 0.001 * k))
        wide = values if channel in ("gyro", "mag", "accel") else values[:1]
        for consumer in engine.consumers:
            if channel in consumer.channels:
                consumer.sample(t, channel, wide, rotation)
                impossible[consumer] += not all(abs(v) < 1e4 for v in wide)
            for _, data in consumer.tick(k):
                assert len(data) == 8
    for consumer in engine.consumers:
        _, content = consumer.summary()
        assert not re.search("NaN|Infinity", json.dumps(content))
    assert attitude.rejected >= impossible[attitude]
    assert travel.travel.rejected >= impossible[travel]
    lie_still(attitude, t + 60.0)
    _, content = attitude.summary()
    assert content["roll_deg"] == pytest.approx(0.0, abs=0.5), "it finds back to the truth"
    assert content["pitch_deg"] == pytest.approx(0.0, abs=0.5)


def lie_still(consumer, start):
    """A minute of a vehicle at rest, after a jump of time."""
    rotation = Correction.turning(MOUNT)
    gravity = tuple((MOUNT.T @ [0.0, 0.0, G]).tolist())
    consumer.gap()
    for k in range(3000):
        t = start + 0.02 * k
        consumer.sample(t, "speed", (0.0,), rotation)
        consumer.sample(t, "gyro", (0.0, 0.0, 0.0), rotation)
        consumer.sample(t, "accel", gravity, rotation)


def test_off_by_default(tmp_path):
    text = CAR.replace("attitude: {enabled: true, rate: 5}\n", "")
    engine = make_engine(load(text, tmp_path, DBC))
    assert engine.consumers == ()
    assert not engine.output.can_ids & set(range(0x646, 0x64B))


def written(path, frames):
    lines = [f"({1.6e9 + t:.6f}) can0 {i:03X}#{d.hex().upper()}\n" for t, i, d in frames]
    path.write_text("".join(lines))
    return path


def test_walk_reports_every_step(tmp_path, bus, capsys):
    w = walk(CARRYINGS[0], 1.3, seconds=20.0, seed=8)
    loaded = load(PHONE, tmp_path, DBC)
    loaded.path.write_text(PHONE)
    log = written(tmp_path / "walk.log", phone_frames(bus, w))
    config = str(loaded.path)
    assert main(["walk", str(log), "--config", config, "--json", "--quiet"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert abs(result["steps"] - w.steps) <= 1
    assert len(result["track"]) == result["steps"]
    step = result["track"][-1]
    assert {"t_s", "heading_deg", "compass_deg", "alternative_deg", "published_deg", "tilt_deg",
            "correlation_deg", "chosen", "turn"} <= set(step)  # fmt: skip
    assert step["heading_deg"] == step["alternative_deg"]
    assert main(["replay", str(log), "--config", config, "--json", "-", "--quiet"]) == 0
    replayed = json.loads(capsys.readouterr().out)["travel_direction"]
    assert replayed["ambiguous"] == step["ambiguous"]
    loaded.path.write_text(PHONE.replace("enabled: true", "method: published"))
    assert main(["walk", str(log), "--config", config, "--json", str(tmp_path / "r.json")]) == 0
    shown = capsys.readouterr().out
    assert "published" in shown
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["track"][-1]["heading_deg"] == result["track"][-1]["published_deg"]


def test_replay_says_or_opposite_as_walk_does():
    travel = {"steps": 30, "heading_deg": 129.0, "ambiguous": True}
    (text,) = _beside({"travel_direction": travel})
    assert text == "travel direction: 30 steps, the last towards 129 deg or opposite"


def test_walk_without_a_compass_is_refused(tmp_path, capsys):
    path = tmp_path / "config.yaml"
    (tmp_path / "bus.dbc").write_text(DBC)
    path.write_text(CAR)
    log = written(tmp_path / "walk.log", [])
    assert main(["walk", str(log), "--config", str(path)]) == 1
    assert "magnetometer or a heading" in capsys.readouterr().err


@pytest.mark.skipif(not (DATA / "ped_ethz").is_dir(), reason="measured data is not here")
def test_walk_reads_a_measured_walk(tmp_path, capsys):
    with gzip.open(DATA / "ped_ethz" / "drive.log.gz", "rt") as file:
        lines = file.readlines()
    log = tmp_path / "part.log"
    log.write_text("".join(lines[len(lines) // 3 : len(lines) // 2]))
    config = Path(__file__).parents[2] / "benchmarks" / "measured_drives" / "ped_ethz.yaml"
    assert main(["walk", str(log), "--config", str(config), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert 1.4 < result["cadence_hz"] < 2.2
    assert result["frames"]["rejected"] == {}


@pytest.mark.parametrize(
    ("stated", "step"), [("", 0.01), (", filter: {gyro_resolution_deg_s: 0.5}", 0.5)]
)
def test_the_step_of_the_gyroscope_is_the_databases_where_none_is_stated(stated, step, tmp_path):
    engine = make_engine(load(CAR.replace(", rate: 5", stated), tmp_path, DBC))
    (attitude,) = engine.consumers
    assert attitude.filter.settings.filter.gyro_resolution_deg_s == pytest.approx(step)
