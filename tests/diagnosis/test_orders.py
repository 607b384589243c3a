"""A speed that swings as a wheel turns, put into simulated drives by a formula of this file."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from table_rows import left

from imucald.core.samples import Series
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.chance import beyond_chance
from imucald.diagnosis.left_over.orders import RUN_OUT
from imucald.diagnosis.left_over.remains import residuals_of
from imucald.diagnosis.result import Kind
from imucald.diagnosis.signals import drive_of
from imucald.simulation import random_model, simulate

SEED, MINUTES = 7, 8.0


@cache
def drive():
    model = random_model(SEED)
    made = simulate(model, SEED, MINUTES)
    return model, dict(made.samples)


def found(period_s: float, swing=None):
    """swing: (t, way) -> share of the speed that is shown too much."""
    model, samples = drive()
    own = samples["speed"]
    t = np.arange(own.t[0], own.t[-1], 0.005)
    v = np.interp(t, own.t, own.values)
    way = np.cumsum(v) * 0.005
    shown = v if swing is None else v * (1.0 + swing(t, way))
    at = np.arange(own.t[0], own.t[-1], period_s)
    noise = 0.02 * np.random.default_rng(1).standard_normal(len(at))
    samples = samples | {"speed": Series(at, np.interp(at, t, shown) + noise * (v.max() > 0.0))}
    residuals = residuals_of(Forward(drive_of(samples), model, 300), {})
    return beyond_chance(left(Kind.TURNS_WITH_WHEEL, SimpleNamespace(drives=[residuals])))


def turning(metres, size=0.02):
    return lambda _, way: size * np.sin(2.0 * np.pi * way / metres)


def in_time(t, _):
    return 0.02 * np.sin(2.0 * np.pi * 1.3 * t)


@pytest.mark.parametrize("period_s", [0.1, 0.5, 1.0])
@pytest.mark.parametrize("round_m", [1.7, 2.1])
def test_what_goes_round_with_a_wheel_is_found_however_seldom_it_is_sampled(period_s, round_m):
    (one,) = found(period_s, turning(round_m))
    assert one.kind == Kind.TURNS_WITH_WHEEL
    assert f"once per {round_m:.1f}" in one.text
    # Between samples a second apart the way is known less well, and part of a swing is lost.
    least = 0.3 if period_s == 1.0 else 0.6
    assert least < one.size * RUN_OUT / 0.02 < 1.4


def test_an_oval_wheel_swings_twice_a_turn():
    (one,) = found(0.5, turning(0.95))
    assert "twice per 1.9" in one.text


@pytest.mark.parametrize(
    "swing",
    [
        None,
        turning(5.0),
        in_time,
        turning(1.9, 0.002),
    ],
    ids=["sound", "slabs of concrete", "in time", "less than a sound wheel"],
)
def test_what_does_not_go_round_with_a_wheel_is_not_called_so(swing):
    assert found(0.5, swing) == []
