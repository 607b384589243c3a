"""Each stage alone: single frames and columns in any chunks give the same bits.

Frames carry any channels together, times stand still and leave holes, the mount comes and goes.
"""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucald.core.samples import QUANTITIES, Series
from imucald.model_compensation import ModelCompensation, compensation_from_model
from imucald.model_compensation.lever_arm_and_suspension import Corrected, VehicleCorrection
from imucald.model_compensation.sensors import SensorCorrection
from imucald.model_compensation.terms import ScalarTerms
from model_compensation.models import random_terms

SENSED = ("accel", "gyro", "mag", "speed", "wheel_speeds", "yaw_rate", "temperature")
SIZES = {"accel": 20.0, "gyro": 1.0, "mag": 5e-5, "speed": 40.0, "wheel_speeds": 40.0}
SIZES |= {"yaw_rate": 1.0, "temperature": 80.0}
TRIADS = ("gyro", "parallel/second", "mag", "accel")


def random_compensation(rng: random.Random) -> ModelCompensation:
    found = compensation_from_model(random_terms(rng))
    scalars = dict(found.terms.scalars)
    if rng.random() < 0.5:
        scalars["yaw_rate"] = ScalarTerms(0.1, 0.05, (0.5, 0.7))
    return replace(found, terms=replace(found.terms, scalars=scalars))


def random_times(rng: random.Random, n: int) -> list[float]:
    t, out = 0.0, []
    for _ in range(n):
        t += rng.choice([0.0, 0.0, 0.003, 0.01, 0.01, 0.02, 0.1, 0.24, 0.26, 0.3, 0.6])
        out.append(t)
    return out


def chunks(rng: random.Random, n: int):
    start = 0
    while start < n:
        stop = min(start + rng.choice([1, 2, 5, 30, n]), n)
        yield start, stop
        start = stop


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_the_sensors_stage(seed):
    rng = random.Random(seed)
    compensation = random_compensation(rng)
    derived = rng.random() < 0.5
    single, other = compensation.sensor_correction(derived), compensation.sensor_correction(derived)
    times = random_times(rng, rng.choice([2, 30, 80]))
    frames = []
    last: dict[str, tuple[float, ...]] = {}
    for t in times:
        channels = rng.sample(SENSED, rng.choice([1, 1, 2, 4]))
        if derived:  # the wheels give the speed: one with each
            channels = [c for c in channels if c != "speed"]
            channels += ["speed"] if "wheel_speeds" in channels else []
        samples = []
        for channel in channels:
            size = SIZES[channel] * rng.choice([1.0, 1.0, 1.0, 30.0])
            width = QUANTITIES[channel].width
            values = tuple(rng.uniform(-size, size) for _ in range(width))
            if channel in last and rng.random() < 0.3:  # stuck
                values = last[channel]
            last[channel] = values
            samples.append((channel, values))
        frames.append((t, samples))
    expected = [by_frame(single, t, samples) for t, samples in frames]
    got = []
    for start, stop in chunks(rng, len(frames)):
        if rng.random() < 0.3:
            got += [by_frame(other, t, samples) for t, samples in frames[start:stop]]
        else:
            got += by_columns(other, frames[start:stop])
    assert got == expected


def by_frame(stage: SensorCorrection, t, samples):
    out, refused = stage.frame(t, list(samples))
    values = {channel: tuple(v) for channel, v in out}
    return {c: values.get(c) for c, _ in samples if c in values or c in refused}


def by_columns(stage: SensorCorrection, frames):
    series, rows = {}, {}
    for row, (t, samples) in enumerate(frames):
        for channel, values in samples:
            series.setdefault(channel, []).append((t, values))
            rows.setdefault(channel, []).append(row)
    columns = {}
    for channel, found in series.items():
        values = np.array([v for _, v in found])
        if QUANTITIES[channel].width == 1:
            values = values[:, 0]
        columns[channel] = Series(np.array([t for t, _ in found]), values)
    order = {channel: np.array(found) for channel, found in rows.items()}
    taken = stage.columns(columns, order)
    out = [{} for _ in frames]
    for channel, whole in columns.items():
        one = taken.get(channel)
        values = whole.values if one is None else one.values
        values = values if values.ndim == 2 else values[:, None]
        for i, row in enumerate(rows[channel]):
            refused = one is not None and one.refused[i]
            out[row][channel] = None if refused else tuple(values[i].tolist())
    # in the order of the frame's samples
    return [{c: out[row][c] for c, _ in samples} for row, (_, samples) in enumerate(frames)]


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@given(seed=st.integers(0, 2**32))
def test_the_vehicles_stage(seed):
    rng = random.Random(seed)
    compensation = random_compensation(rng)
    suspension = replace(compensation, suspension=rng.random() < 0.8)
    made = [suspension.vehicle_correction(TRIADS, ("gyro", "parallel/second")) for _ in range(2)]
    times = random_times(rng, rng.choice([2, 30, 100]))
    known, frames = True, []
    for t in times:
        if rng.random() < 0.05:
            known = not known
        turned = {}
        for channel in rng.sample(TRIADS, rng.choice([1, 1, 2, 4])):
            size = 1.0 if channel == "gyro" else 6.0
            v = tuple(rng.uniform(-size, size) for _ in range(3))
            turned[channel] = v if known else None
        frames.append((t, turned))
    expected = [made[0].frame(t, dict(turned)) for t, turned in frames]
    got = []
    for start, stop in chunks(rng, len(frames)):
        if rng.random() < 0.3:
            got += [made[1].frame(t, dict(turned)) for t, turned in frames[start:stop]]
        else:
            got += vehicle_columns(made[1], frames[start:stop])
    assert got == expected


def vehicle_columns(stage: VehicleCorrection, frames):
    columns = {}
    for channel in TRIADS:
        found = [(row, t, turned[channel]) for row, (t, turned) in enumerate(frames)
                 if channel in turned]  # fmt: skip
        if found:
            values = np.array([v or (np.nan,) * 3 for _, _, v in found])
            rows = np.array([row for row, _, _ in found])
            columns[channel] = Corrected(rows, np.array([t for _, t, _ in found]), values)
    out = [{} for _ in frames]
    for channel, values in stage.columns(columns).items():
        for row, v in zip(columns[channel].order.tolist(), values.tolist(), strict=True):
            out[row][channel] = None if np.isnan(v[0]) else tuple(v)
    return out
