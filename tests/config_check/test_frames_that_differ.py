"""What check says of frames that are shorter, of several senders, or come in several pieces."""

from __future__ import annotations

import pytest

from engine_bus import columns_of, load
from imucald.can.columns import CAN_EFF_FLAG
from imucald.config_check import Check, Finding

ACC, SPEED = 0x18FF0500, 0x18FEF100
DATABASE = f"""VERSION ""
BS_:
BU_: IMU
BO_ {ACC + 0xFE | CAN_EFF_FLAG} ACC: 8 IMU
 SG_ X : 0|16@1- (0.002,0) [0|0] "m/s^2" IMU
 SG_ Y : 16|16@1- (0.002,0) [0|0] "m/s^2" IMU
 SG_ Z : 32|16@1- (0.002,0) [0|0] "m/s^2" IMU
BO_ {SPEED + 0xFE | CAN_EFF_FLAG} CCVS1: 8 IMU
 SG_ V : 8|16@1+ (0.00390625,0) [0|250] "km/h" IMU
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
"""
CONFIG = """database: bus.dbc
signals:
  accelerometer: {x: ACC.X, y: ACC.Y, z: ACC.Z}
  speed: CCVS1.V
"""


def found(tmp_path, *rows: tuple[int, bytes], config: str = CONFIG) -> list[Finding]:
    """The findings of 3 s of these frames (id without flag, payload), over and over."""
    check = Check(load(config, tmp_path, DATABASE))
    frames = [
        (0.01 * i + 0.001 * k, can_id | CAN_EFF_FLAG, data)
        for i in range(300)
        for k, (can_id, data) in enumerate(rows)
    ]
    columns = columns_of(frames)
    check.feed(columns)
    return check.findings()


def texts(findings: list[Finding], name: str) -> str:
    return "\n".join(f.text for f in findings if name in f.text)


@pytest.mark.parametrize(("kind", "address"), [(0x20, 0xFF), (0x10, 0x10)])
def test_a_message_that_is_announced_in_several_frames_is_named(tmp_path, kind, address):
    announced = bytes([kind, 12, 0, 2, 0xFF, 0x05, 0xFF, 0x00])
    rows = (0x1CEC00E2 | address << 8, announced), (SPEED, bytes(8))
    text = texts(found(tmp_path, *rows), "ACC")
    assert "12 bytes, transport protocol of J1939" in text


def test_neither_an_answer_nor_another_message_announces_it(tmp_path):
    answer = bytes([0x11, 12, 0, 2, 0xFF, 0x05, 0xFF, 0x00])
    other = bytes([0x20, 12, 0, 2, 0xFF, 0x06, 0xFF, 0x00])
    rows = (0x1CEC10E2, answer), (0x1CECFFE2, other), (SPEED, bytes(8))
    text = texts(found(tmp_path, *rows), "ACC")
    assert "no frame of ACC" in text
    assert "transport" not in text


def test_frames_shorter_than_the_database_are_named_with_both_lengths(tmp_path):
    findings = found(tmp_path, (ACC + 0xE2, bytes(6)), (SPEED, bytes(8)))
    assert "frames of ACC have 6 bytes, but the database says 8" in texts(findings, "ACC")
    assert not texts(findings, "frames of CCVS1")


def test_several_senders_of_a_message_are_named_with_the_key_that_chooses(tmp_path):
    rows = (ACC + 0xE3, bytes(8)), (ACC + 0xE2, bytes(8)), (SPEED, bytes(8))
    findings = found(tmp_path, *rows)
    named = next(f for f in findings if "addresses" in f.text)
    assert named.level == "warning"
    assert "0xE2, 0xE3" in named.text
    assert "source_address: 0xE2" in named.text
    assert not texts(findings, "CCVS1 comes from")


def test_the_address_that_is_taken_is_the_one_to_name_not_a_lower_one_that_came_later(tmp_path):
    check = Check(load(CONFIG, tmp_path, DATABASE))
    late = [(5.0 + 0.01 * i, ACC + 0x10 | CAN_EFF_FLAG, bytes(8)) for i in range(300)]
    early = [(0.01 * i, ACC + 0xE2 | CAN_EFF_FLAG, bytes(8)) for i in range(800)]
    check.feed(columns_of(sorted(early + late)))
    text = texts(check.findings(), "addresses")
    assert "0xE2 is used (chosen in the first seconds)" in text
    assert "'source_address: 0xE2'" in text


def test_a_gyroscope_of_another_sender_than_the_accelerometer_is_named(tmp_path):
    gyro = 0x18F02A00
    database = DATABASE.replace(
        "BA_DEF_ BO_",
        f"BO_ {(gyro | 0xFE) | CAN_EFF_FLAG} GYR: 8 CAR\n"
        + "".join(
            f' SG_ G{a} : {16 * i}|16@1- (0.01,0) [-300|300] "deg/s" CAR\n'
            for i, a in enumerate("XYZ")
        )
        + "\nBA_DEF_ BO_",
        1,
    )
    config = f"{CONFIG}\n  gyroscope: {{x: GYR.GX, y: GYR.GY, z: GYR.GZ}}\n"
    check = Check(load(config, tmp_path, database))
    rows = [
        (0.01 * i, pgn + address | CAN_EFF_FLAG, bytes(8))
        for i in range(300)
        for pgn, address in ((ACC, 0x10), (gyro, 0x80))
    ]
    check.feed(columns_of(rows))
    assert "ACC of 0x10, GYR of 0x80" in texts(check.findings(), "several senders")


def test_of_three_senders_whose_frames_are_all_taken_no_loss_is_said(tmp_path):
    check = Check(load(CONFIG, tmp_path, DATABASE))
    rows = [
        (0.02 * i + 0.001 * k, SPEED + address | CAN_EFF_FLAG, bytes(8))
        for i in range(300)
        for k, address in enumerate((0x17, 0x00, 0x0B))
    ]
    check.feed(columns_of(rows))
    probe = next(p for p in check.probes if p.name == "CCVS1")
    assert probe.cycle is None
    assert probe.lost_share is None


def test_two_messages_of_one_pgn_are_told_apart_by_the_addresses_of_the_database(tmp_path):
    box = DATABASE
    for old, new in (ACC + 0xFE, ACC + 0xE2), (SPEED + 0xFE, ACC + 0xE3):
        box = box.replace(f"BO_ {old | CAN_EFF_FLAG}", f"BO_ {new | CAN_EFF_FLAG}")
    check = Check(load(CONFIG, tmp_path, box))
    rows = [
        (0.01 * i + 0.001 * k, ACC + address | CAN_EFF_FLAG, bytes([address] * 8))
        for i in range(300)
        for k, address in enumerate((0xE2, 0xE3))
    ]
    check.feed(columns_of(rows))
    assert [p.frames for p in check.probes] == [300, 300]
    assert not texts(check.findings(), "addresses")


@pytest.mark.parametrize(("old", "new", "key"), [
    ("database: bus.dbc", "database: {path: bus.dbc, j1939: false}", "j1939: true"),
    ("z: ACC.Z}", "z: ACC.Z, source_address: 0x11}", "source_address"),
])  # fmt: skip
def test_a_message_that_comes_from_another_address_is_named_with_its_key(tmp_path, old, new, key):
    rows = (ACC + 0xE2, bytes(8)), (SPEED + 0xFE, bytes(8))
    text = texts(found(tmp_path, *rows, config=CONFIG.replace(old, new)), "no frame of ACC")
    assert "comes from the address 0xE2" in text
    assert key in text


def messages(tmp_path, config: str = CONFIG) -> tuple[dict[str, str], list[Finding]]:
    """The identifiers in the table of messages, and the findings; two boxes send ACC."""
    check = Check(load(config, tmp_path, DATABASE))
    check.feed(
        columns_of([
            (0.01 * i + 0.001 * k, can_id | CAN_EFF_FLAG, bytes(8))
            for i in range(300)
            for k, can_id in enumerate((ACC + 0xE2, ACC + 0xE3, SPEED + 0x17))
        ])
    )  # fmt: skip
    return {row["name"]: row["id"] for row in check.report()["messages"]}, check.findings()


def test_the_table_of_messages_shows_the_address_that_is_used(tmp_path):
    ids, _ = messages(tmp_path)
    assert ids == {"ACC": f"0x{ACC + 0xE2:X}", "CCVS1": f"0x{SPEED + 0x17:X}"}
    ids, _ = messages(tmp_path, CONFIG.replace("z: ACC.Z}", "z: ACC.Z, source_address: 0xE3}"))
    assert ids["ACC"] == f"0x{ACC + 0xE3:X}"


def test_the_senders_that_a_stated_address_leaves_out_are_named(tmp_path):
    _, named = messages(tmp_path, CONFIG.replace("z: ACC.Z}", "z: ACC.Z, source_address: 0xE3}"))
    assert "ACC of 0xE3 is used; 0xE2 sends the same PGN" in texts(named, "the same PGN")
    _, free = messages(tmp_path)
    assert not texts(free, "the same PGN")


def test_other_identifiers_of_11_bits_are_no_other_senders(tmp_path):
    short = DATABASE.replace(f"BO_ {ACC + 0xFE | CAN_EFF_FLAG}", "BO_ 1568")  # 0x620
    check = Check(load(CONFIG, tmp_path, short))
    rows = [(0.01 * i + 0.001 * k, 0x620 + k, bytes(8)) for i in range(300) for k in range(3)]
    check.feed(columns_of(rows))
    assert not texts(check.findings(), "the same PGN")
