"""Stuck and clipped samples of a whole recording, by the judges of `sample_health`."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.motion import recorded_health as recorded
from imucald.motion.hops import hop_rows
from imucald.motion.recorded_health import RecordedHealth, recorded_health

HZ, SECONDS = 100.0, 120.0
T = np.arange(0.0, SECONDS, 1.0 / HZ)


def sensor(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    slow = np.cumsum(rng.standard_normal((len(T), 3)), axis=0) * 0.01
    noisy = slow - slow.mean(axis=0) + 0.2 * rng.standard_normal(slow.shape)
    return np.asarray(np.round(noisy / 0.01) * 0.01)


def judged(values: np.ndarray, chance: float = 0.01) -> RecordedHealth:
    speed = np.array([0.0, SECONDS]), np.array([10.0, 10.0])
    return recorded_health("accel", T, values, speed, chance)


def test_a_sound_sensor_has_no_fault() -> None:
    found = judged(sensor())
    assert not found.stuck.any()
    assert not found.on_rail.any()
    assert found.ends == ()


def test_a_stuck_run_is_marked_from_its_first_sample_to_its_last() -> None:
    values = sensor()
    values[5013:5400] = values[5013]
    values[5012, 0], values[5400, 0] = values[5013, 0] + [0.3, -0.3]
    assert np.flatnonzero(judged(values).stuck).tolist() == list(range(5013, 5400))


@pytest.mark.parametrize(("chance", "is_stuck"), [(0.01, True), (1e-300, False)])
def test_the_chance_of_a_false_finding_decides_how_long_a_run_must_be(
    chance: float, is_stuck: bool
) -> None:
    values = np.repeat(sensor()[::3], 3, axis=0)  # each value is sent three times
    values[5013:5213] = values[5013]
    assert judged(values, chance).stuck.any() == is_stuck


def test_a_pause_of_weeks_costs_nothing_and_hides_nothing() -> None:
    values = sensor()
    values[:, 1] = np.minimum(values[:, 1], 0.3)
    t, rows = T.copy(), hop_rows
    t[6000:] += 14 * 86_400.0
    speed = np.array([0.0, t[-1]]), np.array([10.0, 10.0])
    hops: list[int] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recorded, "hop_rows", lambda *given: (hops.append(given[2]), rows(*given))[1])
        found = recorded_health("accel", t, values, speed, 0.01)
    assert max(hops) == 2 * SECONDS
    assert (found.on_rail == judged(values).on_rail).all()
    assert found.ends == (0.3,)


def test_equal_spikes_are_no_end_of_a_range() -> None:
    values = sensor()
    values[::500, 0] = 40.0
    assert judged(values).ends == ()


@pytest.mark.parametrize("share", [0.03, 0.4])
def test_all_samples_at_an_end_are_marked_also_those_before_the_end_was_known(share: float) -> None:
    values = sensor()
    rail = round(float(np.quantile(values[:, 1], 1.0 - share)) / 0.01) * 0.01
    values[:, 1] = np.minimum(values[:, 1], rail)
    found = judged(values)
    assert found.ends == (rail,)
    assert (found.on_rail == (values[:, 1] == rail)).all()
