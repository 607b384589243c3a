"""The live accumulator and the column path must give the same bits, whatever the samples."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucald.core.samples import QUANTITIES, Series
from imucald.motion.column_ticks import TickAccumulator, ticks_from_samples
from imucald.motion.ticks import ACCEL, COLUMNS, tick_index

VALUE = st.floats(-1e6, 1e6, allow_nan=False) | st.sampled_from([0.0, -0.0, 1 / 3, 9.80665])
TIME = st.floats(0.0, 1.2, allow_nan=False) | st.integers(0, 12).map(lambda k: k / 10.0)


@st.composite
def channels(draw: st.DrawFn) -> dict[str, Series]:
    """Some channels with some samples, in time order, ties and empty ticks included."""
    out = {}
    for name in draw(st.sets(st.sampled_from(sorted(QUANTITIES)), max_size=5)):
        times = sorted(draw(st.lists(TIME, min_size=1, max_size=20)))
        width = QUANTITIES[name].width
        rows = draw(
            st.lists(
                st.lists(VALUE, min_size=width, max_size=width),
                min_size=len(times),
                max_size=len(times),
            )
        )
        values = np.array(rows)
        out[name] = Series(np.array(times), values[:, 0] if width == 1 else values)
    return out


def accumulated(samples: dict[str, Series], bad: dict[str, np.ndarray], n: int) -> np.ndarray:
    """Feed sample by sample, each channel in its own order, tick by tick."""
    rows = []
    accumulator = TickAccumulator()
    for k in range(n):
        for name, series in samples.items():
            for t, value in zip(series.t.tolist(), series.values.tolist(), strict=True):
                if tick_index(t) == k:
                    accumulator.add_sample(name, t, value if isinstance(value, list) else [value])
        for name, times in bad.items():
            for t in times.tolist():
                if tick_index(t) == k:
                    accumulator.reject(name)
        rows.append(accumulator.close(k))
    return np.array(rows)


def bits(rows: np.ndarray) -> list[bytes]:
    """Doubles as bytes, every NaN alike; in minima and maxima also both zeros, which are equal."""
    row = rows.copy()
    row[:, ACCEL.min_x : ACCEL.age] += 0.0
    return [b"nan" if x != x else struct.pack("<d", x) for x in row.ravel().tolist()]  # noqa: PLR0124


@pytest.mark.slow
@settings(max_examples=80, deadline=None)
@given(channels(), st.lists(TIME, max_size=5))
def test_columns_give_the_bits_of_single_samples(
    samples: dict[str, Series], bad_times: list[float]
) -> None:
    bad = {name: np.array(sorted(bad_times)) for name in ("accel", "gyro", "speed")}
    live = accumulated(samples, bad, 13)
    columns = ticks_from_samples(samples, 0, 13, bad)
    assert columns.shape == (13, COLUMNS)
    assert bits(columns) == bits(live)


@pytest.mark.slow
@settings(max_examples=40, deadline=None)
@given(channels(), st.integers(0, 12))
def test_cutting_the_columns_elsewhere_changes_nothing(
    samples: dict[str, Series], cut: int
) -> None:
    whole = ticks_from_samples(samples, 0, 13)
    parts = np.vstack([ticks_from_samples(samples, 0, cut), ticks_from_samples(samples, cut, 13)])
    assert bits(parts) == bits(whole)
