"""check judges cycle, loss and silence of each group of a multiplexer, not of the message."""

from __future__ import annotations

import pytest

from engine_bus import columns_of, load
from imucald.config_check import Check

DATABASE = """VERSION ""
BS_:
BU_: IMU
BO_ 512 IMU: 8 IMU
 SG_ Axis M : 0|8@1+ (1,0) [0|0] "" IMU
 SG_ X m1 : 8|16@1- (0.002,0) [0|0] "m/s^2" IMU
 SG_ Y m2 : 8|16@1- (0.002,0) [0|0] "m/s^2" IMU
 SG_ Z m3 : 8|16@1- (0.002,0) [0|0] "m/s^2" IMU
 SG_ V : 32|16@1+ (0.01,0) [0|0] "km/h" IMU
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 512 {stated};
"""
CONFIG = "database: bus.dbc\nsignals:\n  accelerometer: {x: IMU.X, y: IMU.Y, z: IMU.Z}\n"
FRAME_S, SECONDS = 0.02, 40.0


def nothing(_axis: int, _t: float) -> bool:
    return False


def checked(tmp_path, left_out=nothing, stated: int = 0, config: str = CONFIG) -> Check:
    """A check of frames every 20 ms, whose groups 1 to 3 take turns."""
    check = Check(load(config, tmp_path, DATABASE.replace("{stated}", str(stated))))
    frames = [
        (i * FRAME_S, 512, bytes([1 + i % 3, i % 256, 0, 0, i % 200, 0, 0, 0]))
        for i in range(int(SECONDS / FRAME_S))
        if not left_out(1 + i % 3, i * FRAME_S)
    ]
    check.feed(columns_of(frames))
    return check


def message(check: Check) -> dict:
    return check.report()["messages"][0]


def texts(check: Check) -> str:
    return "\n".join(f.text for f in check.findings())


@pytest.mark.parametrize(("stated", "is_noted"), [(20, False), (60, False), (150, True)])
def test_a_stated_cycle_may_be_that_of_a_frame_or_of_a_group(tmp_path, stated, is_noted):
    check = checked(tmp_path, stated=stated)
    assert message(check)["cycle_s"] == pytest.approx(0.06)
    assert ("comes every" in texts(check)) == is_noted


def test_a_group_that_stops_is_named_though_the_others_go_on(tmp_path):
    check = checked(tmp_path, lambda axis, t: axis == 3 and t > 12.0)
    assert "no frame of IMU comes from 0:11 on" in texts(check)
    assert "no frame of IMU comes" not in texts(checked(tmp_path))


def test_lost_frames_are_counted_within_each_group(tmp_path):
    check = checked(tmp_path, lambda axis, t: axis == 2 and round(t / FRAME_S) // 3 % 10 == 0)
    assert message(check)["lost_share"] == pytest.approx(0.1, abs=0.02)
    assert message(checked(tmp_path))["lost_share"] == 0.0


def test_a_signal_of_every_frame_has_the_cycle_of_the_frames(tmp_path):
    check = checked(tmp_path, config=CONFIG + "  speed: IMU.V\n")
    (probe,) = check.probes
    assert probe.cycle_of("speed") == pytest.approx(0.02)
    assert probe.cycle_of("accel") == pytest.approx(0.06)
