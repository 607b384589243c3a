"""Pipeline: samples -> ticks -> estimator -> corrections, the same in columns as one by one."""

from __future__ import annotations

import random

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from engine_bus import ScriptedEstimator
from imucald.core.samples import QUANTITIES, Series
from imucald.mount.estimate import HOUSING, Correction, MountEstimate, MountState
from imucald.runtime.estimators import estimator_for
from imucald.runtime.pipeline import Pipeline
from imucald.runtime.session import make_engine
from simulated_bus import degrees_between, drive, drive_frames, fed, loaded


def random_samples(rng: random.Random, seconds: float):
    """Samples of some channels at irregular times, and times of rejected ones."""
    channels = rng.sample(sorted(QUANTITIES), rng.randint(1, 6))
    samples, rejected = {}, {}
    generator = np.random.default_rng(rng.getrandbits(32))
    for channel in channels:
        n = rng.choice([0, 1, 5, 200])
        t = np.sort(np.round(generator.uniform(0.0, seconds, n), rng.choice([1, 2, 6])))
        width = QUANTITIES[channel].width
        values = generator.normal(0.0, 5.0, (n, width) if width > 1 else n)
        if n:
            samples[channel] = Series(t, values)
        bad = np.sort(generator.uniform(0.0, seconds, rng.choice([0, 3])))
        if len(bad):
            rejected[channel] = bad
    return samples, rejected


def fed_one_by_one(pipeline: Pipeline, samples, rejected, t_last: float):
    """The same as `run` by `add_sample`, `reject` and `advance`; returns corrections by tick."""
    events = [
        (t, channel, value)
        for channel, series in samples.items()
        for t, value in zip(series.t.tolist(), series.values.tolist(), strict=True)
    ]
    events += [(t, channel, None) for channel, times in rejected.items() for t in times.tolist()]
    events.sort(key=lambda event: event[0])
    by_tick, snapshots = {pipeline.k: (pipeline.correction, pipeline.quality)}, []
    for t, channel, value in [*events, (t_last, "", None)]:
        for k in range(pipeline.k, int(np.floor(t * 10.0))):
            snapshots += pipeline.advance(k + 1)
            by_tick[k + 1] = (pipeline.correction, pipeline.quality)
        if not channel:
            continue
        if value is None:
            pipeline.reject(channel)
        else:
            pipeline.add_sample(t, channel, value if isinstance(value, list) else (value,))
    return by_tick, snapshots


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 12))
def test_columns_give_the_ticks_and_corrections_of_single_samples(seed, status_ticks):
    rng = random.Random(seed)
    seconds = rng.choice([0.05, 1.0, 6.0])
    samples, rejected = random_samples(rng, seconds)
    single = Pipeline(ScriptedEstimator(), status_ticks)
    by_tick, snapshots = fed_one_by_one(single, samples, rejected, seconds)
    columns = Pipeline(ScriptedEstimator(), status_ticks)
    corrections, found = columns.run(samples, rejected, seconds)
    assert columns.estimator.rows == single.estimator.rows
    assert [(s.k, s.usable) for s in found] == [(s.k, s.usable) for s in snapshots]
    assert corrections.first == 0
    ticks = np.arange(len(corrections.corrections))
    rows = np.broadcast_to(corrections.rows_in(HOUSING, ticks), (len(ticks), 12))
    for k, row in enumerate(rows):
        correction, quality = by_tick[k]
        assert corrections.quality[k] == quality
        assert np.isnan(row).all() if correction is None else tuple(row[:9]) == correction.rotation
    assert (columns.first_usable, columns.first_fine) == (single.first_usable, single.first_fine)


class Stepping:
    """An estimator whose state is told by the number of its step."""

    def __init__(self, states):
        self.states, self.k = states, 0

    @property
    def state(self):
        return self.states[self.k]

    @property
    def correction(self):
        usable = self.state not in (MountState.WAITING, MountState.LEVELLED)
        return Correction.turning(np.eye(3)) if usable else None

    def step(self, tick):
        self.k += 1

    def gap(self):
        pass

    def estimate(self):
        return MountEstimate(self.state)


def test_quality_and_first_times_follow_the_states():
    s = MountState
    states = [s.WAITING, s.LEVELLED, s.USABLE, s.FINE, s.SUSPECT, s.RECALIBRATING, s.WAITING]
    pipeline = Pipeline(Stepping(states), 2)
    corrections, snapshots = pipeline.run({}, {}, 0.65)
    assert corrections.quality.tolist() == [0, 0, 2, 3, 4, 4, 0]
    assert pipeline.first_usable == 0.2
    assert pipeline.first_fine == 0.3
    assert [(x.k, x.t, x.usable) for x in snapshots] == [
        (1, 0.2, True),
        (3, 0.4, True),
        (5, 0.6, False),
    ]


def test_a_gap_closes_the_ticks_before_it_and_is_reported():
    pipeline = Pipeline(ScriptedEstimator())
    pipeline.add_sample(0.01, "speed", (3.0,))
    pipeline.gap(7)
    assert len(pipeline.estimator.rows) == 8
    assert pipeline.estimator.rows[-1] == b"gap"
    assert pipeline.k == 7


def test_real_estimators_on_a_drive_do_not_depend_on_how_it_is_cut():
    """Frames one by one, in odd chunks, and whole: the same rotation to the last bit."""
    frames = drive_frames().take(slice(0, 30_000))
    for estimator in ("full", "published"):
        whole = fed(estimator, frames, len(frames))
        chunks = fed(estimator, frames, 977)
        single = make_engine(loaded(estimator))
        rows = zip(
            frames.t.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data,
            strict=True,
        )  # fmt: skip
        for t, can_id, n, data in rows:
            single.frame(t, can_id, data[:n].tobytes())
        expected = single.pipeline.estimator.estimate()
        for engine in (whole, chunks):
            found = engine.pipeline.estimator.estimate()
            assert found.state == expected.state
            assert np.array_equal(found.R_vehicle_from_sensor, expected.R_vehicle_from_sensor)
            assert found.std == expected.std
            assert engine.pipeline.correction == single.pipeline.correction


def test_samples_and_frames_of_one_drive_come_to_the_same_mount():
    """What the bus rounds and delays away is small against the estimate's own uncertainty."""
    simulated = drive()
    pipeline = Pipeline(estimator_for(loaded("published").config))
    pipeline.run(simulated.samples, {}, simulated.duration_s)
    direct = pipeline.estimator.estimate()
    over_bus = fed("published", drive_frames()).pipeline.estimator.estimate()
    apart = degrees_between(direct.R_vehicle_from_sensor, over_bus.R_vehicle_from_sensor)
    assert apart < np.degrees(max(direct.std))
    truth = simulated.truth.R_vehicle_from_sensor()
    assert degrees_between(truth, over_bus.R_vehicle_from_sensor) < 5.0
