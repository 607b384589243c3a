"""A sensor that is faulty sends nothing and teaches nothing; the others go on."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from engine_bus import Fine, Sender, columns_of, engine_of, frames_of, load
from imucald.can.dbc.decode import compile_decode
from imucald.core.samples import GRAVITY
from imucald.motion.ticks import ACCEL, GYRO
from imucald.runtime.output.output_frames import output_database
from imucald.runtime.summary import RunCounts, summary

CONFIG = """
database: bus.dbc
signals:
  accelerometer: {x: ACC.AX, y: ACC.AY, z: ACC.AZ}
  gyroscope: {x: GYR.GX, y: GYR.GY, z: GYR.GZ}
  speed: SPD.V
  parallel:
    - {name: second, kind: acceleration, x: MAG.MX, y: MAG.MY, z: MAG.MZ, id: 0x650}
""".replace("MAG.MX", "{signal: MAG.MX, unit: m/s^2}").replace(
    "MAG.MY", "{signal: MAG.MY, unit: m/s^2}"
).replace("MAG.MZ", "{signal: MAG.MZ, unit: m/s^2}")  # fmt: skip
START, STOP, END = 20.0, 26.0, 45.0
PERIOD = 0.02
"""Of both sensors [s]."""
IDS = {"accel": 0x640, "gyro": 0x641, "health": 0x645, "second": 0x650}


@cache
def traffic(frozen: str) -> list[tuple[float, int, bytes]]:
    """Frames of a car on the road; one axis of `frozen` keeps its value for some seconds."""
    rng, sender = np.random.default_rng(0), Sender()
    force, rate = np.array([0.0, 0.0, GRAVITY]), np.zeros(3)
    frames = []
    for i in range(round(END / PERIOD)):
        t = 1e6 + PERIOD * i
        now = force + 0.3 * rng.standard_normal(3), rate + 2.0 * rng.standard_normal(3)
        if START <= PERIOD * i < STOP:
            which = 0 if frozen == "accel" else 1
            now[which][1] = (force, rate)[which][1]
        force, rate = np.array([0.0, now[0][1], GRAVITY]), np.array([0.0, now[1][1], 0.0])
        frames.append(sender.frame(t, "ACC", AX=now[0][0], AY=now[0][1], AZ=now[0][2]))
        frames.append(sender.frame(t + 0.001, "GYR", GX=now[1][0], GY=now[1][1], GZ=now[1][2]))
        if i % 5 == 0:
            frames.append(sender.frame(t + 0.002, "SPD", V=50.0))
            frames.append(sender.frame(t + 0.003, "MAG", MX=1.0, MY=2.0, MZ=3.0))
        force[1] *= 0.5
        rate[1] *= 0.5
    return frames


def values_of(out: list[tuple[int, bytes]], name: str, signal: str) -> np.ndarray:
    message = {"health": "IMUCALD_Health", "gyro": "IMUCALD_AngularRate"}
    plan = compile_decode(
        output_database().message(message.get(name, "IMUCALD_Acceleration")), [signal]
    )
    return np.array([plan.decode(data)[0] for can_id, data in out if can_id == IDS[name]])


@pytest.mark.parametrize("frozen", ["accel", "gyro"])
def test_a_stuck_axis_takes_its_sensor_out_and_no_other(frozen: str, tmp_path) -> None:
    loaded = load(CONFIG, tmp_path)
    estimator = Fine()
    engine = engine_of(loaded, estimator)
    frames = traffic(frozen)
    out = frames_of(engine.columns(columns_of(frames)))
    other = "gyro" if frozen == "accel" else "accel"
    t = PERIOD * np.arange(round(END / PERIOD))
    quality = values_of(out, frozen, "Quality")
    bad = t[quality == 0.0]
    bad = bad[bad > 1.0]
    assert START < bad[0] < START + 2.0
    assert STOP + 9.0 < bad[-1] < STOP + 11.0
    assert np.allclose(np.diff(bad), PERIOD), "without a break"
    assert (values_of(out, other, "Quality")[50:] == 3.0).all()
    second = values_of(out, "second", "Quality")[10:]
    assert (second == 0.0).any() == (frozen == "accel")
    flags = values_of(out, "health", "SensorFaulty")
    assert 14 <= flags.sum() <= 17, "once a second"
    row = ACCEL.n if frozen == "accel" else GYRO.n
    counts = np.array([np.frombuffer(r)[row] for r in estimator.rows])
    assert (counts[int(10 * bad[0]) + 1 : int(10 * bad[-1])] == 0.0).all()
    assert (counts[: int(10 * START)] > 0.0).all()
    result = summary(engine, RunCounts(len(frames), len(frames), {}), END)["signal_health"]
    (event,) = result["events"]
    assert (event["sensor"], event["fault"], event["axes"]) == (frozen, "stuck", "y")
    assert result["sensors"] == {"accel": {}, "gyro": {}}


@pytest.mark.parametrize("frozen", ["accel", "gyro"])
def test_live_and_by_columns_the_same_frames_come(frozen: str, tmp_path) -> None:
    loaded = load(CONFIG, tmp_path)
    live, columns = engine_of(loaded, Fine()), engine_of(loaded, Fine())
    frames = traffic(frozen)
    expected = [out for frame in frames for out in live.frame(*frame)]
    rng, got, start = np.random.default_rng(1), [], 0
    while start < len(frames):
        stop = start + int(rng.integers(1, 450))
        got += frames_of(columns.columns(columns_of(frames[start:stop])))
        start = stop
    assert got == expected
    assert live.sent == columns.sent == len(expected)
    assert live.health() == columns.health()


@pytest.mark.parametrize("frozen", ["accel", "gyro"])
def test_the_attitude_is_not_available_while_a_sensor_of_it_is_faulty(frozen, tmp_path) -> None:
    loaded = load(CONFIG + "attitude: {enabled: true, rate: 10}\n", tmp_path)
    live, columns = engine_of(loaded, Fine()), engine_of(loaded, Fine())
    frames = traffic(frozen)
    out = [x for frame in frames for x in live.frame(*frame)]
    assert frames_of(columns.columns(columns_of(frames))) == out
    can_id = loaded.config.output.ids.attitude
    plan = compile_decode(output_database().message("IMUCALD_Attitude"), ["Roll", "State"])
    rows = [plan.decode(data) for sent_id, data in out if sent_id == can_id]
    state = np.array([row[1] for row in rows])
    t = 0.1 * np.arange(len(state))
    assert (state[(t > 10.0) & (t < START)] > 0.0).all()
    assert (state[(t > START + 2.2) & (t < STOP + 9.0)] == 0.0).all()
    assert (state[t > STOP + 13.0] > 0.0).all()


def test_a_flood_of_invalid_frames_is_answered_once_a_cycle(tmp_path) -> None:
    loaded = load(CONFIG, tmp_path)
    live, columns = engine_of(loaded, Fine()), engine_of(loaded, Fine())
    frames = [(1e6 + 0.0001 * i, 0x100, b"") for i in range(20_000)]
    out = [x for frame in frames for x in live.frame(*frame)]
    assert 190 <= sum(can_id == IDS["accel"] for can_id, _ in out) <= 220, "2 s, 10 ms are stated"
    assert frames_of(columns.columns(columns_of(frames))) == out
