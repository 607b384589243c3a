"""Clocks that step, stamps that jitter or come out of order: the estimate does not jump."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import shuttle
from imucald.can.columns import FrameColumns
from imucald.can.logs.log_reader import LogReader
from imucald.core.rotations import vector_from_rotation
from imucald.mount.estimate import Correction
from imucald.runtime.session import make_engine, open_config

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    config = shuttle.write(folder, cycles=4)
    (frames,) = LogReader([folder / "shuttle.log"])
    return config, frames


def stamped(frames: FrameColumns, t: np.ndarray) -> FrameColumns:
    """The same frames, in the same order, at other stamps."""
    return FrameColumns(
        t, frames.can_id, frames.length, frames.data, frames.channel, frames.channels
    )


def course(config, frames: FrameColumns) -> tuple[np.ndarray, float]:
    """Run live; the last rotation, and the largest step of the rotation in force [deg]."""
    engine = make_engine(open_config(config))
    rotations: list[Correction] = []
    for t, can_id, length, data in zip(
        frames.t.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True
    ):
        engine.frame(t, can_id, data[:length].tobytes())
        now = engine.pipeline.correction
        if now is not None and (not rotations or now != rotations[-1]):
            rotations.append(now)
    assert rotations, "never usable: the test proves nothing"
    matrices = [r.matrix() for r in rotations]
    steps = [angle(a, b) for a, b in itertools.pairwise(matrices)]
    return matrices[-1], max(steps, default=0.0)


def angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.linalg.norm(vector_from_rotation(a @ b.T))))


def stepped(t: np.ndarray, at: float, hours: float) -> np.ndarray:
    return t + np.where(t - t[0] > at, 3600.0 * hours, 0.0)


def jittered(t: np.ndarray) -> np.ndarray:
    return t + np.random.default_rng(1).uniform(-0.02, 0.02, len(t))


def reordered(t: np.ndarray) -> np.ndarray:
    swapped = t.copy()
    swapped[5::20], swapped[6::20] = t[6::20][: len(t[5::20])], t[5::20][: len(t[6::20])]
    return swapped


@pytest.mark.parametrize(
    "change",
    [
        lambda t: stepped(t, 25.0, 1.0),
        lambda t: stepped(t, 25.0, -1.0),
        lambda t: stepped(stepped(t, 20.0, -1.0), 30.0, 1.0),
        jittered,
        reordered,
    ],
    ids=["forward", "back", "back_and_forward", "jitter", "reordered"],
)
def test_the_estimate_does_not_jump(drive, change):
    config, frames = drive
    plain, _ = course(config, frames)
    found, largest = course(config, stamped(frames, change(frames.t)))
    assert angle(plain, found) < 0.5
    assert largest < 0.3
