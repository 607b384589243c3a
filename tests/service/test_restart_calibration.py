"""Beginning the calibration anew while the engine runs, and taking the former one back."""

from __future__ import annotations

import pytest

from engine_bus import CONFIGS, ScriptedEstimator, engine_of, load
from imucald.can.columns import FrameColumns
from imucald.mount.estimate import MountState
from imucald.runtime.engine import Engine
from imucald.runtime.session import make_engine
from simulated_bus import degrees_between, drive, drive_frames, fed, loaded, rotation_of

ACCELERATION = 0x640


def feed(engine: Engine, frames: FrameColumns) -> list[tuple[int, bytes]]:
    found = []
    for t, can_id, n, data in zip(
        frames.t.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True
    ):
        found += engine.frame(t, can_id, data[:n].tobytes())
    return found


def test_a_calibration_begun_anew_in_the_middle_of_a_drive_finds_the_mount_again():
    frames = drive_frames()
    early = frames.take(slice(0, 3000))
    engine = fed("published", early)
    used, k = engine.router.used, engine.pipeline.k
    former = engine.restart_calibration()
    assert engine.pipeline.estimator is not former
    assert engine.pipeline.correction is None
    assert engine.pipeline.quality == 0
    assert (engine.router.used, engine.pipeline.k) == (used, k), "counters and time go on"
    engine.columns(frames.take(slice(3000, len(frames))), keep=False)
    assert engine.pipeline.estimator.state in (MountState.USABLE, MountState.FINE)
    _, truth = drive().truth.mounts[0]
    assert degrees_between(rotation_of(engine), truth) < 3.0


def test_after_a_restart_no_corrected_value_is_sent_until_it_is_usable_again():
    frames = drive_frames()
    engine = make_engine(loaded("published"))
    engine.columns(frames.take(slice(0, len(frames) - 400)), keep=False)
    assert engine.pipeline.quality > 0
    last = frames.take(slice(len(frames) - 400, len(frames)))
    before = [d for i, d in feed(engine, last.take(slice(0, 200))) if i == ACCELERATION]
    assert {d[6] & 0xF for d in before} <= {2, 3, 4}
    former = engine.restart_calibration()
    after = [d for i, d in feed(engine, last.take(slice(200, 400))) if i == ACCELERATION]
    assert after
    assert {d[6] & 0xF for d in after} == {0}
    assert {d[:6] for d in after} == {b"\x00\x80" * 3}
    engine.resume_calibration(former)
    assert engine.pipeline.estimator is former
    assert engine.pipeline.quality > 0


def test_the_former_estimator_hears_of_the_time_it_missed(tmp_path):
    made: list[ScriptedEstimator] = []

    def new() -> ScriptedEstimator:
        made.append(ScriptedEstimator())
        return made[-1]

    first = ScriptedEstimator(usable_from=0)
    first.steps = int(MountState.USABLE)
    engine = engine_of(load(CONFIGS["planar"], tmp_path), first, new_estimator=new)
    former = engine.restart_calibration()
    assert former is first
    assert engine.pipeline.estimator is made[0]
    engine.resume_calibration(first)
    assert first.rows == [b"gap"]
    assert engine.pipeline.correction == first.correction


def test_speed_and_health_can_be_asked_for():
    frames = drive_frames()
    engine = make_engine(loaded("published"))
    assert engine.pipeline.speed is None
    assert engine.health().speed_missing
    engine.columns(frames.take(slice(0, 30_000)), keep=False)
    tick, speed = engine.pipeline.speed
    assert tick == pytest.approx(engine.pipeline.k, abs=2)
    t = frames.t[29_999] - frames.t[0]
    truth = drive().samples["speed"]
    assert speed == pytest.approx(float(truth.values[truth.t.searchsorted(t) - 1]), abs=0.5)
    health = engine.health()
    missing = health.accelerometer_missing, health.gyroscope_missing, health.speed_missing
    assert not any(missing)
