"""Configuration and databases -> router: what it wants, and the text of every mistake."""

from __future__ import annotations

import pytest

from engine_bus import DBC, load
from imucald.can.columns import CAN_EFF_FLAG
from imucald.core.errors import ConfigError, ImucaldError
from imucald.inputs.wiring import compile_router
from imucald.runtime.session import make_engine

HEAD = "database: bus.dbc\nsignals:\n  accelerometer: {x: ACC.AX, y: ACC.AY, z: ACC.AZ}\n"


def mistake(text: str, folder, dbc: str = DBC) -> str:
    """The text of the error that a configuration comes to."""
    with pytest.raises(ConfigError) as error:
        make_engine(load(text, folder, dbc))
    return str(error.value)


def test_it_asks_for_the_ids_of_its_messages_and_no_others(tmp_path):
    router = compile_router(load(f"{HEAD}  speed: [SPD.V, WHL.FL]\n  brake: WHL.FR\n", tmp_path))
    assert [(m.can_id, m.mask) for m in router.matches] == [
        (0x100, 0x7FF),
        (0x130, 0x7FF),
        (0x150, 0x7FF),
    ]
    assert router.channels == {"accel", "speed", "brake", "reverse"}


def test_a_29_bit_id_carries_its_flag(tmp_path):
    router = compile_router(
        load(f"{HEAD}  gyroscope: {{x: GYR.GX, y: GYR.GY, z: GYR.GZ}}\n", tmp_path)
    )
    assert any(m.can_id & CAN_EFF_FLAG and m.mask == 0x1FFFFFFF for m in router.matches)


# Each line of a mistaken configuration that matters is marked: its number must be in the text.
MISTAKES = {
    "message": ("  speed: SPEED.V  # here", ["no message 'SPEED' in", "nearest", "SPD"]),
    "no dot": ("  speed: V  # here", ["'V' is not of the form MESSAGE.SIGNAL", "write SPD.V"]),
    "no dot, nowhere": ("  speed: VX  # here", ["MESSAGE.SIGNAL, such as IMU.AccX"]),
    "signal of another message": (
        "  speed: ACC.V  # here",
        ["ACC has no signal 'V'", "write SPD.V"],
    ),
    "signal": ("  speed: SPD.VV  # here", ["SPD has no signal 'VV'", "nearest: V"]),
    "signal of a list": (
        "  speed:\n    - SPD.V\n    - SPD.SPEED  # here",
        ["signals.speed[1]", "no signal 'SPEED'"],
    ),
    "axis": (
        "  gyroscope:\n    x: GYR.GX\n    y: GYR.GQ  # here\n    z: GYR.GZ",
        ["gyroscope", "no signal 'GQ'"],
    ),
    "unit of the database": (
        "  temperature: SPD.V  # here",
        ["'km/h' is not a unit of temperature", "degC", "in the database; set 'unit:' here"],
    ),
    "unit given": (
        "  speed: {signal: SPD.V, unit: furlong}  # here",
        ["'furlong' is not a unit of speed", "km/h"],
    ),
    "no unit": ("  speed: GEAR.G  # here", ["no unit is stated", "km/h", "set 'unit:' here"]),
    "not available beyond its bits": (
        "  speed: {signal: SPD2.V2, not_available: [65536]}  # here",
        ["not_available", "V2 is never 65536", "raw numbers are 0 to 65535"],
    ),
    "not available as if unsigned": (
        "  speed: {signal: SPD.V, not_available: [65535]}  # here",
        ["V is never 65535", "as a signed number, these bits are -1"],
    ),
    "on at what never is": (
        "  reverse: {signal: GEAR.G, equals: 16}  # here",
        ["reverse.equals", "G is never 16", "its nearest possible value is 15"],
    ),
    "on at what is infinite": (
        "  reverse: {signal: GEAR.G, equals: .inf}  # here",
        ["reverse.equals"],
    ),
    "on at what is no number": (
        "  reverse: {signal: GEAR.G, equals: .nan}  # here",
        ["reverse.equals"],
    ),
    "on at more than a double holds": (
        "  reverse: {signal: SPD.V, equals: 1.7e+308}  # here",
        ["reverse.equals"],
    ),
    "valid at what lies between two steps": (
        "  speed: {signal: SPD.V, valid_when: {signal: VCNT, equals: 0.5}}  # here",
        ["valid_when.equals", "VCNT is never 0.5"],
    ),
    "raw without unit": (
        "  speed: {raw: {id: 0x7E8, value: 'data[3]'}}  # here",
        ["a raw source needs 'unit:'", "km/h"],
    ),
    "raw expression": (
        "  speed:\n    unit: km/h\n    raw: {id: 0x7E8, value: 'data[99]'}  # here",
        ["data[99]", "not a byte"],
    ),
    "protection of an unused message": (
        "messages:\n  ACC: {}\n  WHL: {cycle_time: 0.1}  # here",
        ["messages.WHL", "takes no signal from this message", "ACC"],
    ),
    "counter signal": (
        "messages:\n  ACC: {counter: {signal: CNT}}  # here",
        ["messages.ACC", "no signal 'CNT'", "ACNT"],
    ),
    "counter modulus": (
        "messages:\n  ACC: {counter: {signal: ACNT, modulus: 17}}  # here",
        ["messages.ACC", "a counter of 4 bits does not have 17 values"],
    ),
    "checksum of no known kind": (
        "messages:\n  ACC: {checksum: {kind: crc9}}  # here",
        [
            "messages.ACC.checksum.kind",
            "'crc9' is not a known kind",
            "none, xor, crc8_j1850, crc16_ccitt",
        ],
    ),
    "checksum without signal": (
        "messages:\n  ACC: {checksum: {kind: xor}}  # here",
        ["checksum xor: needs 'signal:'"],
    ),
    "checksum in a nibble": (
        "messages:\n  ACC: {checksum: {kind: xor, signal: ACNT}}  # here",
        ["ACNT is not one whole byte"],
    ),
    "data id": (
        "messages:\n  ACC: {checksum: {kind: e2e_p1}}  # here",
        ["checksum e2e_p1: needs 'data_id:'"],
    ),
    "quoted number": (
        'vehicle: {wheelbase: "2.68"}  # here',
        ["must be a number", "remove the quotes"],
    ),
    "output id": (
        "output:\n  ids: {health: 0x100}  # here",
        ["0x100 is output 'health' and also input message ACC"],
    ),
}


@pytest.mark.parametrize("name", sorted(MISTAKES))
def test_a_mistake_is_reported_with_line_reason_and_remedy(name, tmp_path):
    text, expected = MISTAKES[name]
    text = f"{HEAD}{text}\n"
    line = 1 + next(i for i, content in enumerate(text.splitlines()) if "# here" in content)
    message = mistake(text, tmp_path)
    assert f"config.yaml:{line}:" in message
    for part in expected:
        assert part in message


def test_a_database_that_is_not_there_is_reported_with_what_paths_are_relative_to(tmp_path):
    found = mistake("database: gone.dbc\nsignals:\n  accelerometer: {x: A.X, y: A.Y}\n", tmp_path)
    assert "No such file or directory; paths are relative to the configuration file" in found


def test_a_planar_accelerometer_must_come_in_one_message(tmp_path):
    text = "database: bus.dbc\nsignals:\n  accelerometer: {x: ACC.AX, y: ACC_XY.BY}\n"
    assert "must be in one message" in mistake(text, tmp_path)


def test_a_planar_accelerometer_takes_no_raw_sources(tmp_path):
    text = (
        "database: bus.dbc\nsignals:\n  accelerometer:\n"
        "    x: {raw: {id: 0x111, value: 'data[0]'}, unit: g}\n    y: ACC_XY.BY\n"
    )
    assert "must be in one message" in mistake(text, tmp_path)


LEVEL = "database: bus.dbc\nsignals:\n  accelerometer: {x: ACC_XY.BX, y: ACC_XY.BY}\n"


RAW = "{raw: {id: 0x111, value: 'data[0]'}, unit: g}"


@pytest.mark.parametrize("axes", ["x: PAR.PX, y: ACC.AY", f"x: {RAW}, y: {RAW}"])
def test_a_parallel_sensor_of_two_axes_must_come_in_one_message(axes: str, tmp_path):
    sensor = f"{{name: b, kind: acceleration, id: 0x700, {axes}}}"
    assert "must be in one message" in mistake(f"{LEVEL}  parallel: [{sensor}]\n", tmp_path)


def test_a_parallel_sensor_of_two_axes_beside_a_leaning_one_is_refused(tmp_path):
    """Claims 1 to 5 take a level sensor; claim 6 levels, and needs the third axis."""
    sensor = "  parallel: [{name: b, kind: angular_rate, x: GYR.GX, y: GYR.GY, id: 0x700}]\n"
    found = mistake(f"{HEAD}{sensor}", tmp_path)
    assert "signals.parallel[0]" in found
    assert "must be mounted level" in found
    level = "calibration: {estimator: published, method_a: {level: false}}\n"
    compile_router(load(f"{HEAD}{sensor}{level}", tmp_path))
    compile_router(load(f"{LEVEL}{sensor}", tmp_path))


def test_two_parallel_sensors_of_one_name_are_refused(tmp_path):
    sensor = "{name: a, kind: acceleration, x: PAR.PX, y: PAR.PY, z: PAR.PZ, id: 0x%X}"
    text = f"{HEAD}  parallel: [{sensor % 0x700}, {sensor % 0x701}]\n"
    assert "parallel" in mistake(text, tmp_path)


@pytest.mark.parametrize("can_id", ["0x640", "0x645"])
def test_a_parallel_sensor_with_an_output_id_of_another_frame_is_refused(can_id, tmp_path):
    text = (
        f"{HEAD}  parallel: [{{name: a, kind: acceleration, x: PAR.PX, y: PAR.PY, z: PAR.PZ,"
        f" id: {can_id}}}]\n"
    )
    assert can_id.upper().replace("X", "x") in mistake(text, tmp_path)


def test_a_database_that_cannot_be_read_is_reported_at_its_line(tmp_path):
    text = "\ndatabase:\n  - bus.dbc\n  - other.dbc\nsignals: {accelerometer: {x: A.B, y: A.C}}\n"
    message = mistake(text, tmp_path)
    assert "config.yaml:4: database[1]" in message
    assert "other.dbc" in message


def test_no_configuration_of_random_mistakes_escapes_the_family(tmp_path):
    """Every value of a good file replaced by something else: an error of ours, or none."""
    lines = (
        HEAD + "  speed: {signal: SPD.V, unit: km/h, sign: 1, offset: 0.0, range: [0, 300]}\n"
        "  brake: {signal: GEAR.BRK, above: 2}\nmessages:\n  ACC: {cycle_time: 0.01, recover_after:"
        " 3}\noutput: {status_rate: 1}\ncalibration: {estimator: published}\n"
    ).splitlines()
    replacements = ["", "{}", "[]", "null", "-1", "1e999", "ACC.AX", "'0x'", "[1, 2, 3]", "~"]
    for i, line in enumerate(lines):
        for value in replacements:
            key = line.partition(":")[0]
            text = "\n".join([*lines[:i], f"{key}: {value}", *lines[i + 1 :]])
            problem = None
            try:
                make_engine(load(text, tmp_path))
            except ImucaldError as error:
                problem = str(error)
            assert problem is None or "config.yaml" in problem
