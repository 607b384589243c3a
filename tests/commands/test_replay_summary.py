"""What `imucald replay` says on a terminal of faults within a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from imucald import cli
from imucald.can.logs.log_reader import CandumpWriter
from imucald.simulation import random_model, simulate
from imucald.traffic.can_log import bus_frames
from imucald.traffic.drive_encoder import BusEncoder, example_config
from paths import ROOT

EXAMPLE = ROOT / "config" / "examples" / "passenger_car.yaml"
MINUTES = 3.0
STICKS_AT = 100.0


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


def test_a_sensor_that_sticks_is_reported_with_its_time(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    lines = replayed(capsys, tmp_path, STICKS_AT)
    events = [line for line in lines if "accel stuck" in line]
    assert len(events) == 1
    assert events[0].startswith("at 1:4")
    text = " ".join(line.strip() for line in lines)
    assert "waiting for" in text
    assert "faulty" in text.partition("waiting for")[2]


def test_a_sound_drive_has_no_such_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    lines = replayed(capsys, tmp_path, None)
    assert lines[0].startswith("state:")
    assert not [line for line in lines if line.startswith("at ")]
