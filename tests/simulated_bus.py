"""A simulated drive as frames, made once per process, and ways to tamper with it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns, concatenate
from imucald.config import LoadedConfig
from imucald.core.rotations import Matrix3, vector_from_rotation
from imucald.runtime.engine import Engine
from imucald.runtime.session import make_engine, open_config
from imucald.simulation import Drive, random_model, simulate
from imucald.traffic.can_log import bus_frames
from imucald.traffic.drive_encoder import BusEncoder

CONFIG = Path(__file__).parent.parent / "config" / "examples" / "passenger_car.yaml"
EPOCH = 1.6e9
"""Stamp of a drive's start [s]."""


def loaded(estimator: str = "full") -> LoadedConfig:
    """The configuration of the simulated bus, with an estimator."""
    found = open_config(CONFIG)
    calibration = replace(found.config.calibration, estimator=estimator)
    found.config = replace(found.config, calibration=calibration)
    return found


@cache
def drive(seed: int = 3, minutes: float = 4.0) -> Drive:
    """A simulated drive."""
    return simulate(random_model(seed, standing_first=True), seed, minutes)


@cache
def drive_frames(seed: int = 3, minutes: float = 4.0) -> FrameColumns:
    """Its frames in the order of the bus, with stamps in whole microseconds, as logs have them."""
    frames = concatenate(list(bus_frames(drive(seed, minutes), BusEncoder(loaded()))))
    return with_times(frames, np.rint((frames.t + EPOCH) * 1e6) / 1e6)


def with_times(frames: FrameColumns, t: NDArray[np.float64]) -> FrameColumns:
    """The same frames at other times."""
    return FrameColumns(
        t, frames.can_id, frames.length, frames.data, frames.channel, frames.channels
    )


def with_data(
    frames: FrameColumns, data: NDArray[np.uint8], length: NDArray[np.uint8] | None = None
) -> FrameColumns:
    """The same frames with other payloads (and lengths)."""
    return FrameColumns(
        frames.t,
        frames.can_id,
        frames.length if length is None else length,
        data,
        frames.channel,
        frames.channels,
    )


def merged(first: FrameColumns, second: FrameColumns) -> FrameColumns:
    """Both, in order of time; of equal times the first's come first."""
    both = concatenate([first, second])
    return both.take(np.argsort(both.t, kind="stable"))


def fed(estimator: str, frames: FrameColumns, chunk: int = 20_000) -> Engine:
    """An engine that has had the frames."""
    engine = make_engine(loaded(estimator))
    for start in range(0, len(frames), chunk):
        engine.columns(frames.take(slice(start, start + chunk)), keep=False)
    return engine


def rotation_of(engine: Engine) -> Matrix3:
    """What the engine's estimator has found."""
    found = engine.pipeline.estimator.estimate().R_vehicle_from_sensor
    assert found is not None
    return found


def degrees_between(a: Matrix3, b: Matrix3) -> float:
    """Angle between two rotations."""
    return float(np.degrees(np.linalg.norm(vector_from_rotation(a @ b.T))))
