"""With a model, one frame at a time and columns give the same frames, counts and ticks."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine_bus import (
    CLASH,
    PLANAR,
    RICH,
    SPLIT,
    Sender,
    Traffic,
    columns_of,
    engine_of,
    frames_of,
    load,
)
from imucald.model_compensation import compensation_from_model
from model_compensation.models import random_terms

WARM = RICH.replace("  brake:", "  temperature: {signal: SPD2.V2, unit: degC}\n  brake:")
CONFIGS = {"warm": WARM, "clash": CLASH, "planar": PLANAR, "split": SPLIT}


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    return {name: load(text, tmp_path_factory.mktemp(name)) for name, text in CONFIGS.items()}


def engine_with(loaded, model):
    signals = loaded.config.signals
    channels = {"accel", "gyro", "temperature", "speed"}
    rates = [f"parallel/{p.name}" for p in signals.parallel]
    preprocessing = compensation_from_model(model).preprocessing_chain(
        channels, signals.speed is None, rates
    )
    return engine_of(loaded, preprocessing=preprocessing)


def one_by_one(engine, frames):
    return [out for frame in frames for out in engine.frame(*frame)]


def in_chunks(engine, frames, rng):
    out, start = [], 0
    while start < len(frames):
        stop = start + rng.choice([1, 2, 3, 10, 40, 200, len(frames)])
        part = frames[start:stop]
        if rng.random() < 0.3:
            out += one_by_one(engine, part)
        else:
            out += frames_of(engine.columns(columns_of(part)))
        start = stop
    return out


def results(engine):
    router, pipeline = engine.router, engine.pipeline
    return {
        "rejected": dict(router.rejected),
        "sent": engine.sent,
        "ticks": pipeline.k,
        "rows": pipeline.estimator.rows,
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CONFIGS))
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_columns_and_single_frames_are_the_same_engine(loaded, name, seed):
    rng = random.Random(seed)
    model = random_terms(rng)
    frames = Traffic(rng, loaded[name]).frames(rng.choice([3, 40, 300]))
    single, other = engine_with(loaded[name], model), engine_with(loaded[name], model)
    expected = one_by_one(single, frames)
    assert in_chunks(other, frames, rng) == expected
    assert results(other) == results(single)


def test_a_model_changes_what_is_sent(loaded):
    """The test above would be empty if nothing were done."""
    rng = random.Random(4)
    frames = Traffic(random.Random(5), loaded["warm"]).frames(300)
    model = {"accel": {"bias": [0.5, 0.5, 0.5]}, **random_terms(rng)}
    plain, other = engine_of(loaded["warm"]), engine_with(loaded["warm"], model)
    assert one_by_one(plain, frames) != one_by_one(other, frames)
    assert plain.pipeline.estimator.rows != other.pipeline.estimator.rows


def dense(rng, n):
    """A drive's rhythm: force and rate every 10 ms, in turn; now and then the clock is set."""
    sender = Sender()
    t, frames = 1.6e9, []
    for i in range(n):
        t += 0.005
        if rng.random() < 0.01:
            t += rng.choice([0.3, 11.0, -2.0])
        if i % 2:
            rates = {axis: rng.uniform(-20.0, 20.0) for axis in ("GX", "GY", "GZ")}
            frames.append(sender.frame(t, "GYR", **rates))
        else:
            force = {"BX": rng.uniform(-0.5, 0.5), "BY": rng.uniform(-0.5, 0.5)}
            frames.append(sender.frame(t, "ACC_XY", **force))
            frames.append(sender.frame(t, "ACC_Z", BZ=rng.uniform(0.8, 1.2)))
    return frames


DENSE = """
database: bus.dbc
signals:
  accelerometer: {x: ACC_XY.BX, y: ACC_XY.BY, z: ACC_Z.BZ}
  gyroscope: {x: GYR.GX, y: GYR.GY, z: GYR.GZ}
"""


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_the_same_at_a_drives_rhythm_with_holes_and_jumps(tmp_path_factory, seed):
    rng = random.Random(seed)
    loaded = load(DENSE, tmp_path_factory.mktemp("dense"))
    model = {
        **random_terms(rng),
        "mount": {"lever_arm_m": [2.0, -1.0, 0.5]},
        "suspension": {"squat_gradient": 0.01, "dive_gradient": 0.004, "roll_gradient": 0.02},
        "gyro": {"g_sensitivity": [0.01, -0.01, 0.02]},
    }
    frames = dense(rng, 300)
    single, other = engine_with(loaded, model), engine_with(loaded, model)
    expected = one_by_one(single, frames)
    assert in_chunks(other, frames, rng) == expected
    assert results(other) == results(single)


@pytest.mark.slow
@pytest.mark.parametrize("by_columns", [False, True])
def test_a_clock_that_is_set_ends_what_was_known_of_the_turning(tmp_path, by_columns):
    loaded = load(DENSE, tmp_path)
    model = {"mount": {"lever_arm_m": [3.0, 0.0, 0.0]}}

    def last(turning, step):
        sender, engine = Sender(), engine_with(loaded, model)
        t = 1.6e9
        frames = []
        for i in range(40):  # the mount is known by then
            frames.append(sender.frame(t + 0.01 * i, "ACC_XY", BX=0.0, BY=0.0))
            frames.append(sender.frame(t + 0.01 * i, "ACC_Z", BZ=1.0))
        frames.append(sender.frame(t + 0.4, "GYR", GX=0.0, GY=0.0, GZ=100.0 * turning))
        frames.append(sender.frame(t + 0.41 + step, "ACC_XY", BX=0.0, BY=0.0))
        frames.append(sender.frame(t + 0.41 + step, "ACC_Z", BZ=1.0))
        if by_columns:
            out = frames_of(engine.columns(columns_of(frames)))
        else:
            out = one_by_one(engine, frames)
        return [data for can_id, data in out if can_id == 0x640][-1]

    assert last(True, 0.0) != last(False, 0.0)
    assert last(True, -100.0) == last(False, -100.0)
