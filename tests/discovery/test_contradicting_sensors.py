"""One axis with a wrong sign in the database: what depends on it is not proposed as sure."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from imucald import cli
from imucald.can.dbc.database import load_database
from imucald.can.logs.log_reader import LogReader
from imucald.discovery import GatheredFrames, Proposal, discover
from paths import ROOT

EXAMPLE = (ROOT / "dbc" / "imucald_example.dbc").read_text()
OF_THE_SIDES = ("yaw_rate", "steering_wheel_angle", "lateral_acceleration")


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> GatheredFrames:
    log = tmp_path_factory.mktemp("drive") / "drive.log"
    assert cli.main(["simulate", "--out", str(log), "--minutes", "8", "--seed", "11"]) == 0
    return GatheredFrames.from_chunks(LogReader([log]))


def proposed(folder: Path, recording: GatheredFrames, axis: str = "") -> Proposal:
    """What is proposed where the database has the wrong sign for one axis."""
    text = EXAMPLE
    if axis:
        text = re.sub(rf"(SG_ {axis} :.*?)\(0", r"\1(-0", text)
        assert text != EXAMPLE
    database = folder / "car.dbc"
    database.write_text(text)
    return discover({str(database): load_database(database)}, recording)


@pytest.mark.slow
@pytest.mark.parametrize("axis", ["AccelX", "RateX", "RateY"])
def test_a_wrong_sign_of_one_axis_makes_both_sensors_unsure(recording, tmp_path, axis):
    proposal = proposed(tmp_path, recording, axis)
    for quantity in ("accelerometer", "gyroscope", *OF_THE_SIDES):
        choice = proposal.choice(quantity)
        assert choice is not None
        assert not choice.is_sure, quantity
    gyroscope = proposal.choice("gyroscope")
    assert gyroscope is not None
    assert "does not tilt as the accelerometer does" in gyroscope.doubt


@pytest.mark.slow
def test_right_axes_are_sure(recording, tmp_path):
    proposal = proposed(tmp_path, recording)
    for quantity in ("accelerometer", "gyroscope", *OF_THE_SIDES):
        choice = proposal.choice(quantity)
        assert choice is not None
        assert choice.is_sure, quantity
