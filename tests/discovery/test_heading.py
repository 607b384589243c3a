"""A course on the bus: found however late it comes, and it tells an accelerometer of minus sign."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import cantools
import numpy as np
import pytest

from imucald import cli
from imucald.can.dbc.database import load_database
from imucald.can.logs.log_reader import LogReader
from imucald.config_check.relation import Relation
from imucald.discovery import GatheredFrames, Proposal, discover
from imucald.discovery.heading import HeadingFit, doubt_what_is_turned
from imucald.discovery.proposal import Choice, Proposed
from paths import ROOT

EXAMPLE = ROOT / "dbc" / "imucald_example.dbc"
COURSE_ID = 0x3A0
WANDER = 3.6
"""Seconds; the course explains 0.4 of the turns then."""
AXES = ("AccelX", "AccelY", "AccelZ")


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> list[str]:
    """Lines of a simulated drive and its course once a second, from the yaw rate on its bus."""
    log = tmp_path_factory.mktemp("drive") / "drive.log"
    assert cli.main(["simulate", "--out", str(log), "--minutes", "5", "--seed", "6"]) == 0
    return log.read_text().splitlines()


def with_course(lines: list[str], late: float, wander: float = 0.0) -> list[str]:
    """The drive with a message of the course [0.01 deg, clockwise], sent `late` seconds late,
    and by up to `wander` seconds more, each time anew."""
    rates = cantools.database.load_file(EXAMPLE)
    message = next(m for m in rates.messages if any(s.name == "YawRate" for s in m.signals))
    t, rate = [], []
    for line in lines:
        stamp, _, frame = line.split()[:3]
        identifier, _, data = frame.partition("#")
        if int(identifier, 16) == message.frame_id:
            t.append(float(stamp.strip("()")))
            decoded = message.decode(bytes.fromhex(data), decode_choices=False)
            rate.append(float(decoded["YawRate"]))
    times = np.array(t)
    left = np.concatenate([[0.0], np.cumsum(np.diff(times) * np.array(rate[1:]))])
    sent = np.arange(times[0] + late, times[-1], 1.0)
    more = np.random.default_rng(9).uniform(0.0, wander, len(sent))
    course = np.interp(sent - late - more, times, 100.0 - left) % 360.0
    frames = [
        f"({at:.6f}) can0 {COURSE_ID:03X}#{int(raw).to_bytes(2, 'little').hex().upper()}"
        for at, raw in zip(sent, course / 0.01, strict=True)
    ]
    return sorted([*lines, *frames], key=lambda line: float(line.split()[0].strip("()")))


def proposed(folder: Path, lines: list[str], *, name: str, accel_sign: int) -> Proposal:
    """What is proposed where the database calls the course `name` and the axes have a sign."""
    text = EXAMPLE.read_text()
    if accel_sign < 0:
        for axis in AXES:
            text = re.sub(rf"(SG_ {axis} :.*?)\(0\.002,0\)", r"\1(-0.002,0)", text)
    place = text.index("BO_ 513 ")
    message = (
        f'BO_ {COURSE_ID} Nav: 2 GATEWAY\n SG_ {name} : 0|16@1+ (0.01,0) [0|360] "deg" IMU\n\n'
    )
    database = folder / "car.dbc"
    database.write_text(text[:place] + message + text[place:])
    log = folder / "drive.log"
    log.write_text("\n".join(lines) + "\n")
    frames = GatheredFrames.from_chunks(LogReader([log]))
    return discover({str(database): load_database(database)}, frames)


def signs(proposal: Proposal, quantity: str) -> set[int]:
    choice = proposal.choice(quantity)
    assert choice is not None, quantity
    return {source.sign for source in choice.sources.values()}


@pytest.mark.slow
@pytest.mark.parametrize("late", [0.0, 1.7])
def test_a_course_is_found_and_sure_however_late_it_is(drive, tmp_path, late):
    lines = with_course(drive, late)
    proposal = proposed(tmp_path, lines, name="Bearing", accel_sign=1)
    heading = proposal.choice("heading")
    assert heading is not None
    assert heading.is_sure, heading.doubt
    assert heading.sources[""].signal == "Nav.Bearing"
    assert signs(proposal, "heading") == {1}
    assert signs(proposal, "accelerometer") == {1}
    accelerometer = proposal.choice("accelerometer")
    assert accelerometer is not None
    assert accelerometer.is_sure


@pytest.mark.slow
def test_a_named_course_is_found_where_its_delay_varies(drive, tmp_path):
    """As in a phone's recordings, where half of its changes is noise of the times."""
    lines = with_course(drive, 0.0, wander=WANDER)
    heading = proposed(tmp_path, lines, name="Direction", accel_sign=1).choice("heading")
    assert heading is not None
    assert heading.is_sure, heading.doubt
    unnamed = proposed(tmp_path, lines, name="Sig7", accel_sign=1).choice("heading")
    assert unnamed is None or not unnamed.is_sure


@pytest.mark.slow
def test_an_accelerometer_that_shows_minus_the_force_is_reported_by_the_course(drive, tmp_path):
    """What its database multiplies by -1, the proposal multiplies by -1 again; sides stay right."""
    proposal = proposed(tmp_path, with_course(drive, 0.5), name="Course", accel_sign=-1)
    assert signs(proposal, "accelerometer") == {-1}
    for quantity in ("gyroscope", "yaw_rate", "steering_wheel_angle", "lateral_acceleration"):
        assert signs(proposal, quantity) == {1}, quantity
    assert signs(proposal, "heading") == {1}
    accelerometer = proposal.choice("accelerometer")
    assert accelerometer is not None
    assert "minus the specific force" in accelerometer.doubt


@pytest.mark.slow
def test_without_a_name_that_shows_a_compass_all_that_has_sides_is_unsure(drive, tmp_path):
    proposal = proposed(tmp_path, with_course(drive, 0.5), name="Sig7", accel_sign=-1)
    for quantity in ("accelerometer", "heading", "yaw_rate", "steering_wheel_angle"):
        choice = proposal.choice(quantity)
        assert choice is not None, quantity
        assert not choice.is_sure, quantity


def _fit(sense, reverses=False):
    return HeadingFit(SimpleNamespace(path="GPS.Course"), Relation(sense * 0.95), 0, reverses)


def _choice(quantity, sign, doubt=""):
    sources = {axis: Proposed(f"IMU.{axis}", sign=sign) for axis in "xyz"}
    return Choice(quantity, sources, "", doubt)


@pytest.mark.parametrize(
    ("sense", "reverses", "gyro_sign", "gyro_doubt", "doubted"),
    [
        (+1, False, -1, "no turn shows its sign", {"accelerometer", "gyroscope"}),
        (+1, False, +1, "no turn shows its sign", {"gyroscope"}),
        (+1, False, -1, "", set()),
        (-1, False, -1, "", {"gyroscope"}),
        (+1, True, -1, "", {"gyroscope"}),
        (-1, False, +1, "", set()),
    ],
)
def test_a_heading_proves_nothing_of_what_was_turned_before_it(
    sense, reverses, gyro_sign, gyro_doubt, doubted
):
    accelerometer = _choice("accelerometer", 1)
    gyroscope = _choice("gyroscope", gyro_sign, gyro_doubt)
    doubt_what_is_turned(accelerometer, gyroscope, _fit(sense, reverses))
    assert {c.quantity for c in (accelerometer, gyroscope) if c.doubt} == doubted
