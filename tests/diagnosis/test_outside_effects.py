"""Effects that the judge puts into measured logs: each has its date, and leaves a log readable."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.diagnosis.outside_effects import NOT_RUN, OUTSIDE
from benchmarks.diagnosis.outside_effects.history import BATCHES, FIRST_DRAW

from imucald.core.samples import Series


def city_drive() -> dict[str, Series]:
    """20 min at 10 Hz: bends, and a stop of 10 s every two minutes."""
    rng = np.random.default_rng(5)
    t = np.arange(0.0, 1200.0, 0.1)
    v = np.clip(12.0 - 20.0 * np.cos(2.0 * np.pi * t / 120.0), 0.0, 25.0)
    turn = 0.2 * np.sin(2.0 * np.pi * t / 37.0) * (v > 1.0)
    accel = np.column_stack([np.gradient(v, t), turn * v, np.full(len(t), 9.81)])
    accel += 0.3 * rng.standard_normal(accel.shape)
    gyro = np.column_stack([0.0 * t, 0.0 * t, turn]) + 0.01 * rng.standard_normal(accel.shape)
    return {"accel": Series(t, accel), "gyro": Series(t, gyro), "speed": Series(t[::5], v[::5])}


def test_every_effect_stands_once_in_the_history_in_the_order_of_writing():
    assert [name for batch in BATCHES for name in batch.effects] == list(OUTSIDE)
    assert [b.written for b in BATCHES] == sorted(b.written for b in BATCHES)


def test_what_was_not_run_waits_for_a_later_draw_than_all_that_was():
    ran = [draw for name, draw in FIRST_DRAW.items() if name not in NOT_RUN and draw is not None]
    assert min(FIRST_DRAW[name] or 0 for name in NOT_RUN) > max(ran)


@pytest.mark.parametrize("effect", OUTSIDE)
def test_an_effect_changes_its_log_and_leaves_it_readable(effect):
    put, size, needs = OUTSIDE[effect]
    whole, changed = city_drive(), city_drive()
    put(changed, size, np.random.default_rng(3), np.eye(3))
    assert needs in whole
    assert any(
        not np.array_equal(changed[n].t, s.t) or not np.array_equal(changed[n].values, s.values)
        for n, s in whole.items()
    )
    for name, series in changed.items():
        assert series.values.shape == whole[name].values.shape
        assert np.all(np.diff(series.t) > 0.0)
        assert np.all(np.isfinite(series.values))
