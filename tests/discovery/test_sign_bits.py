"""A sign in a bit of its own, as the VW group sends it: proposed by init, missed by check."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import imucald
from imucald import cli
from imucald.can.columns import FrameColumns, concatenate
from imucald.can.dbc.database import load_database_text
from imucald.can.logs.candump_writer import CandumpWriter
from imucald.can.logs.log_reader import LogReader
from imucald.discovery import GatheredFrames, discover
from paths import ROOT

EXAMPLE = (ROOT / "dbc" / "imucald_example.dbc").read_text()
GROUP = """
BO_ 1281 LWI_01: 8 ESC
 SG_ LWI_Counter : 0|8@1+ (1,0) [0|255] "" GATEWAY
 SG_ LWI_Winkel : 16|13@1+ (0.1,0) [0|800] "Unit_DegreOfArc" GATEWAY
 SG_ LWI_Valid : 30|1@1+ (1,0) [0|1] "" GATEWAY
 SG_ LWI_VZ_Winkel : 29|1@1+ (1,0) [0|1] "" GATEWAY

BO_ 1282 LWI_02: 8 ESC
 SG_ LWI_Ready : 8|1@1+ (1,0) [0|1] "" GATEWAY
 SG_ LWI_VZ : 12|1@1+ (1,0) [0|1] "" GATEWAY

"""
HAND = """database: car.dbc
signals:
  accelerometer: {x: IMU_Accel.AccelX, y: IMU_Accel.AccelY, z: IMU_Accel.AccelZ}
  speed: ESC_Speed.VehicleSpeed
  steering_wheel_angle: LWI_01.LWI_Winkel
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> FrameColumns:
    log = tmp_path_factory.mktemp("drive") / "drive.log"
    assert cli.main(["simulate", "--out", str(log), "--minutes", "10", "--seed", "8"]) == 0
    return concatenate(list(LogReader([log])))


def as_magnitudes(
    frames: FrameColumns, one_is_negative: bool = True, apart: bool = False
) -> FrameColumns:
    """The steering angle of the example's bus again, as magnitude and sign bit.

    apart: the bit is in a message of its own, of half the rate.
    """
    angle = frames.take(frames.can_id == _steering_id())
    raw = (angle.data[:, 0].astype(np.int16) << 8 | angle.data[:, 1]).astype(np.int16)
    bit = (raw < 0) if one_is_negative else (raw >= 0)
    data = np.zeros_like(angle.data)
    size = np.abs(raw.astype(np.int32)).astype(np.uint16)
    data[:, 0] = np.arange(len(raw)) % 256
    data[:, 2] = size & 0xFF
    data[:, 3] = size >> 8 | bit.astype(np.uint8) << 5 | (np.arange(len(raw)) // 50 % 2) << 6
    n = len(raw)
    parts = [frames.take(frames.can_id != _steering_id())]
    if apart:
        other = np.zeros_like(data[::2])
        other[:, 1] = (data[::2, 3] >> 5 & 1) << 4 | 1
        data[:, 3] &= 0xDF
        size = len(other)
        parts.append(
            FrameColumns(
                angle.t[::2] + 0.0005, np.full(size, 1282, np.uint32), np.full(size, 8, np.uint8),
                other, angle.channel[::2], angle.channels,
            )
        )  # fmt: skip
    again = FrameColumns(
        angle.t + 0.001, np.full(n, 1281, np.uint32), np.full(n, 8, np.uint8), data,
        angle.channel, angle.channels,
    )  # fmt: skip
    whole = concatenate([*parts, again])
    return whole.take(np.argsort(whole.t, kind="stable"))


def _steering_id() -> int:
    line = next(x for x in EXAMPLE.splitlines() if x.startswith("BO_") and "Steering" in x)
    return int(line.split()[1])


def _database() -> str:
    return EXAMPLE.replace("\nBO_ ", f"{GROUP}BO_ ", 1)


@pytest.mark.parametrize("one_is_negative", [True, False])
def test_a_sign_in_a_bit_of_its_own_is_proposed_with_the_sense_that_the_turns_show(
    recorded, one_is_negative
):
    frames = GatheredFrames.from_chunks([as_magnitudes(recorded, one_is_negative)])
    proposal = discover({"car.dbc": load_database_text(_database(), "dbc")}, frames)
    choice = proposal.choice("steering_wheel_angle")
    assert choice.is_sure
    source = choice.sources[""]
    assert source.signal == "LWI_01.LWI_Winkel"
    assert source.sign_signal == "LWI_01.LWI_VZ_Winkel"
    assert source.sign == (1 if one_is_negative else -1)


@pytest.mark.parametrize("one_is_negative", [True, False])
def test_a_sign_in_another_message_is_proposed(recorded, one_is_negative):
    frames = GatheredFrames.from_chunks([as_magnitudes(recorded, one_is_negative, apart=True)])
    proposal = discover({"car.dbc": load_database_text(_database(), "dbc")}, frames)
    choice = proposal.choice("steering_wheel_angle")
    source = choice.sources[""]
    assert choice.is_sure
    assert (source.signal, source.sign_signal) == ("LWI_01.LWI_Winkel", "LWI_02.LWI_VZ")
    assert source.sign == (1 if one_is_negative else -1)


def test_check_asks_where_the_sign_is_of_a_steering_angle_that_is_never_negative(
    recorded, tmp_path: Path
):
    (tmp_path / "car.dbc").write_text(_database())
    config = tmp_path / "car.yaml"
    config.write_text(HAND)
    log = tmp_path / "drive.log"
    with CandumpWriter(log) as writer:
        writer.write_columns(as_magnitudes(recorded))
    found = imucald.check(config, log).findings
    texts = [f["text"] for f in found if f["quantity"] == "steering_wheel_angle"]
    assert any("never negative" in t and "LWI_01.LWI_VZ_Winkel" in t for t in texts)
    config.write_text(
        HAND.replace(
            "LWI_01.LWI_Winkel", "{signal: LWI_01.LWI_Winkel, sign_signal: LWI_01.LWI_VZ_Winkel}"
        )
    )
    assert not any("never negative" in f["text"] for f in imucald.check(config, log).findings)
