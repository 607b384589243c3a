"""Router: frames -> samples in SI, by hand-worked values; preference, planar, split, derived."""

from __future__ import annotations

import math

import pytest

from engine_bus import DBC, Sender, columns_of, load
from imucald.can.columns import CAN_EFF_FLAG
from imucald.inputs.router import Router
from imucald.inputs.wiring import compile_router

HEAD = "database: bus.dbc\nsignals:\n  accelerometer: {x: ACC.AX, y: ACC.AY, z: ACC.AZ}\n"


class Bus:
    """A router and a sender of one configuration; every frame goes both ways."""

    def __init__(self, text: str, folder, dbc: str = DBC) -> None:
        self.loaded = load(text, folder, dbc)
        self.router: Router = compile_router(self.loaded)
        self._columns = compile_router(self.loaded)
        self._sender = Sender(self.loaded)

    def say(self, t: float, message: str, **values: float) -> dict[str, list[float]]:
        """Samples of one frame by channel; `rejected` is the list of channels rejected."""
        return self.raw(*self._sender.frame(t, message, **values))

    def raw(self, t: float, can_id: int, data: bytes) -> dict[str, list[float]]:
        """The same of given bytes."""
        samples, rejected, for_value = self.router.frame(t, can_id, data)
        frames = columns_of([(t, can_id, data)])
        routed = self._columns.columns(frames.t, frames)
        by_channel = {channel: list(values) for channel, values in samples}
        assert {c: s.values[0].tolist() for c, s in routed.samples.items()} == {
            c: v if len(v) > 1 else v[0] for c, v in by_channel.items()
        }
        assert set(routed.rejected) == set(rejected)
        assert set(routed.rejected_values) == set(for_value)
        assert self._columns.rejected == self.router.rejected
        if rejected:
            by_channel["rejected"] = rejected
        return by_channel


def test_units_come_from_the_database(tmp_path):
    bus = Bus(
        "database: bus.dbc\nsignals:\n  accelerometer: {x: ACC_XY.BX, y: ACC_XY.BY}\n"
        "  gyroscope: {x: GYR.GX, y: GYR.GY, z: GYR.GZ}\n  magnetometer: {x: MAG.MX, y: MAG.MY,"
        " z: MAG.MZ}\n  speed: [SPD.V, SPD2.V2]\n  steering_wheel_angle: MUX.STEER\n",
        tmp_path,
    )
    gyro = bus.say(0.0, "GYR", GX=90.0, GY=-45.0, GZ=0.0)["gyro"]
    assert gyro == pytest.approx([math.pi / 2, -math.pi / 4, 0.0])
    assert bus.say(0.0, "MAG", MX=50.0, MY=-20.0, MZ=0.0)["mag"] == pytest.approx([5e-5, -2e-5, 0])
    assert bus.say(9.0, "SPD2", V2=100.0)["speed"] == pytest.approx([44.704])
    assert bus.say(9.0, "SPD", V=90.0)["speed"] == pytest.approx([25.0])
    assert bus.say(9.0, "MUX", SEL=1, STEER=-180.0)["steering"] == pytest.approx([-math.pi])


def test_a_planar_accelerometer_is_level_by_declaration(tmp_path):
    bus = Bus(
        "database: bus.dbc\nsignals: {accelerometer: {x: ACC_XY.BX, y: ACC_XY.BY}}\n", tmp_path
    )
    samples = bus.say(0.0, "ACC_XY", BX=0.5, BY=-1.0)
    assert samples["accel"] == pytest.approx([0.5 * 9.80665, -9.80665, 9.80665])


def test_unit_sign_and_offset_of_the_configuration_win(tmp_path):
    bus = Bus(
        "database: bus.dbc\nsignals:\n  accelerometer:\n"
        "    x: {signal: ACC.AX, unit: g, sign: -1}\n    y: {signal: ACC.AY, offset: 0.5}\n"
        "    z: {signal: ACC.AZ, offset: 0.5, sign: -1}\n",
        tmp_path,
    )
    samples = bus.say(0.0, "ACC", AX=1.0, AY=1.0, AZ=1.0)
    assert samples["accel"] == pytest.approx([-9.80665, 1.5, -1.5])


def test_one_missing_axis_rejects_the_whole_sample(tmp_path):
    bus = Bus(
        "database: bus.dbc\nsignals:\n  accelerometer:\n    x: ACC.AX\n"
        "    y: {signal: ACC.AY, not_available: [32767, -32768]}\n"
        "    z: {signal: ACC.AZ, range: [0, 20]}\n",
        tmp_path,
    )
    assert bus.say(0.0, "ACC", AX=1.0, AY=0.0, AZ=20.0)["accel"] == [1.0, 0.0, 20.0]
    assert bus.say(0.1, "ACC", AX=1.0, AY=0.0, AZ=-0.002) == {"rejected": ["accel"]}
    assert bus.raw(0.1, 0x100, b"\x00\x00\xff\x7f\x00\x00\x00\x00") == {"rejected": ["accel"]}
    assert bus.say(0.1, "ACC", AX=60.0, AY=0.0, AZ=9.8) == {"rejected": ["accel"]}  # at its end
    assert bus.router.rejected == {"out_of_range": 1, "not_available": 1, "saturated": 1}
    assert bus.router.sample_counts["accel"] == 1
    assert bus.router.used == 4  # the frames themselves were good


def test_flags_by_value_and_by_threshold(tmp_path):
    bus = Bus(
        f"{HEAD}  reverse: {{signal: GEAR.G, equals: [1, 9]}}\n"
        "  brake: {signal: GEAR.BRK, above: 2}\n",
        tmp_path,
    )
    assert bus.say(0.0, "GEAR", G=9.0, BRK=2.0) == {"reverse": [1.0], "brake": [0.0]}
    assert bus.say(0.0, "GEAR", G=2.0, BRK=3.0) == {"reverse": [0.0], "brake": [1.0]}


@pytest.mark.parametrize("steps", range(1, 40))
def test_a_value_is_compared_as_it_is_decoded(steps, tmp_path):
    """3 times 0.1 is not 0.3, to the last bit."""
    value = float(f"{steps / 10}")
    text = f"{{signal: SPD2.V2, valid_when: {{signal: V2, equals: {value}}}}}"
    bus = Bus(f"{HEAD}  speed: {text}\n", tmp_path)
    assert "speed" in bus.say(0.0, "SPD2", V2=value)
    assert "speed" not in bus.say(0.1, "SPD2", V2=value + 0.1)


def test_reverse_is_read_from_a_signed_speed(tmp_path):
    bus = Bus(f"{HEAD}  speed: SPD.V\n", tmp_path)
    assert bus.say(0.0, "SPD", V=-36.0) == {"reverse": [1.0], "speed": [10.0]}
    assert bus.say(0.0, "SPD", V=36.0) == {"reverse": [0.0], "speed": [10.0]}
    unsigned = Bus(f"{HEAD}  speed: SPD2.V2\n", tmp_path)
    assert set(unsigned.say(0.0, "SPD2", V2=10.0)) == {"speed"}
    given = Bus(f"{HEAD}  speed: SPD.V\n  reverse: GEAR.G\n", tmp_path)
    assert given.say(0.0, "SPD", V=-36.0) == {"speed": [10.0]}


def test_speed_from_wheels_is_the_mean_of_the_middle_two(tmp_path):
    wheels = "{front_left: WHL.FL, front_right: WHL.FR, rear_left: WHL.RL, rear_right: WHL.RR}"
    bus = Bus(f"{HEAD}  wheel_speeds: {wheels}\n", tmp_path)
    samples = bus.say(0.0, "WHL", FL=36.0, FR=0.0, RL=39.6, RR=180.0)
    assert samples["speed"] == pytest.approx([10.5])
    assert samples["wheel_speeds"] == pytest.approx([10.0, 0.0, 11.0, 50.0])
    given = Bus(f"{HEAD}  wheel_speeds: {wheels}\n  speed: SPD.V\n", tmp_path)
    assert set(given.say(0.0, "WHL", FL=1.0, FR=1.0, RL=1.0, RR=1.0)) == {"wheel_speeds"}


def test_the_second_source_is_heard_only_when_the_first_is_silent(tmp_path):
    bus = Bus(f"{HEAD}  speed: [SPD.V, SPD2.V2]\n", tmp_path)

    def second(t: float) -> bool:
        return "speed" in bus.say(t, "SPD2", V2=10.0)

    assert second(0.0)  # the first has never been there
    assert "speed" in bus.say(0.1, "SPD", V=10.0)
    assert not second(0.2)
    assert not second(1.6)
    assert second(1.61)
    assert "speed" in bus.say(1.7, "SPD", V=10.0)
    assert not second(1.8)


def test_a_first_source_that_is_not_available_gives_way(tmp_path):
    bus = Bus(
        f"{HEAD}  speed:\n    - {{signal: SPD.V, range: [0, 300]}}\n    - SPD2.V2\n", tmp_path
    )
    bus.say(0.0, "SPD", V=10.0)
    for k in range(1, 20):
        t = 0.1 * k
        assert bus.say(t, "SPD", V=-5.0) == {"rejected": ["speed"]}
        assert ("speed" in bus.say(t, "SPD2", V2=10.0)) == (t > 1.5)


def test_a_second_source_that_nobody_hears_rejects_nothing(tmp_path):
    """Its bad frames are counted, but no sample of the quantity was lost by them."""
    bus = Bus(
        f"{HEAD}  speed:\n    - SPD.V\n    - {{signal: SPD2.V2, range: [0, 100]}}\n", tmp_path
    )
    assert "speed" in bus.say(0.0, "SPD", V=10.0)
    assert bus.say(0.1, "SPD2", V2=200.0) == {}
    assert bus.router.rejected == {"out_of_range": 1}
    assert bus.say(0.1, "SPD", V=20.0) == {"speed": pytest.approx([20 / 3.6]), "reverse": [0.0]}
    assert bus.raw(0.2, 0x131, b"\x00") == {}
    assert bus.say(9.0, "SPD2", V2=200.0) == {"rejected": ["speed"]}  # now it is the one heard
    assert bus.raw(9.1, 0x131, b"\x00") == {"rejected": ["speed"]}


def test_a_split_triad_is_put_together_within_a_tick(tmp_path):
    bus = Bus(
        "database: bus.dbc\nsignals:\n  accelerometer: {x: ACC_XY.BX, y: ACC_XY.BY, z: ACC_Z.BZ}\n",
        tmp_path,
    )
    assert bus.say(0.0, "ACC_XY", BX=0.1, BY=0.2) == {}
    assert bus.say(0.05, "ACC_Z", BZ=1.0)["accel"] == pytest.approx([0.980665, 1.96133, 9.80665])
    assert bus.say(0.06, "ACC_Z", BZ=1.0) == {}  # x and y are spent
    assert bus.say(0.17, "ACC_XY", BX=0.1, BY=0.2) == {}  # and that z is too old now
    assert "accel" in bus.say(0.2, "ACC_Z", BZ=0.5)


def test_obd_answers_by_expression(tmp_path):
    bus = Bus(
        f"{HEAD}  speed:\n    raw: {{id: 0x7E8, when: 'data[1] == 0x41 and data[2] == 0x0D',"
        " value: 'data[3]'}\n    unit: km/h\n",
        tmp_path,
    )
    assert bus.raw(0.0, 0x7E8, bytes([3, 0x41, 0x0D, 72, 0, 0, 0, 0])) == {"speed": [20.0]}
    assert bus.raw(0.1, 0x7E8, bytes([3, 0x41, 0x0C, 72, 0, 0, 0, 0])) == {}
    assert bus.raw(0.2, 0x7E8, bytes([3, 0x41, 0x0D])) == {"rejected": ["speed"]}
    assert bus.raw(0.3, 0x7E8 | CAN_EFF_FLAG, bytes([3, 0x41, 0x0D, 72, 0, 0, 0, 0])) == {}
    assert bus.raw(0.4, 0x7E8, b"") == {}
    assert bus.router.used == 1
    assert bus.router.rejected == {"short_frame": 1}


def test_a_multiplexed_signal_is_there_when_its_value_is_selected(tmp_path):
    bus = Bus(
        f"{HEAD}  yaw_rate: MUX.YAW\n  steering_wheel_angle: MUX.STEER\n"
        "  lateral_acceleration: MUX.LAT\n",
        tmp_path,
    )
    assert bus.say(0.0, "MUX", SEL=0, YAW=0.25) == {"yaw_rate": [0.25]}
    assert set(bus.say(0.0, "MUX", SEL=1, STEER=1.0, LAT=2.0)) == {"steering", "lateral_accel"}
    assert bus.say(0.0, "MUX", SEL=2, ON=1.0) == {}
    assert bus.router.used == 3


def test_a_damaged_protected_frame_is_dropped_whole_and_trust_comes_back(tmp_path):
    bus = Bus(
        f"{HEAD}messages:\n  ACC: {{counter: {{signal: ACNT}}, checksum: {{kind: crc8_j1850,"
        " signal: ACRC, id_bytes: 2}, recover_after: 2}\n",
        tmp_path,
    )
    assert "accel" in bus.say(0.00, "ACC", AX=1.0, AY=0.0, AZ=9.8)
    _, can_id, data = bus._sender.frame(0.01, "ACC", AX=1.0, AY=0.0, AZ=9.8)
    assert bus.raw(0.01, can_id, data[:7] + bytes([data[7] ^ 1])) == {"rejected": ["accel"]}
    for t in (0.02, 0.03):
        assert bus.say(t, "ACC", AX=1.0, AY=0.0, AZ=9.8) == {"rejected": ["accel"]}
    assert "accel" in bus.say(0.04, "ACC", AX=1.0, AY=0.0, AZ=9.8)
    assert bus.router.rejected == {"checksum": 1, "untrusted": 2}


def test_a_frame_that_came_twice_at_one_stamp_is_used_once_and_nothing_is_refused(tmp_path):
    text = f"{HEAD}messages:\n  ACC: {{counter: {{signal: ACNT}}}}\n"
    bus = Bus(text, tmp_path)
    frames = [bus._sender.frame(0.01 * i, "ACC", AX=1.0, AY=0.0, AZ=9.8) for i in range(40)]
    twice = [frame for frame in frames for _ in range(2)]
    got = [bus.raw(*frame) for frame in twice]
    assert all("accel" in found and "rejected" not in found for found in got[::2])
    assert got[1::2] == [{}] * 40
    columns = compile_router(load(text, tmp_path))
    taken = columns_of(twice, "can0")
    routed = columns.columns(taken.t, taken)
    assert len(routed.samples["accel"].t) == 40
    assert not routed.rejected
    for router in (bus.router, columns):
        assert router.rejected == {"doubled": 40}
        assert router.used == 40


def test_j1939_messages_are_heard_from_any_source_address(tmp_path):
    text = (
        "database: {path: bus.dbc, j1939: true}\nsignals:\n"
        "  accelerometer: {x: ACC.AX, y: ACC.AY, z: ACC.AZ}\n"
        "  gyroscope: {x: GYR.GX, y: GYR.GY, z: GYR.GZ}\n"
    )
    for source, priority in ((0x00, 6), (0x17, 6), (0xFE, 3)):
        bus = Bus(text, tmp_path)  # each the only sender
        _, can_id, data = bus._sender.frame(0.0, "GYR", GX=1.0, GY=2.0, GZ=3.0)
        other = CAN_EFF_FLAG | priority << 26 | can_id & 0x03FFFF00 | source
        assert "gyro" in bus.raw(0.0, other, data)
    assert bus.raw(0.0, can_id ^ 0x100, data) == {}  # another parameter group


def test_a_source_of_another_channel_is_not_heard(tmp_path):
    text = f"{HEAD}  speed: {{signal: SPD.V, channel: can1}}\n"
    loaded = load(text, tmp_path)
    frames = [Sender().frame(0.0, "SPD", V=36.0)]
    for channel, expected in (("can0", False), ("can1", True)):
        router = compile_router(loaded)
        columns = columns_of(frames, channel)
        assert ("speed" in router.columns(columns.t, columns).samples) is expected


def test_parallel_sensors_have_channels_of_their_own(tmp_path):
    bus = Bus(
        f"{HEAD}  parallel:\n    - {{name: b, kind: angular_rate, x: GYR.GX, y: GYR.GY, z: GYR.GZ,"
        " id: 0x700}\n",
        tmp_path,
    )
    samples = bus.say(0.0, "GYR", GX=180.0, GY=0.0, GZ=0.0)
    assert samples == {"parallel/b": pytest.approx([math.pi, 0.0, 0.0])}


def test_only_a_value_that_is_refused_says_more_than_a_frame_that_is_lost(tmp_path) -> None:
    """A damaged frame is a hole; a value on the sensor's stop hides a larger one."""
    bus = Bus(HEAD, tmp_path)
    beyond = b"\xff\x7f" + bytes(6)
    for t, data, for_value in ((0.0, beyond, ["accel"]), (0.1, bytes(5), [])):
        assert bus.raw(t, 256, data) == {"rejected": ["accel"]}  # columns say the same
        other = Bus(HEAD, tmp_path)
        assert other.router.frame(t, 256, data) == ([], ["accel"], for_value)
