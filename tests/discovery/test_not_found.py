"""What init did not find is named with its reason, and two senders of one J1939 message too."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from imucald import cli
from imucald.can.columns import CAN_EFF_FLAG, FrameColumns, concatenate
from imucald.can.dbc.database import load_database_text
from imucald.can.logs.log_reader import LogReader
from imucald.discovery import GatheredFrames, Proposal, as_yaml, discover
from paths import ROOT

EXAMPLE = (ROOT / "dbc" / "imucald_example.dbc").read_text()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> FrameColumns:
    log = tmp_path_factory.mktemp("drive") / "drive.log"
    assert cli.main(["simulate", "--out", str(log), "--minutes", "4", "--seed", "6"]) == 0
    return concatenate(list(LogReader([log])))


def proposed(text: str, frames: FrameColumns) -> Proposal:
    return discover(
        {"car.dbc": load_database_text(text, "dbc")}, GatheredFrames.from_chunks([frames])
    )


def of_message(frames: FrameColumns, name: str) -> np.ndarray:
    line = next(x for x in EXAMPLE.splitlines() if x.startswith("BO_") and f" {name}" in x)
    return frames.can_id == int(line.split()[1])


def test_each_quantity_that_is_not_found_has_a_line_with_its_reason(recorded):
    silent = recorded.take(~of_message(recorded, "EPS_Steer"))
    still = silent.data.copy()
    still[of_message(silent, "ESC_Dynamics")] = 0
    text = "".join(x for x in EXAMPLE.splitlines(True) if "SG_ SensorTemperature" not in x)
    proposal = proposed(text, structs.replace(silent, data=still))
    assert proposal.missing["steering_wheel_angle"].endswith("does not come")
    assert proposal.missing["yaw_rate"] == "ESC_Dynamics.YawRate never changes"
    assert proposal.missing["temperature"] == ""
    lines = as_yaml(proposal, ["car.dbc"]).splitlines()
    assert "  # temperature: not found" in lines
    assert "  # yaw_rate: not found: ESC_Dynamics.YawRate never changes" in lines


@pytest.mark.parametrize(("unit", "reason"), [
    ("degC", "may be the temperature of another part"),
    ("V", "has no unit of temperature (its unit is 'V')"),
])  # fmt: skip
def test_a_temperature_is_not_said_to_lack_motion(recorded, unit, reason):
    lines = EXAMPLE.replace('[-40|87] "degC"', f'[-40|87] "{unit}"').splitlines(True)
    two_axes = "".join(x for x in lines if "SG_ AccelZ" not in x)
    said = proposed(two_axes, recorded).missing["temperature"]
    assert said.endswith(f"SensorTemperature {reason}")


def test_a_signed_signal_that_is_unsigned_in_the_database_is_named_with_the_remedy(recorded):
    text = re.sub(r"(SG_ (?:YawRate|Rate.) .*@[01])-", r"\1+", EXAMPLE)
    assert text != EXAMPLE
    proposal = proposed(text, recorded)
    assert "yaw_rate" in proposal.missing
    said = proposal.missing["yaw_rate"]
    assert said.startswith("ESC_Dynamics.YawRate is signed according to its values, but unsigned")
    assert "change '+' to '-'" in said
    assert not proposed(EXAMPLE, recorded).missing.get("yaw_rate")


def test_a_signal_that_does_not_follow_the_motion_is_not_said_to_have_no_motion(recorded):
    """Its sign is in another message, where `init` does not look for it."""
    data = recorded.data.copy()
    rows = of_message(recorded, "ESC_Dynamics")
    at = next(x for x in EXAMPLE.splitlines() if "SG_ YawRate" in x).partition(": ")[2]
    byte = int(at.partition("|")[0]) // 8
    raw = data[rows, byte : byte + 2].copy().view(">i2")
    data[rows, byte : byte + 2] = np.abs(raw).astype(">i2").view(np.uint8)
    choice = proposed(EXAMPLE, structs.replace(recorded, data=data)).choice("yaw_rate")
    assert choice.doubt == "chosen by unit and name only: it does not follow the yaw rate"


def test_a_gyroscope_without_a_stated_unit_is_unsure_where_no_speed_comes(recorded):
    """In a vehicle the tilt of the body in bends adds to gravity, and shows no unit."""
    silent = recorded.take(~(of_message(recorded, "ESC_Speed") | of_message(recorded, "ESC_Wheel")))
    text = re.sub(r"(SG_ Rate. .*@1-) \(0.01,0\)(.*)\"deg/s\"", r'\1 (0.1,0)\2""', EXAMPLE)
    assert text != EXAMPLE
    choice = proposed(text, silent).choice("gyroscope")
    assert choice is None or not choice.is_sure


def test_nothing_that_was_found_is_called_missing(recorded):
    proposal = proposed(EXAMPLE, recorded)
    assert not set(proposal.missing) & {c.quantity for c in proposal.choices}


def test_init_prints_what_it_did_not_find(recorded, tmp_path: Path, capsys):
    database = tmp_path / "car.dbc"
    database.write_text("".join(x for x in EXAMPLE.splitlines(True) if "SensorTemp" not in x))
    log = tmp_path / "drive.log"
    assert cli.main(["simulate", "--out", str(log), "--minutes", "3", "--seed", "6"]) == 0
    out = tmp_path / "car.yaml"
    assert cli.main(["init", "--database", str(database), str(log), "--out", str(out)]) == 0
    assert "not found: " in (printed := capsys.readouterr().err)
    assert "temperature" in printed


PGN = 0x18F02D00


def as_j1939() -> str:
    """The example's database, its accelerometer a message of J1939."""
    box = next(x for x in EXAMPLE.splitlines() if x.startswith("BO_") and " IMU_Accel" in x)
    text = EXAMPLE.replace(box, box.replace(box.split()[1], str(PGN + 0xFE | 1 << 31)))
    return text + (
        'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
        'BA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
        f'BA_ "VFrameFormat" BO_ {PGN + 0xFE | 1 << 31} 3;\n'
    )


def sent_by(frames: FrameColumns, senders: dict[int, np.ndarray]) -> FrameColumns:
    """The frames with the accelerometer's from these addresses, with these payloads."""
    accel = of_message(frames, "IMU_Accel")
    parts = [frames.take(~accel)]
    for address, data in senders.items():
        one = frames.take(accel)
        ids = np.full(len(one), PGN + address | CAN_EFF_FLAG, np.uint32)
        parts.append(structs.replace(one, can_id=ids, data=data))
    whole = concatenate(parts)
    return whole.take(np.argsort(whole.t, kind="stable"))


def test_two_senders_of_a_j1939_message_are_named_and_one_is_taken(recorded):
    data = recorded.take(of_message(recorded, "IMU_Accel")).data
    proposal = proposed(as_j1939(), sent_by(recorded, {0xE2: data, 0xE3: data // 2}))
    accelerometer = proposal.choice("accelerometer")
    assert {s.source_address for s in accelerometer.sources.values()} == {0xE2}
    assert "0xE2 and 0xE3" in accelerometer.doubt
    assert "source_address: 0xE2" in as_yaml(proposal, ["car.dbc"])


def test_a_sender_that_has_no_value_is_not_the_one_that_is_taken(recorded):
    data = recorded.take(of_message(recorded, "IMU_Accel")).data
    nothing = np.full_like(data, 0xFF)
    proposal = proposed(as_j1939(), sent_by(recorded, {0x10: nothing, 0xE3: data}))
    accelerometer = proposal.choice("accelerometer")
    assert {s.source_address for s in accelerometer.sources.values()} == {0xE3}


def test_of_two_senders_the_one_that_came_first_is_taken_as_run_does(recorded):
    accel = recorded.take(of_message(recorded, "IMU_Accel"))
    frames = sent_by(recorded, {0xE2: accel.data, 0xC8: accel.data // 2})
    start = float(frames.t[0]) + 60.0
    is_late = ((frames.can_id & 0x1FFFFFFF) == PGN + 0xC8) & (frames.t < start)
    proposal = proposed(as_j1939(), frames.take(~is_late))
    accelerometer = proposal.choice("accelerometer")
    assert {s.source_address for s in accelerometer.sources.values()} == {0xE2}


def test_what_comes_by_the_transport_protocol_is_named(recorded):
    recorded = recorded.take(~of_message(recorded, "ESC_Dynamics"))  # it has accelerations too
    accel = of_message(recorded, "IMU_Accel")
    data = np.zeros_like(recorded.data)
    data[:, :8] = [0x20, 12, 0, 2, 0xFF, 0x2D, 0xF0, 0x00]
    announcements = structs.replace(
        recorded.take(accel),
        can_id=np.full(np.count_nonzero(accel), 0x1CECFFE2 | CAN_EFF_FLAG, np.uint32),
        data=data[accel],
        length=np.full(np.count_nonzero(accel), 8, np.uint8),
    )
    whole = concatenate([recorded.take(~accel), announcements])
    proposal = proposed(as_j1939(), whole.take(np.argsort(whole.t, kind="stable")))
    assert "12 bytes, transport protocol of J1939" in proposal.missing["accelerometer"]


def test_frames_of_a_used_message_that_are_short_are_named(recorded):
    speed = of_message(recorded, "ESC_Speed")
    length = np.where(speed, 2, recorded.length).astype(np.uint8)
    proposal = proposed(EXAMPLE, structs.replace(recorded, length=length))
    notes = [n for n in proposal.notes if "frames of" in n]
    assert [n.partition(",")[0] for n in notes] == ["frames of ESC_Speed have 2 bytes"]


@pytest.mark.parametrize("name", ["CruiseSetSpeed", "DAS_accSpeedLimit", "ACC_ObjRelSpd"])
def test_a_speed_that_is_wished_or_another_vehicles_is_not_proposed_for_its_name(name):
    text = f"""VERSION ""
BS_:
BU_: A
BO_ 5 M: 8 A
 SG_ {name} : 0|16@1+ (0.01,0) [0|400] "km/h" A
"""
    database = load_database_text(text, "dbc")
    assert discover({"car.dbc": database}, GatheredFrames()).choice("speed") is None
    own = load_database_text(text.replace(name, "VehicleSpeed"), "dbc")
    assert discover({"car.dbc": own}, GatheredFrames()).choice("speed") is not None
