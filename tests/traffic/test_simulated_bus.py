"""A drive on the bus: what a reader gets back, checked with cantools, crccheck and a slow queue."""

import heapq
import itertools
import re

import cantools
import numpy as np
import pytest
from crccheck.crc import Crc8SaeJ1850

from imucald.can.columns import FrameColumns
from imucald.config import parse_config
from imucald.core.errors import ConfigError, LogError
from imucald.inputs.wiring import compile_router
from imucald.simulation import VehicleModel, random_model, simulate
from imucald.traffic.can_log import EPOCH_S, bus_frames, live_frames, write_log
from imucald.traffic.drive_encoder import BusEncoder, example_config
from imucald.traffic.other_units import arbitrated, background

LINE = re.compile(r"\((\d+\.\d{6})\) (\w+) ([0-9A-F]{3}|[0-9A-F]{8})#([0-9A-F]*)")


@pytest.fixture(scope="module")
def drive():
    changes = {"mag.enabled": True, "heading.enabled": True, "speed.loss": 0.05}
    return simulate(random_model(3).with_changes(changes), 3, 0.5)


@pytest.fixture(scope="module")
def encoder():
    return BusEncoder(example_config())


@pytest.fixture(scope="module")
def example():
    loaded = example_config()
    return cantools.database.load_file(loaded.database_path(loaded.config.database[0]))


@pytest.fixture(scope="module")
def lines(drive, encoder, tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "drive.log"
    count = write_log(drive, path, encoder, with_background=True)
    text = path.read_text().splitlines()
    assert len(text) == count
    found = [LINE.fullmatch(line) for line in text]
    assert all(found)
    return [(float(m[1]) - EPOCH_S, m[2], int(m[3], 16), bytes.fromhex(m[4])) for m in found if m]


def decoded(lines, example, message):
    frame = example.get_message_by_name(message)
    chosen = [(t, data) for t, _, can_id, data in lines if can_id == frame.frame_id]
    return np.array([t for t, _ in chosen]), [
        frame.decode(data, decode_choices=False) for _, data in chosen
    ]


@pytest.mark.parametrize(
    ("channel", "message", "signals", "to_si", "step"),
    [
        ("accel", "IMU_Accel", ("AccelX", "AccelY", "AccelZ"), 1.0, 0.002),
        ("gyro", "IMU_Gyro", ("RateX", "RateY", "RateZ"), np.pi / 180.0, 0.01),
        ("speed", "ESC_Speed", ("VehicleSpeed",), 1 / 3.6, 0.01),
        ("steering", "EPS_SteeringAngle", ("SteeringWheelAngle",), np.pi / 180, 0.1),
        ("yaw_rate", "ESC_Dynamics", ("YawRate",), np.pi / 180, 0.01),
        ("lateral_accel", "ESC_Dynamics", ("LateralAccel",), 9.80665, 0.0005),
        ("temperature", "IMU_Temperature", ("SensorTemperature",), 1.0, 0.5),
    ],
)
def test_cantools_reads_the_samples_back(
    drive, lines, example, channel, message, signals, to_si, step
):
    t, frames = decoded(lines, example, message)
    series = drive.samples[channel]
    assert len(frames) == len(series.t)
    values = np.array([[frame[name] for name in signals] for frame in frames]).squeeze() * to_si
    np.testing.assert_allclose(values, series.values, atol=0.5001 * step * to_si)
    # Waiting for a bus that is half full.
    assert np.all(t - series.t > 1e-4)
    assert np.percentile(t - series.t, 99) < 5e-3


def test_the_daemons_own_reader_takes_every_frame(drive, encoder):
    router = compile_router(example_config())
    counts: dict[str, int] = {}
    for block in bus_frames(drive, encoder):
        for channel, series in router.columns(block.t, block).samples.items():
            counts[channel] = counts.get(channel, 0) + len(series.t)
    assert counts["accel"] == len(drive.samples["accel"].t)
    assert counts["wheel_speeds"] == len(drive.samples["wheel_speeds"].t)
    # One frame in twenty was lost: the counter says so, and no other frame is refused for it.
    assert not router.rejected
    assert sum(route.checker.lost for route in router.routes) > 10


def test_checksums_are_crc8_j1850_over_id_and_data(lines):
    protected = {0x200: 7, 0x201: 7, 0x0C2: 3, 0x130: 7, 0x1A0: 3}
    seen = set()
    for _, _, can_id, data in lines:
        if can_id in protected:
            at = protected[can_id]
            assert data[at] == Crc8SaeJ1850.calc(can_id.to_bytes(2, "big") + data[:at])
            seen.add(can_id)
    assert seen == set(protected)


def test_counters_count_frames_sent_also_the_lost_ones(drive, lines, example):
    _, accel = decoded(lines, example, "IMU_Accel")
    counts = np.array([frame["AccelCounter"] for frame in accel])
    assert np.all(np.diff(counts) % 16 == 1)
    t, speed = decoded(lines, example, "ESC_Speed")
    steps = np.diff([frame["SpeedCounter"] for frame in speed]) % 16
    np.testing.assert_array_equal(steps[:200], np.rint(np.diff(t)[:200] / 0.02).astype(int) % 16)
    assert np.mean(steps == 2) == pytest.approx(0.05, abs=0.02)


def test_stamps_never_go_back_and_frames_never_overlap(lines):
    t = np.array([line[0] for line in lines])
    bits = np.array([47 + 8 * len(line[3]) for line in lines])
    assert np.all(np.diff(t) >= bits[1:] / 500e3 * 0.99)


def test_the_bus_is_as_full_as_a_real_one(drive, lines, encoder):
    rate = len(lines) / drive.duration_s
    ours = sum(can_id in encoder.ids for _, _, can_id, _ in lines)
    assert 2500 < rate < 3100
    assert 0.12 < ours / len(lines) < 0.25


def queue_reference(t, can_id, durations):
    """Arbitration frame by frame: when the bus is free, the lowest id that waits is sent."""
    order = sorted(range(len(t)), key=lambda i: t[i])
    waiting, sent, now, k = [], [], 0.0, 0
    while k < len(order) or waiting:
        if not waiting:
            now = max(now, t[order[k]])
        while k < len(order) and t[order[k]] <= now:
            heapq.heappush(waiting, (can_id[order[k]], t[order[k]], order[k]))
            k += 1
        _, _, i = heapq.heappop(waiting)
        now += durations[i]
        sent.append((i, now))
    return sent


@pytest.mark.parametrize("load", [0.3, 0.7, 0.9])
def test_arbitration_is_that_of_a_queue_with_priorities(load):
    rng = np.random.default_rng(1)
    n = 3000
    length = rng.integers(0, 9, n).astype(np.uint8)
    durations = (47 + 8.0 * length) * 1.1 / 500e3
    t = np.sort(rng.uniform(0.0, durations.sum() / load, n))
    can_id = rng.permutation(n).astype(np.uint32) % 0x7FF
    frames = FrameColumns(
        t, can_id, length, np.arange(8 * n).astype(np.uint8).reshape(n, 8),
        np.zeros(n, np.uint8), ("can0",),
    )  # fmt: skip
    found = arbitrated(frames, 500e3, 0.0)
    expected = queue_reference(t.tolist(), can_id.tolist(), durations.tolist())
    np.testing.assert_array_equal(found.can_id, can_id[[i for i, _ in expected]])
    assert np.any(np.diff(t[[i for i, _ in expected]]) < 0.0)
    np.testing.assert_allclose(found.t, [end for _, end in expected], atol=1e-9)


def test_background_is_the_same_traffic_in_every_block():
    whole = background(1, 2300.0, frozenset({0x200}), 0.0, 20.0)
    assert 0x200 not in set(whole.can_id.tolist())
    assert len(whole) == pytest.approx(46_000, rel=0.06)
    second = background(1, 2300.0, frozenset({0x200}), 10.0, 20.0)
    cycles = {int(i): np.sum(whole.can_id == i) for i in np.unique(whole.can_id)}
    for can_id, count in cycles.items():
        assert abs(2 * np.sum(second.can_id == can_id) - count) <= 2


def test_live_frames_are_those_of_the_log(drive, encoder, lines):
    for (t, can_id, data), line in itertools.islice(
        zip(live_frames(drive, encoder, True), lines, strict=True), 5000
    ):
        assert (can_id, data) == (line[2], line[3])
        assert t == pytest.approx(line[0], abs=1e-6)


OTHER_DBC = """VERSION ""
NS_ :
BS_:
BU_: A
BO_ 2566844926 ACC: 8 A
 SG_ AX : 7|16@0- (0.01,0) [0|0] "g" A
 SG_ AY : 23|16@0- (0.01,0) [0|0] "g" A
BO_ 100 MOVE: 8 A
 SG_ V : 0|16@1- (0.1,5) [0|0] "mph" A
 SG_ N : 16|8@1+ (1,0) [0|255] "" A
 SG_ TEMP : 24|16@1- (0.1,0) [0|0] "degF" A
"""


def test_any_configuration_can_be_written(tmp_path):
    (tmp_path / "other.dbc").write_text(OTHER_DBC)
    config = parse_config(
        """
database: other.dbc
signals:
  accelerometer: {x: ACC.AX, y: {signal: ACC.AY, sign: -1}}
  speed: {signal: MOVE.V, offset: 1.5}
  temperature: MOVE.TEMP
  brake: {signal: MOVE.N, equals: [0, 3]}
""",
        tmp_path / "config.yaml",
    )
    changes = {"route.standing_first_s": 0.0, "speed.lsb": 0.0, "speed.noise_mps": 0.0}
    drive = simulate(VehicleModel().with_changes(changes), 2, 0.5)
    other = cantools.database.load_string(OTHER_DBC)
    by_id: dict[int, list] = {}
    for t, can_id, data in live_frames(drive, BusEncoder(config)):
        by_id.setdefault(can_id & 0x1FFFFFFF, []).append((t, data))
    assert set(by_id) == {2566844926 & 0x1FFFFFFF, 100}
    accel = [other.get_message_by_name("ACC").decode(d) for _, d in by_id[2566844926 & 0x1FFFFFFF]]
    series = drive.samples["accel"].values
    np.testing.assert_allclose([f["AX"] for f in accel], series[:, 0] / 9.80665, atol=0.0051)
    np.testing.assert_allclose([f["AY"] for f in accel], -series[:, 1] / 9.80665, atol=0.0051)
    move = [other.get_message_by_name("MOVE").decode(d) for _, d in by_id[100]]
    speed = drive.samples["speed"].values
    np.testing.assert_allclose([f["V"] + 1.5 for f in move], speed / 0.44704, atol=0.051)
    assert {f["N"] for f in move} <= {0, 1}
    celsius = drive.samples["temperature"].values[-1]
    assert move[-1]["TEMP"] == pytest.approx(celsius * 1.8 + 32.0, abs=0.051)


def test_a_signed_speed_is_negative_in_reverse(tmp_path):
    (tmp_path / "other.dbc").write_text(OTHER_DBC)
    text = """
database: other.dbc
signals: {accelerometer: {x: ACC.AX, y: ACC.AY}, speed: MOVE.V}
"""
    encoder = BusEncoder(parse_config(text, tmp_path / "config.yaml"))
    for seed in range(30):
        drive = simulate(VehicleModel().with_changes({"route.kind": "city"}), seed, 5.0)
        if np.min(drive.truth.speed) < -1.0:
            break
    message = cantools.database.load_string(OTHER_DBC).get_message_by_name("MOVE")
    speeds = [
        message.decode(data)["V"]
        for _, can_id, data in live_frames(drive, encoder)
        if can_id == 100
    ]
    assert min(speeds) * 0.44704 == pytest.approx(np.min(drive.truth.speed), abs=0.2)


def test_expressions_are_left_out_and_named(tmp_path):
    (tmp_path / "other.dbc").write_text(OTHER_DBC)
    raw = "{raw: {id: 0x7E8, value: 'data[3]'}, unit: km/h}"
    only = f"database: other.dbc\nsignals: {{accelerometer: {{x: {raw}, y: {raw}, z: {raw}}}}}\n"
    only = only.replace("km/h", "g")
    with pytest.raises(ConfigError, match="no frame can be written"):
        BusEncoder(parse_config(only, tmp_path / "config.yaml"))
    signals = f"{{accelerometer: {{x: ACC.AX, y: ACC.AY}}, speed: {raw}}}"
    text = f"database: other.dbc\nsignals: {signals}\n"
    encoder = BusEncoder(parse_config(text, tmp_path / "config.yaml"))
    assert encoder.left_out == ["id 0x7E8"]


def test_a_log_that_cannot_be_written_is_an_error(drive, encoder, tmp_path):
    with pytest.raises(LogError, match="cannot be written"):
        write_log(drive, tmp_path / "missing" / "x.log", encoder)
