"""What `imucald replay` says on a terminal of faults within a recording."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from imucald import cli
from imucald.can.logs.log_reader import CandumpWriter
from imucald.core.rotations import angles_from_rotation
from imucald.simulation import random_model, simulate
from imucald.traffic.can_log import bus_frames
from imucald.traffic.drive_encoder import BusEncoder, example_config
from paths import ROOT

EXAMPLE = ROOT / "config" / "examples" / "passenger_car.yaml"
MINUTES = 3.0
STICKS_AT, STICKS_EARLY = 100.0, 30.0
"""When the mount is nearly *fine*, and before it is *usable* [s]."""


def replayed(
    capsys: pytest.CaptureFixture[str], folder: Path, sticks_at: float | None
) -> tuple[str, ...]:
    """Lines of a replay of a drive whose accelerometer keeps its last value from a time on [s]."""
    drive = simulate(random_model(6, standing_first=True), 6, MINUTES)
    accel = drive.samples["accel"]
    force = accel.values.copy()
    if sticks_at is not None:
        last = int(np.searchsorted(accel.t, sticks_at))
        force[last:] = force[last]
    drive.samples["accel"] = replace(accel, values=force)
    log = folder / "drive.log"
    with CandumpWriter(log) as writer:
        for chunk in bus_frames(drive, BusEncoder(example_config())):
            writer.write_columns(chunk)
    cli.main(["replay", "--config", str(EXAMPLE), str(log)])
    return tuple(capsys.readouterr().out.splitlines())


def the_one_event(lines: Sequence[str]) -> str:
    (event,) = (line for line in lines if line.startswith("at ") and "accel stuck" in line)
    return event


def test_a_sensor_that_sticks_is_reported_with_its_time(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lines = replayed(capsys, tmp_path, STICKS_AT)
    assert the_one_event(lines).startswith("at 1:4")
    text = " ".join(line.strip() for line in lines)
    left_out = text.partition("not used for the mount")[2]
    assert "s (no valid accelerometer sample)" in left_out
    assert "s (accelerometer stuck)" in left_out


def test_a_sensor_that_sticks_before_the_mount_is_known_is_what_it_waits_for(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lines = replayed(capsys, tmp_path, STICKS_EARLY)
    assert the_one_event(lines).startswith("at 0:3")
    text = " ".join(line.strip() for line in lines)
    assert "waiting for" in text
    assert "faulty" in text.partition("waiting for")[2]


def test_a_sound_drive_has_no_such_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    lines = replayed(capsys, tmp_path, None)
    assert lines[0].startswith("state:")
    assert not [line for line in lines if line.startswith(("at ", "likely cause"))]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("signal", "cause"),
    [
        ("IMU_Gyro.RateY", "gyroscope: wrong sign of its y axis"),
        ("ESC_Dynamics.YawRate", "yaw_rate: wrong sign"),
    ],
)
def test_a_wrong_sign_is_named_in_the_second_line_and_on_the_page(
    signal: str, cause: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    drive = simulate(random_model(6, standing_first=True), 6, 4.0)
    log, car = tmp_path / "drive.log", tmp_path / "car.yaml"
    with CandumpWriter(log) as writer:
        for chunk in bus_frames(drive, BusEncoder(example_config())):
            writer.write_columns(chunk)
    example = EXAMPLE.read_text().replace("../../dbc", str(ROOT / "dbc"))
    assert f": {signal}" in example
    car.write_text(example.replace(f": {signal}", f": {{signal: {signal}, sign: -1}}"))
    said = f"likely cause (imucald check): {cause}"
    page = tmp_path / "page"
    cli.main(["replay", "--config", str(car), str(log), "--report", str(page)])
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith(said)
    assert said.lower() in (page / "index.html").read_text().lower()
    with log.open("rb") as piped:  # it cannot be read twice
        done = subprocess.run(
            [sys.executable, "-m", "imucald", "replay", "--config", str(car), "-"],
            stdin=piped, capture_output=True, text=True, check=True,
            env={**os.environ, "COLUMNS": "300"},  # a path longer than a line is broken
        )  # fmt: skip
    assert f"run 'imucald check --config {car} LOG'" in " ".join(done.stdout.split())


def test_a_stated_mount_that_is_wrong_is_reported_also_after_the_new_one_took_over(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """In text and in JSON, with the angle by which it is wrong."""
    drive = simulate(random_model(6, standing_first=True), 6, 8.0)
    log, car, out = (tmp_path / name for name in ("drive.log", "car.yaml", "drive.json"))
    with CandumpWriter(log) as writer:
        for chunk in bus_frames(drive, BusEncoder(example_config())):
            writer.write_columns(chunk)
    roll, pitch, yaw = np.degrees(angles_from_rotation(drive.truth.mounts[0][1]))
    stated = f"roll_deg: {roll}, pitch_deg: {pitch}, yaw_deg: {yaw + 12.0}, std_deg: 0.3"
    example = EXAMPLE.read_text().replace("../../dbc", str(ROOT / "dbc"))
    car.write_text(f"{example}calibration: {{mount: {{{stated}}}}}\n")
    assert cli.main(["replay", "--config", str(car), str(log)]) == 0
    said = "the stated mount does not fit this drive: it is off by"
    text = " ".join(line.strip() for line in capsys.readouterr().out.splitlines())
    assert text.count(said) == 1
    assert cli.main(["replay", "--config", str(car), str(log), "--json", str(out), "--quiet"]) == 0
    found = json.loads(out.read_text())
    assert found["state"] in {"usable", "fine"}
    turned = found["details"]["restored"]["contradicted"]["turned_deg"]
    assert turned == pytest.approx(12.0, abs=1.5)
    assert f"{said} {turned:.0f} deg" in text
