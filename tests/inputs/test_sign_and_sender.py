"""A sign in a bit of its own, several senders of a message, a raw source of a protected one."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine_bus import columns_of, load
from imucald.can.columns import CAN_EFF_FLAG
from imucald.core.errors import ConfigError
from imucald.inputs.column_samples import MAX_SKEW
from imucald.inputs.sender_choice import SENDER_SETTLING
from imucald.inputs.wiring import compile_router
from imucald.service.saved_state import state_key
from imucald.traffic.drive_encoder import BusEncoder

SIGNS = """VERSION ""
BU_: CAR
BO_ 253 ESP_02: 8 CAR
 SG_ Rate : 0|14@1+ (0.01,0) [0|163.82] "deg/s" CAR
 SG_ VZ_Rate : 14|1@1+ (1,0) [0|1] "" CAR
 SG_ Two : 16|2@1+ (1,0) [0|3] "" CAR
 SG_ Signed : 24|8@1- (1,0) [0|0] "deg/s" CAR
BO_ 256 ACC: 8 CAR
 SG_ AX : 0|15@1+ (0.002,0) [0|60] "m/s^2" CAR
 SG_ VX : 15|1@1+ (1,0) [0|1] "" CAR
 SG_ AY : 22|15@0+ (0.002,0) [0|60] "m/s^2" CAR
 SG_ VY : 23|1@1+ (1,0) [0|1] "" CAR
 SG_ AZ : 32|16@1- (0.002,0) [-60|60] "m/s^2" CAR
BO_ 257 OTHER: 1 CAR
 SG_ Bit : 0|1@1+ (1,0) [0|1] "" CAR
"""
SIGNED = """database: bus.dbc
signals:
  accelerometer:
    x: {signal: ACC.AX, sign_signal: ACC.VX}
    y: {signal: ACC.AY, sign_signal: ACC.VY, sign: -1, offset: 0.5}
    z: ACC.AZ
  yaw_rate: {signal: ESP_02.Rate, sign_signal: ESP_02.VZ_Rate}
"""


def yaw(source: str) -> str:
    return (
        "database: bus.dbc\nsignals:\n  accelerometer: {x: ACC.AX, y: ACC.AY, z: ACC.AZ}\n"
        f"  yaw_rate: {source}\n"
    )


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.binary(min_size=8, max_size=8)), max_size=12))
def test_a_sign_bit_is_read_alike_live_and_in_columns(tmp_path_factory, frames):
    loaded = load(SIGNED, tmp_path_factory.mktemp("signs"), SIGNS)
    live, replayed = compile_router(loaded), compile_router(loaded)
    rows = [(0.01 * i, 256 if is_accel else 253, data) for i, (is_accel, data) in enumerate(frames)]
    found: dict[str, list[list[float]]] = {}
    for t, can_id, data in rows:
        samples, _, _ = live.frame(t, can_id, data)
        for channel, values in samples:
            found.setdefault(channel, []).append(list(values))
        word = int.from_bytes(data, "little")
        if can_id == 253 and samples:
            expected = (word & 0x3FFF) * 0.01 * (-1 if word >> 14 & 1 else 1)
            assert samples[0][1][0] == pytest.approx(math.radians(expected))
        if can_id == 256 and samples:
            x = (word & 0x7FFF) * 0.002 * (-1 if word >> 15 & 1 else 1)
            y = ((data[2] & 0x7F) << 8 | data[3]) * 0.002 * (-1 if data[2] >> 7 else 1)
            assert samples[0][1][:2] == pytest.approx([x, -(y + 0.5)])
    columns = columns_of(rows)
    routed = replayed.columns(columns.t, columns) if rows else None
    for channel, values in found.items():
        assert routed is not None
        again = routed.samples[channel].values
        assert again.reshape(len(values), -1).tolist() == values
    assert live.rejected == replayed.rejected


def test_a_magnitude_of_zero_is_no_saturated_sensor(tmp_path):
    router = compile_router(load(SIGNED, tmp_path, SIGNS))
    samples, refused, _ = router.frame(0.0, 256, bytes(8))
    assert samples[0][1] == pytest.approx([0.0, -0.5, 0.0])
    assert not refused


def test_a_speed_with_a_sign_bit_shows_reverse(tmp_path):
    text = yaw("ESP_02.Signed") + (
        "  speed: {signal: ESP_02.Rate, sign_signal: ESP_02.VZ_Rate, unit: km/h}\n"
    )
    router = compile_router(load(text, tmp_path, SIGNS))
    assert "reverse" in router.channels
    samples, _, _ = router.frame(0.0, 253, (36 * 100 + (1 << 14)).to_bytes(8, "little"))
    assert dict(samples)["speed"] == pytest.approx((10.0,))
    assert dict(samples)["reverse"] == (1.0,)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("{signal: ESP_02.Rate, sign_signal: ESP_02.Two}", "one bit"),
        ("{signal: ESP_02.Rate, sign_signal: OTHER.Bits}", "OTHER has no signal"),
        ("{signal: ESP_02.Rate, sign_signal: ESP_02.VZ}", "has no signal"),
        ("{signal: ESP_02.Signed, sign_signal: ESP_02.VZ_Rate}", "is signed already"),
        (
            "{signal: ESP_02.Rate, sign_signal: OTHER.Bit, source_address: 3}",
            "yaw_rate.sign_signal: .* OTHER is not a J1939 message",
        ),
        ("{raw: {id: 1, value: '1'}, unit: rad/s, sign_signal: ESP_02.VZ_Rate}", "needs 'signal'"),
    ],
)
def test_a_sign_signal_that_cannot_be_one_is_refused(tmp_path, source, words):
    with pytest.raises(ConfigError, match=words):
        compile_router(load(yaw(source), tmp_path, SIGNS))


APART = """database: bus.dbc
signals:
  accelerometer:
    x: {signal: ACC.AX, sign_signal: OTHER.Bit}
    y: {signal: ACC.AY, sign_signal: ACC.VY}
    z: ACC.AZ
  yaw_rate: {signal: ESP_02.Rate, sign_signal: OTHER.Bit, sign: -1}
"""


@settings(max_examples=100, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 2), st.floats(0.0, 0.12), st.binary(min_size=8, max_size=8)),
        max_size=20,
    ),
    st.integers(0, 20),
)
def test_a_sign_of_another_message_is_the_last_known_one_live_and_in_columns(
    tmp_path_factory, frames, cut
):
    loaded = load(APART, tmp_path_factory.mktemp("apart"), SIGNS)
    live, replayed = compile_router(loaded), compile_router(loaded)
    t, sign, seen = 0.0, math.nan, -math.inf
    rows, found = [], {"accel": [], "yaw_rate": []}
    for kind, later, data in frames:
        t += later
        rows.append((t, 257 if kind == 2 else (253, 256)[kind], data[:1] if kind == 2 else data))
        samples = dict(live.frame(*rows[-1])[0])
        for channel, values in samples.items():
            found[channel].append(list(values))
        if kind == 2:
            assert not samples
            sign, seen = (-1.0 if data[0] & 1 else 1.0), t
            continue
        known = t - seen <= MAX_SKEW
        assert known or not samples
        if known and kind == 0:
            rate = (int.from_bytes(data, "little") & 0x3FFF) * 0.01
            assert samples["yaw_rate"][0] == pytest.approx(math.radians(-sign * rate))
        if "accel" in samples:
            size = (int.from_bytes(data, "little") & 0x7FFF) * 0.002
            assert samples["accel"][0] == pytest.approx(sign * size)
    again = {"accel": [], "yaw_rate": []}
    for part in filter(None, (rows[:cut], rows[cut:])):
        columns = columns_of(part)
        for channel, series in replayed.columns(columns.t, columns).samples.items():
            again[channel] += series.values.reshape(len(series.t), -1).tolist()
    assert again == found
    assert live.rejected == replayed.rejected


def test_of_two_messages_one_takes_its_sign_from_another(tmp_path):
    text = APART.replace("OTHER.Bit}", "ESP_02.VZ_Rate}")
    words = "ESP_02: of two messages, only one may take its sign from another"
    with pytest.raises(ConfigError, match=f"OTHER and {words}"):
        compile_router(load(text, tmp_path, SIGNS))


@pytest.mark.parametrize(
    "moved", [("Bit : 0|1", "Bit : 6|1"), ("BO_ 257", "BO_ 300"), ("VY : 23|1", "VY : 50|1")]
)
def test_a_sign_bit_elsewhere_is_another_sensor_for_a_reload_and_a_saved_state(tmp_path, moved):
    keys, routers = [], []
    for k, database in enumerate((SIGNS, SIGNS.replace(*moved))):
        (tmp_path / str(k)).mkdir()
        loaded = load(APART, tmp_path / str(k), database)
        routers.append(compile_router(loaded))
        keys.append(state_key(loaded, routers[-1]).sensor)
    assert "accel" not in routers[1].same_sources(routers[0])
    assert keys[0] != keys[1]


def test_a_configuration_whose_signs_are_all_elsewhere_has_nothing_to_write(tmp_path):
    loaded = load(APART.replace(", sign_signal: OTHER.Bit, sign: -1", ""), tmp_path, SIGNS)
    assert BusEncoder(loaded).left_out == ["ACC"]
    text = APART[: APART.index("  yaw_rate")]
    with pytest.raises(ConfigError, match="no frame can be written"):
        BusEncoder(load(text, tmp_path, SIGNS))


def test_a_sign_lasts_a_stated_cycle_longer_and_a_reload_keeps_it(tmp_path):
    text = APART + "messages:\n  OTHER: {cycle_time: 0.5}\n"
    router = compile_router(load(text, tmp_path, SIGNS))
    router.frame(1.0, 257, b"\1")
    again = compile_router(load(text, tmp_path, SIGNS))
    again.go_on_from(router, again.same_sources(router))
    data = (1000).to_bytes(8, "little")
    assert dict(again.frame(1.59, 253, data)[0])["yaw_rate"] == pytest.approx((math.radians(10.0),))
    assert again.frame(1.61, 253, data)[1] == ["yaw_rate"], "counted as rejected"
    other = compile_router(
        load(text.replace("Rate, sign_signal: OTHER.Bit", "Rate"), tmp_path, SIGNS)
    )
    assert other.source("yaw_rate") != again.source("yaw_rate")


PGN = 0x98F02D00 - 0x80000000
J1939 = f"""VERSION ""
BU_: CAR
BO_ {(PGN | 0xFE) | CAN_EFF_FLAG} IMU: 8 CAR
 SG_ AX : 0|16@1- (0.001,0) [-30|30] "m/s^2" CAR
 SG_ AY : 16|16@1- (0.001,0) [-30|30] "m/s^2" CAR
 SG_ AZ : 32|16@1- (0.001,0) [-30|30] "m/s^2" CAR
 SG_ N : 48|4@1+ (1,0) [0|15] "" CAR
BO_ {0x18FEF1FE | CAN_EFF_FLAG} CCVS1: 8 CAR
 SG_ Speed : 8|16@1+ (0.00390625,0) [0|250] "km/h" CAR
BO_ 256 SHORT: 2 CAR
 SG_ Speed2 : 0|16@1+ (0.01,0) [0|250] "km/h" CAR
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
"""
AXES = "x: IMU.AX, y: IMU.AY, z: IMU.AZ"


def imu(address: int, x: int, count: int = 0) -> tuple[int, bytes]:
    data = x.to_bytes(2, "little") + bytes(4) + bytes([count]) + bytes(1)
    return PGN | address | CAN_EFF_FLAG, data


def both_ways(text: str, folder, frames: list[tuple[float, int, bytes]], channel: str = "accel"):
    """Samples of a channel: frame by frame, and the same in columns of two chunks."""
    loaded = load(text, folder, J1939)
    live, replayed = compile_router(loaded), compile_router(loaded)
    one = [
        list(values)
        for t, can_id, data in frames
        for found, values in live.frame(t, can_id, data)[0]
        if found == channel
    ]
    again: list[list[float]] = []
    for part in (frames[: len(frames) // 2], frames[len(frames) // 2 :]):
        columns = columns_of(part)
        samples = replayed.columns(columns.t, columns).samples.get(channel)
        if samples is not None:
            again += samples.values.reshape(len(samples.t), -1).tolist()
    assert one == again
    assert live.rejected == replayed.rejected
    return [round(values[0], 6) for values in one]


TWO = [
    (0.01 * i + shift, *imu(address, 1000 * k + 1000, i % 16))
    for i in range(300)
    for k, (address, shift) in enumerate([(0xE3, 0.0), (0xE2, 0.002)])
]


@pytest.mark.parametrize(
    "text",
    [
        f"signals: {{accelerometer: {{{AXES}, source_address: 0xE3}}}}",
        "signals:\n  accelerometer:\n" + "".join(
            f"    {a.lower()}: {{signal: IMU.A{a}, source_address: 0xE3}}\n" for a in "XYZ"
        ),
        f"signals: {{accelerometer: {{{AXES}}}}}\nmessages: {{IMU: {{source_address: 0xE3}}}}",
    ],
)  # fmt: skip
def test_one_sender_is_heard_where_it_is_named(tmp_path, text):
    assert set(both_ways(f"database: bus.dbc\n{text}\n", tmp_path, TWO)) == {1.0}


def test_each_sender_has_its_own_counter(tmp_path):
    text = (
        f"database: bus.dbc\nsignals: {{accelerometer: {{{AXES}, source_address: 0xE2}}, "
        f"parallel: [{{name: second, kind: acceleration, {AXES}, source_address: 0xE3, id: 1}}]}}\n"
        "messages: {IMU: {counter: {signal: N}}}\n"
    )
    assert len(both_ways(text, tmp_path, TWO)) == 300
    assert len(both_ways(text, tmp_path, TWO, "parallel/second")) == 300


def test_two_senders_are_never_mixed_into_one_sensor(tmp_path):
    text = f"database: bus.dbc\nsignals: {{accelerometer: {{{AXES}}}}}\n"
    found = both_ways(text, tmp_path, TWO)
    assert set(found[1:]) == {2.0}, "the lower address, after the other's first frame"
    alone = [frame for frame in TWO if frame[0] > SENDER_SETTLING + 0.5]
    late = [(0.01 * i, *imu(0xE3, 1000)) for i in range(199)] + alone
    assert set(both_ways(text, tmp_path, late)) == {1.0}, "the one that was there first stays"


OTHER_PGN = 0x18F02A00
PAIR = J1939.replace(
    "BO_ 256 SHORT",
    f"BO_ {(OTHER_PGN | 0xFE) | CAN_EFF_FLAG} GYR: 8 CAR\n"
    + "".join(
        f' SG_ G{a} : {16 * i}|16@1- (0.01,0) [-300|300] "deg/s" CAR\n' for i, a in enumerate("XYZ")
    )
    + "BO_ 256 SHORT",
)
SENSOR = f"""database: bus.dbc
signals:
  accelerometer: {{{AXES}}}
  gyroscope: {{x: GYR.GX, y: GYR.GY, z: GYR.GZ}}
"""


@settings(deadline=None)
@given(
    st.lists(
        st.tuples(
            st.floats(0, 0.5),
            st.sampled_from([PGN, OTHER_PGN]),
            st.integers(0xE0, 0xE4),
            st.sampled_from([bytes(8), b"\xff" * 8, b""]),
        ),
        min_size=1,
    ),
    st.integers(0),
)
def test_the_choice_of_a_sender_is_alike_in_columns(tmp_path_factory, steps, cut):
    loaded = load(SENSOR, tmp_path_factory.mktemp("choice"), PAIR)
    live, replayed = compile_router(loaded), compile_router(loaded)
    t = np.cumsum([step for step, *_ in steps]).tolist()
    frames = [
        (at, pgn | address | CAN_EFF_FLAG, data)
        for at, (_, pgn, address, data) in zip(t, steps, strict=True)
    ]
    for at, can_id, data in frames:
        live.frame(at, can_id, data)
    at = cut % (len(steps) + 1)
    for part in filter(None, (frames[:at], frames[at:])):
        columns = columns_of(part)
        replayed.columns(columns.t, columns)
    assert live.sample_counts == replayed.sample_counts
    assert live.rejected == replayed.rejected
    one, other = ([r.sender.address for r in router.routes] for router in (live, replayed))
    assert one == other


@pytest.mark.parametrize(
    "stray", [b"\x00", b"\xff" * 8, bytes(8)], ids=["short", "not available", "a value"]
)
def test_a_stray_frame_of_another_address_keeps_no_sensor_out(tmp_path, stray):
    """Of a unit that starts, or of a tester: lower than the sensor, in the first seconds."""
    sound = [(0.01 * i, *imu(0x80, 1000, i % 16)) for i in range(600)]
    first = (0.305, PGN | 0x10 | CAN_EFF_FLAG, stray)
    frames = sorted([*sound, first])
    found = both_ways(
        f"database: bus.dbc\nsignals: {{accelerometer: {{{AXES}}}}}\n", tmp_path, frames
    )
    assert found.count(1.0) == 600


def test_a_unit_that_has_no_values_is_no_sender(tmp_path):
    sound = [(0.01 * i + 0.3, *imu(0x80, 1000, i % 16)) for i in range(600)]
    without = [(0.01 * i, PGN | 0x10 | CAN_EFF_FLAG, b"\xff" * 8) for i in range(600)]
    text = f"database: bus.dbc\nsignals: {{accelerometer: {{{AXES}}}}}\n"
    found = both_ways(text, tmp_path, sorted(sound + without))
    assert found.count(1.0) == 600


def test_accelerometer_and_gyroscope_are_of_one_sender(tmp_path):
    """The lower address has no gyroscope: it is another sensor, mounted otherwise."""
    router = compile_router(load(SENSOR, tmp_path, PAIR))
    frames = sorted(
        [(0.01 * i, *imu(0x10, 2000)) for i in range(600)]
        + [(0.01 * i + 0.003, *imu(0x80, 1000)) for i in range(600)]
        + [(0.01 * i + 0.004, OTHER_PGN | 0x80 | CAN_EFF_FLAG, bytes(8)) for i in range(600)]
    )
    columns = columns_of(frames)
    samples = router.columns(columns.t, columns).samples
    assert samples["accel"].values[5:, 0] == pytest.approx(1.0)
    assert len(samples["gyro"].t) == 600
    assert {route.sender.address for route in router.routes} == {0x80}


def test_an_address_of_a_message_that_has_none_is_refused(tmp_path):
    text = (
        f"database: bus.dbc\nsignals:\n  accelerometer: {{{AXES}}}\n"
        "  speed: {signal: SHORT.Speed2, source_address: 3}\n"
    )
    with pytest.raises(ConfigError, match=r"yaml:4: signals\.speed.*11 bits"):
        compile_router(load(text, tmp_path, J1939))


@pytest.mark.parametrize("j1939", ["", ", j1939: false", ", j1939: true"])
def test_a_message_of_11_bits_in_a_j1939_database_is_matched_by_its_id(tmp_path, j1939):
    text = (
        f"database: {{path: bus.dbc{j1939}}}\nsignals:\n  accelerometer: {{{AXES}}}\n"
        "  speed: SHORT.Speed2\n"
    )
    router = compile_router(load(text, tmp_path, J1939))
    samples, _, _ = router.frame(0.0, 256, (3600).to_bytes(2, "little"))
    assert dict(samples)["speed"] == pytest.approx((10.0,))


RAW = """database: bus.dbc
signals:
  accelerometer: {x: IMU.AX, y: IMU.AY, z: IMU.AZ}
  temperature: {raw: {id: 256, when: "data[0] < 9", value: "data[1]"}, unit: degC}
messages:
  TEMP: {counter: {signal: N, max_step: 1}, recover_after: 0}
"""
PROTECTED = """VERSION ""
BU_: CAR
BO_ 256 TEMP: 3 CAR
 SG_ N : 16|8@1+ (1,0) [0|255] "" CAR
BO_ 257 IMU: 6 CAR
 SG_ AX : 0|16@1- (0.001,0) [-30|30] "m/s^2" CAR
 SG_ AY : 16|16@1- (0.001,0) [-30|30] "m/s^2" CAR
 SG_ AZ : 32|16@1- (0.001,0) [-30|30] "m/s^2" CAR
"""


def test_a_raw_source_keeps_the_protection_of_its_message(tmp_path):
    loaded = load(RAW, tmp_path, PROTECTED)
    live, replayed = compile_router(loaded), compile_router(loaded)
    kinds = [(1, 0), (1, 1), (9, 2), (1, 3), (1, 3), (1, 4)]  # one of another kind, one repeated
    frames = [(0.1 * i, 256, bytes([kind, 20, n])) for i, (kind, n) in enumerate(kinds)]
    found = [len(live.frame(*frame)[0]) for frame in frames]
    assert found == [1, 1, 0, 1, 0, 1]
    columns = columns_of(frames)
    routed = replayed.columns(columns.t, columns)
    assert routed.samples["temperature"].row.tolist() == [0, 1, 3, 5]
    assert live.rejected == replayed.rejected == {"counter_repeated": 1}
