"""The published solver on measured drives; frames are unpacked here, by hand."""

from __future__ import annotations

import gzip
import math
from pathlib import Path

import numpy as np
import pytest

from imucald.core.samples import Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import MountEstimate, MountState
from imucald.mount.method_a.estimator import PublishedEstimator
from imucald.mount.method_a.settings import PublishedSettings
from mount_settings import published

DATA = Path(__file__).parents[2].parent / "shared" / "data"
SCALES = {0x200: ("accel", 0.002), 0x201: ("gyro", math.radians(0.02))}


def rows_of(name: str) -> list[list[float]]:
    """Ticks of a drive in the frames of the common `drive.dbc` (little-endian, 16 bits)."""
    path = DATA / name / "drive.log.gz"
    if not path.exists():
        pytest.skip(f"measured data not here: {path}")
    found: dict[int, tuple[list[float], list[bytes]]] = {}
    with gzip.open(path, "rt") as lines:
        for line in lines:
            stamp, _, frame = line.split()
            can_id, _, data = frame.partition("#")
            times, payloads = found.setdefault(int(can_id, 16), ([], []))
            times.append(float(stamp[1:-1]) - 1600000000.0)
            payloads.append(bytes.fromhex(data))
    samples = {}
    for can_id, (times, payloads) in found.items():
        raw = b"".join(payloads)
        if can_id in SCALES:
            channel, scale = SCALES[can_id]
            values = np.frombuffer(raw, "<i2").reshape(-1, 4)[:, :3] * scale
            samples[channel] = Series(np.array(times), np.ascontiguousarray(values))
        elif can_id == 0x202:
            speed = np.frombuffer(raw, "<u2") * 0.01
            samples["speed"] = Series(np.array(times), speed)
    end = max(series.t[-1] for series in samples.values())
    return ticks_from_samples(samples, 0, int(end * 10.0)).tolist()


def run(rows: list[list[float]], settings: PublishedSettings | None = None) -> MountEstimate:
    estimator = PublishedEstimator(settings)
    for row in rows:
        estimator.step(row)
    return estimator.estimate()


@pytest.mark.slow
def test_kingston_forward_axis_within_a_degree_of_the_ins() -> None:
    estimate = run(rows_of("kingston_2008"))
    truth = np.array([0.0039, 0.9998, 0.0155])
    assert estimate.state >= MountState.USABLE
    assert estimate.R_vehicle_from_sensor is not None
    forward = estimate.R_vehicle_from_sensor[0]
    off = math.degrees(math.acos(min(1.0, float(forward @ truth / np.linalg.norm(truth)))))
    assert off < 1.0


def test_circles_as_measured_never_give_a_usable_yaw() -> None:
    rows = rows_of("neu_circles")
    for use_speed in (True, False):
        estimator = PublishedEstimator(PublishedSettings(use_speed=use_speed))
        for row in rows:
            estimator.step(row)
            assert estimator.correction is None
            assert estimator.state < MountState.USABLE


@pytest.mark.slow
def test_a_hill_without_a_gyro_gives_the_yaw_and_does_not_overstate_it() -> None:
    estimate = run(rows_of("quat_orient_21"), published({"speed_delay": 0.3}))
    assert estimate.angles is not None
    assert estimate.std is not None
    assert abs(math.degrees(estimate.angles[2])) < 4.0
    assert math.degrees(estimate.std[2]) > 2.0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["vehsense_2017_10_23_2245", "vehsense_2017_10_25_1829"])
def test_a_loosely_held_phone_is_not_called_fine(name: str) -> None:
    estimate = run(rows_of(name))
    assert estimate.state < MountState.FINE
    assert estimate.std is not None
    assert math.degrees(estimate.std[2]) > 2.0
