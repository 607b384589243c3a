"""Engine: one frame at a time and columns give the same frames, counters and ticks, bit for bit."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from engine_bus import CONFIGS, Traffic, columns_of, engine_of, frames_of, load
from imucald.runtime.engine import Engine


@pytest.fixture(scope="module")
def loaded(tmp_path_factory):
    return {name: load(text, tmp_path_factory.mktemp(name)) for name, text in CONFIGS.items()}


def one_by_one(engine: Engine, frames):
    return [out for frame in frames for out in engine.frame(*frame)]


def in_chunks(engine: Engine, frames, rng, scalar_share):
    """Feed chunks of random length, by columns or (with the given share) frame by frame."""
    out, start = [], 0
    while start < len(frames):
        stop = start + rng.choice([1, 2, 3, 10, 40, 200, len(frames)])
        part = frames[start:stop]
        if rng.random() < scalar_share:
            out += one_by_one(engine, part)
        else:
            out += frames_of(engine.columns(columns_of(part)))
        start = stop
    return out


def results(engine: Engine):
    """Everything an engine can say about what it has seen."""
    router, pipeline = engine.router, engine.pipeline
    return {
        "used": router.used,
        "rejected": dict(router.rejected),
        "samples": {c: n for c, n in router.sample_counts.items() if n},
        "sent": engine.sent,
        "ticks": pipeline.k,
        "rows": pipeline.estimator.rows,
        "first": (pipeline.first_usable, pipeline.first_fine),
        "now": engine.timebase.now,
        "steps": engine.timebase.steps,
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CONFIGS))
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32), scalar_share=st.sampled_from([0.0, 0.5]))
def test_columns_and_single_frames_are_the_same_engine(loaded, name, seed, scalar_share):
    rng = random.Random(seed)
    frames = Traffic(rng, loaded[name]).frames(rng.choice([3, 40, 300]))
    single, other = engine_of(loaded[name]), engine_of(loaded[name])
    expected = one_by_one(single, frames)
    assert in_chunks(other, frames, rng, scalar_share) == expected
    assert results(other) == results(single)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(CONFIGS))
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_without_output_all_else_is_the_same(loaded, name, seed):
    rng = random.Random(seed)
    frames = Traffic(rng, loaded[name]).frames(200)
    silent, seen = engine_of(loaded[name]), []
    reporting = engine_of(loaded[name], on_snapshot=seen.append)
    expected = engine_of(loaded[name])
    for start in range(0, len(frames), 70):
        part = columns_of(frames[start : start + 70])
        expected.columns(part)
        assert silent.columns(part, keep=False) is None
        assert reporting.columns(part, keep=False) is None
    assert results(silent) == results(reporting) == results(expected)
    assert [s.k for s in seen] == [
        k - 1 for k in range(1, expected.pipeline.k + 1) if k % expected.pipeline.status_ticks == 0
    ]
