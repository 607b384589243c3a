"""With a model, one frame at a time and columns give the same frames, counts and ticks."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from compensation.models import random_terms
from engine_bus import CLASH, PLANAR, RICH, SPLIT, Traffic, columns_of, engine_of, frames_of, load
from imucald.compensation import compensation_from_model

WARM = RICH.replace("  brake:", "  temperature: {signal: SPD2.V2, unit: degC}\n  brake:")
CONFIGS = {"warm": WARM, "clash": CLASH, "planar": PLANAR, "split": SPLIT}


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    return {name: load(text, tmp_path_factory.mktemp(name)) for name, text in CONFIGS.items()}


def engine_with(loaded, model):
    signals = loaded.config.signals
    channels = {"accel", "gyro", "temperature", "speed"}
    rates = [f"parallel/{p.name}" for p in signals.parallel]
    stages = compensation_from_model(model).stages(channels, signals.speed is None, rates)
    return engine_of(loaded, stages=stages)


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


def told(engine):
    router, pipeline = engine.router, engine.pipeline
    return {
        "rejected": dict(router.rejected),
        "sent": engine.sent,
        "ticks": pipeline.k,
        "rows": pipeline.estimator.rows,
    }


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
    assert told(other) == told(single)


def test_a_model_changes_what_is_sent(loaded):
    """The test above would be empty if nothing were done."""
    rng = random.Random(4)
    frames = Traffic(random.Random(5), loaded["warm"]).frames(300)
    model = {"accel": {"bias": [0.5, 0.5, 0.5]}, **random_terms(rng)}
    plain, other = engine_of(loaded["warm"]), engine_with(loaded["warm"], model)
    assert one_by_one(plain, frames) != one_by_one(other, frames)
    assert plain.pipeline.estimator.rows != other.pipeline.estimator.rows
