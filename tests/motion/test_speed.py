from __future__ import annotations

import math

import numpy as np
import pytest

from imucald.core.errors import EstimateError
from imucald.motion.speed import SpeedInterval, SpeedIntervalMaker

TICK = 0.1


def speed(t: np.ndarray) -> np.ndarray:
    """A drive whose derivative is known: v = 10 + 3 sin(0.8 t)."""
    return 10.0 + 3.0 * np.sin(0.8 * t)


def mean_accel(t0: float, t1: float) -> float:
    return float((speed(np.array(t1)) - speed(np.array(t0))) / (t1 - t0))


def intervals(
    speed_times: np.ndarray,
    delay_true: float = 0.0,
    delay_told: float = 0.0,
    block_s: float = 0.5,
    seconds: float = 30.0,
    bad: frozenset[int] = frozenset(),
    step: float = 0.0,
) -> list[SpeedInterval]:
    """Feed a drive whose accelerometer x is exactly dv/dt, tick means being exact as well."""
    maker = SpeedIntervalMaker(block_s, delay_told, 2.5)
    out = []
    values = speed(speed_times - delay_true)
    if step:
        values = np.round(values / step) * step
    pending = list(zip(speed_times.tolist(), values.tolist(), strict=True))
    for k in range(int(seconds / TICK)):
        t = (k + 1) * TICK
        while pending and pending[0][0] < t:
            maker.add_speed(*pending.pop(0))
        interval = maker.take_tick(t, mean_accel(t - TICK, t), 0.1 * k, 9.8, 0.2, k not in bad)
        if interval is not None:
            out.append(interval)
    return out


@pytest.mark.parametrize("interval", [0.05, 0.3, 1.0, 1.7])
def test_force_and_dvdt_cover_the_same_interval_at_any_speed_rate(interval: float) -> None:
    # Speed at odd times: the accelerometer's mean must match although ticks lie elsewhere.
    out = intervals(np.arange(0.03, 30.0, interval))
    assert len(out) > 10
    for b in out:
        assert b.dvdt == pytest.approx(mean_accel(b.t0, b.t1), abs=1e-9)
        assert b.fx == pytest.approx(b.dvdt, abs=0.02), "within what interpolation in a tick costs"
        assert b.t1 - b.t0 >= 0.5 - 0.05 - 1e-9
        assert b.fz == pytest.approx(9.8)
        assert b.yaw_rate == pytest.approx(0.2)


@pytest.mark.parametrize("delay", [-0.25, 0.4])
def test_a_configured_delay_brings_both_together(delay: float) -> None:
    times = np.arange(0.5, 30.0, 0.2)
    told = intervals(times, delay_true=delay, delay_told=delay)
    untold = intervals(times, delay_true=delay)
    assert len(told) > 40
    assert max(abs(b.fx - b.dvdt) for b in told[2:]) < 0.05
    assert max(abs(b.fx - b.dvdt) for b in untold[2:]) > 0.3


def test_a_coarse_speed_adds_noise_but_no_bias() -> None:
    out = intervals(np.arange(0.03, 300.0, 0.5), step=1 / 3.6, seconds=300.0)
    off = np.array([b.dvdt - b.fx for b in out])
    assert abs(off.mean()) < 0.02
    assert off.std() < 0.35


def test_without_speed_blocks_are_cut_by_time() -> None:
    out = intervals(np.array([]))
    assert len(out) == 59
    assert all(math.isnan(b.dvdt) and math.isnan(b.speed) for b in out)
    assert out[0].fx == pytest.approx(mean_accel(out[0].t0, out[0].t1), abs=1e-9)


def test_a_speed_that_falls_silent_becomes_unknown() -> None:
    out = intervals(np.arange(0.0, 10.0, 0.1))
    late = [b for b in out if b.t0 > 13.0]
    assert late
    assert all(math.isnan(b.dvdt) for b in late)
    assert not any(b.t1 - b.t0 > 3.0 for b in out)


def test_one_bad_tick_taints_its_block_and_no_other() -> None:
    out = intervals(np.arange(0.0, 30.0, 0.1), bad=frozenset({100}))
    tainted = [b for b in out if not b.clean]
    assert len(tainted) == 1
    assert tainted[0].t0 - TICK <= 10.0 <= tainted[0].t1


def test_nothing_is_differenced_across_a_restart() -> None:
    maker = SpeedIntervalMaker(0.5, 0.0, 2.5)
    for k in range(20):
        maker.add_speed(k * TICK, 5.0)
        maker.take_tick((k + 1) * TICK, 0.0, 0.0, 9.8, 0.0, True)
    maker.restart()
    for k in range(1000, 1030):
        maker.add_speed(k * TICK, 25.0)
        interval = maker.take_tick((k + 1) * TICK, 0.0, 0.0, 9.8, 0.0, True)
        assert interval is None or (interval.dvdt == 0.0 and interval.t0 >= 100.0)


def test_an_unknown_yaw_rate_makes_the_blocks_unknown() -> None:
    maker = SpeedIntervalMaker(0.5, 0.0, 2.5)
    out = [
        maker.take_tick((k + 1) * TICK, 0, 0, 9.8, math.nan if k == 7 else 0.1, True)
        for k in range(30)
    ]
    rates = [b.yaw_rate for b in out if b is not None]
    assert sum(math.isnan(r) for r in rates) == 1


def test_an_absurd_delay_is_refused() -> None:
    with pytest.raises(EstimateError):
        SpeedIntervalMaker(0.5, 5.0, 2.5)
