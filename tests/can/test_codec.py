"""Decode plans on hand-written databases: formats, identifiers, multiplexers, broken signals."""

from __future__ import annotations

import math
import struct

import cantools.database
import numpy as np
import pytest
from msgspec.structs import replace

from imucald.can.columns import CAN_EFF_FLAG, IdMatch
from imucald.can.dbc.database import Database, load_database, load_database_text
from imucald.can.dbc.decode import compile_decode, id_match
from imucald.can.dbc.message import Message
from imucald.core.errors import DatabaseError, DecodeError
from paths import ROOT

DATA = ROOT / "tests" / "data"
REAL = ROOT.parent / "shared" / "data"


@pytest.fixture(scope="module")
def database() -> Database:
    return load_database(DATA / "cluster.dbc")


def column(frames: list[bytes], width: int = 8) -> tuple[np.ndarray, np.ndarray]:
    data = np.zeros((len(frames), width), np.uint8)
    for row, frame in enumerate(frames):
        data[row, : len(frame)] = list(frame)
    return data, np.array([len(f) for f in frames], np.uint8)


# AX = -1000 raw Intel, AY = 4660 raw Motorola, AZ = 2196 raw in bits 35..46, ALIVE 9, CRC 0xA5
IMU_FRAME = struct.pack("<h", -1000) + struct.pack(">h", 0x1234) + bytes.fromhex("a04490a5")


@pytest.mark.parametrize("suffix", ["dbc", "kcd", "sym", "arxml"])
def test_every_format_gives_the_same_numbers(suffix: str) -> None:
    message = load_database(DATA / f"cluster.{suffix}").message("IMU")
    plan = compile_decode(message, ["AX", "AY", "AZ", "ALIVE", "CRC"])
    assert plan.decode_raw(IMU_FRAME) == (-1000, 0x1234, 2196, 9, 0xA5)
    assert plan.decode(IMU_FRAME) == (-1000 * 0.002, 4660 * 0.002, 2196 * 0.05 - 100, 9.0, 165.0)
    assert message.signal("AZ").unit == "m/s^2"
    assert message.cycle_time == 0.01
    assert plan.id_match == IdMatch(0x200, 0x7FF, None)


def test_a_multiplexed_signal_is_there_under_its_values_only(database: Database) -> None:
    names = ["TEMPERATURE", "SUPPLY", "HOURS", "BOOTS", "ALWAYS", "PAGE"]
    plan = compile_decode(database.message("STATUS"), names)
    frames = {
        "000a00000000000f": (30.0, None, None, None, 15.0, 0.0),
        "0130390007000010": (None, 12.345, 7.0, None, 16.0, 1.0),
        "0430390007000010": (None, 12.345, None, None, 16.0, 4.0),
        "5207000000000011": (None, None, None, 7.0, 17.0, 2.0),
        "6207000000000011": (None, None, None, 7.0, 17.0, 2.0),
        "7207000000000011": (None, None, None, None, 17.0, 2.0),
        "5307000000000011": (None, 1.792, None, None, 17.0, 3.0),
    }
    decoded = plan.decode_columns(*column([bytes.fromhex(f) for f in frames]))
    for row, (frame, expected) in enumerate(frames.items()):
        assert plan.decode(bytes.fromhex(frame)) == expected
        for i, value in enumerate(expected):
            found = decoded.values[i][row]
            assert found == value if value is not None else math.isnan(found)
    assert decoded.present[4] is None
    supply = decoded.present[1]
    assert supply is not None
    assert supply.tolist() == [False, True, True, False, False, False, True]


def test_floats_of_16_32_and_64_bits_in_a_can_fd_frame(database: Database) -> None:
    payload = bytearray(20)
    payload[0:4] = struct.pack("<f", 0.1)
    payload[4:12] = struct.pack(">d", -2.5)
    half = int.from_bytes(struct.pack("<e", 1.5), "little") << 4
    payload[12:15] = half.to_bytes(3, "little")
    plan = compile_decode(database.message("FLOATS"), ["SINGLE", "DOUBLE", "HALF"])
    expected = (struct.unpack("<f", struct.pack("<f", 0.1))[0], -4.0, 1.5)
    assert plan.decode(bytes(payload)) == expected
    decoded = plan.decode_columns(*column([bytes(payload)], 64))
    assert tuple(v[0] for v in decoded.values) == expected
    for bad in (math.nan, math.inf):
        payload[4:12] = struct.pack(">d", bad)
        one = plan.decode(bytes(payload))[1]
        many = plan.decode_columns(*column([bytes(payload)], 64)).values[1][0]
        assert one is not None
        assert math.isnan(one) == math.isnan(many) == math.isnan(bad)
        assert math.isfinite(one) == bool(np.isfinite(many)) is False


def test_a_short_frame_is_refused_and_a_longer_one_accepted(database: Database) -> None:
    plan = compile_decode(database.message("IMU"), ["AX", "AY"])
    for length in range(8):
        with pytest.raises(DecodeError) as caught:
            plan.decode(IMU_FRAME[:length])
        assert caught.value.reason == "short_frame"
    assert plan.decode(IMU_FRAME + b"\xff" * 4) == plan.decode(IMU_FRAME)
    assert plan.decode(bytearray(IMU_FRAME)) == plan.decode(IMU_FRAME)
    frames = [IMU_FRAME[:7], IMU_FRAME, IMU_FRAME + b"\xff" * 4]
    decoded = plan.decode_columns(*column(frames, 64))
    assert decoded.ok.tolist() == [False, True, True]
    assert math.isnan(decoded.values[0][0])
    assert decoded.values[1][1:].tolist() == [4660 * 0.002] * 2


def test_classic_columns_of_an_fd_message_are_all_short(database: Database) -> None:
    plan = compile_decode(database.message("FLOATS"), ["SINGLE", "HALF"])
    decoded = plan.decode_columns(*column([bytes(8)] * 3))
    assert not decoded.ok.any()
    assert np.isnan(decoded.values[1]).all()


def test_a_short_frame_has_no_multiplexed_signal_either(database: Database) -> None:
    plan = compile_decode(database.message("STATUS"), ["TEMPERATURE"])
    decoded = plan.decode_columns(*column([b"\0" * 7, b"\0" * 8]))
    present = decoded.present[0]
    assert present is not None
    assert present.tolist() == [False, True]
    assert np.isnan(decoded.values[0]).tolist() == [True, False]


def test_no_frames_at_all_give_empty_columns(database: Database) -> None:
    plan = compile_decode(database.message("STATUS"), ["TEMPERATURE", "ALWAYS"])
    decoded = plan.decode_columns(np.zeros((0, 8), np.uint8), np.zeros(0, np.uint8))
    assert [len(v) for v in decoded.values] == [0, 0]


@pytest.mark.filterwarnings("error")
def test_a_hundred_thousand_random_frames_decode_or_are_short(database: Database) -> None:
    rng = np.random.default_rng(9)
    count = 40_000
    data = rng.integers(0, 256, (count, 64), dtype=np.uint8)
    length = rng.integers(0, 65, count).astype(np.uint8)
    data[np.arange(64) >= length[:, None]] = 0
    for name in ("IMU", "STATUS", "FLOATS"):
        message = database.message(name)
        plan = compile_decode(message, list(message.signals))
        decoded = plan.decode_columns(data, length)
        assert (decoded.ok == (length >= message.length)).all()
        assert all(np.isnan(v[~decoded.ok]).all() for v in decoded.values)
        for row in range(0, count, 40):
            frame = data[row, : length[row]].tobytes()
            if not decoded.ok[row]:
                with pytest.raises(DecodeError):
                    plan.decode(frame)
                continue
            values = [math.nan if v is None else v for v in plan.decode(frame)]
            np.testing.assert_array_equal(values, [v[row] for v in decoded.values])


def matches(match: IdMatch, can_id: int) -> bool:
    mask = match.mask | CAN_EFF_FLAG
    return can_id & mask == match.can_id & mask


def test_j1939_is_matched_by_pgn_whatever_source_and_priority(database: Database) -> None:
    match = id_match(database.message("EEC1"))  # PGN 0xF004, PDU2
    assert matches(match, CAN_EFF_FLAG | 0x0CF00400)
    assert matches(match, CAN_EFF_FLAG | 0x18F00427)
    assert not matches(match, CAN_EFF_FLAG | 0x0CF00500)
    assert not matches(match, CAN_EFF_FLAG | 0x0DF00400)  # the other data page
    assert not matches(match, 0x0CF00400)


def test_j1939_to_one_address_is_matched_whatever_destination(database: Database) -> None:
    match = id_match(database.message("TSC1"))  # PGN 0x0000, PDU1
    assert matches(match, CAN_EFF_FLAG | 0x0C000003)
    assert matches(match, CAN_EFF_FLAG | 0x18000B11)
    assert not matches(match, CAN_EFF_FLAG | 0x0C010003)


def test_j1939_can_be_forced_and_forbidden(database: Database) -> None:
    eec1, imu = database.message("EEC1"), database.message("IMU")
    strict = id_match(eec1, j1939=False)
    assert strict.mask == 0x1FFF_FFFF
    assert not matches(strict, CAN_EFF_FLAG | 0x18F00427)
    plain = replace(eec1, is_j1939=False)
    assert id_match(plain, j1939=True) == id_match(eec1)
    assert id_match(imu, j1939=True) == id_match(imu, j1939=False)  # 11 bits are no PGN
    with pytest.raises(DatabaseError, match=r"IMU is not a J1939 message.*11 bits"):
        id_match(imu, j1939=True, source_address=3)


def one_signal(line: str, size: int = 8, more: str = "") -> Message:
    head = f'VERSION ""\nNS_ :\nBS_:\nBU_:\nBO_ 16 M: {size} Vector__XXX\n'
    return load_database_text(f"{head} SG_ {line} Vector__XXX\n{more}", "dbc", "x.dbc").message("M")


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ('S : 60|8@1+ (1,0) [0|0] ""', "outside its message of 8 bytes"),
        ('S : 56|16@0+ (1,0) [0|0] ""', "outside its message of 8 bytes"),
        ('S : 0|65@1+ (1,0) [0|0] ""', "a signal of 65 bits is not possible"),
        ('S : 0|8@1+ (0,0) [0|0] ""', "do not give a physical value"),
        ('S : 0|8@1+ (1e400,0) [0|0] ""', "do not give a physical value"),
        ('S : 0|8@1+ (1,-1e305) [0|0] ""', "do not give a physical value"),
        (
            'S : 0|8@1+ (1e300,0) [0|0] ""',
            r"factor 1e\+300 and offset 0 do not give a physical value",
        ),
    ],
)
def test_a_signal_that_makes_no_sense_is_refused_by_name(line: str, reason: str) -> None:
    with pytest.raises(DatabaseError, match=reason) as caught:
        compile_decode(one_signal(line, 16 if "|65@" in line else 8), ["S"])
    assert "x.dbc: M.S" in str(caught.value)


def test_a_reason_is_as_short_as_a_line_of_the_file_is_long() -> None:
    with pytest.raises(DatabaseError, match="cannot be read") as caught:
        load_database_text("W" * 50_000, "dbc", "x.dbc")
    assert len(str(caught.value)) < 500


def test_a_broken_signal_does_not_hinder_the_others() -> None:
    lines = 'BAD : 60|8@1+ (1,0) [0|0] "" Vector__XXX\n SG_ GOOD : 8|8@1+ (1,0) [0|0] ""'
    plan = compile_decode(one_signal(lines), ["GOOD"])
    assert plan.decode(bytes.fromhex("0007000000000000")) == (7.0,)


def test_a_multiplexed_signal_without_multiplexer_is_refused() -> None:
    message = one_signal('S m1 : 8|8@1+ (1,0) [0|0] ""')
    broken = replace(
        message,
        signals={"S": replace(message.signals["S"], selectors=(("GONE", frozenset({1})),))},
    )
    with pytest.raises(DatabaseError, match=r"multiplexer GONE is broken"):
        compile_decode(broken, ["S"])


def test_a_message_longer_than_a_frame_is_refused() -> None:
    with pytest.raises(DatabaseError, match="100 bytes does not fit a CAN frame"):
        compile_decode(one_signal('S : 0|8@1+ (1,0) [0|0] ""', 100), ["S"])


def test_asking_for_what_is_not_there_names_the_nearest(database: Database) -> None:
    with pytest.raises(DatabaseError, match=r"no signal 'ALIV' \(nearest: ALIVE"):
        database.signal("IMU.ALIV")
    with pytest.raises(DatabaseError, match=r"no message 'IMV' in .+ \(nearest: IMU"):
        database.signal("IMV.AX")
    for path in ("IMU", "IMU.", ".AX", ""):
        with pytest.raises(DatabaseError, match=r"MESSAGE\.SIGNAL"):
            database.signal(path)


def test_large_integers_are_scaled_as_cantools_scales_them() -> None:
    text = (
        'VERSION ""\nNS_ :\nBS_:\nBU_:\nBO_ 16 M: 32 Vector__XXX\n'
        ' SG_ WHOLE : 0|64@1+ (3,7) [0|0] "" Vector__XXX\n'
        ' SG_ SIGNED : 64|63@1- (-5,0.5) [0|0] "" Vector__XXX\n'
        ' SG_ PLAIN : 128|64@1+ (1,0) [0|0] "" Vector__XXX\n'
        ' SG_ MIDDLE : 192|55@1+ (3,7) [0|0] "" Vector__XXX\n'
    )
    theirs = cantools.database.load_string(text, "dbc").get_message_by_name("M")
    names = ["WHOLE", "SIGNED", "PLAIN", "MIDDLE"]
    plan = compile_decode(load_database_text(text, "dbc").message("M"), names)
    rng = np.random.default_rng(3)
    frames = [b"\xff" * 32, *(rng.bytes(32) for _ in range(50))]
    decoded = plan.decode_columns(*column(frames, 64))
    for row, frame in enumerate(frames):
        expected = tuple(float(v) for v in theirs.decode(frame).values())  # type: ignore[arg-type,union-attr]
        assert plan.decode(frame) == expected
        assert tuple(v[row] for v in decoded.values) == expected


@pytest.mark.parametrize("drive", ["wrx_sti", "css_canmod_164", "kingston_2008"])
def test_real_databases_decode_as_cantools_does(drive: str) -> None:
    path = REAL / drive / "drive.dbc"
    if not path.exists():
        pytest.skip(f"the measured drive {drive} is not beside the repository")
    theirs = cantools.database.load_file(path, strict=False)
    rng = np.random.default_rng(7)
    for message in load_database(path).messages.values():
        plan = compile_decode(message, list(message.signals))
        their_message = theirs.get_message_by_name(message.name)  # type: ignore[union-attr]
        for _ in range(20):
            frame = rng.bytes(message.length)
            found = dict(zip(plan.signal_names, plan.decode(frame), strict=True))
            try:
                expected = their_message.decode(frame, decode_choices=False)
            except cantools.database.DecodeError:
                continue
            assert {n: v for n, v in found.items() if v is not None} == expected
