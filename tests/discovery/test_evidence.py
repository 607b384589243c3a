"""Relations between signals are believed as often as chance allows, and units follow from gains."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.config_check.motion import smooth
from imucald.config_check.relation import believed_z, relation
from imucald.discovery.evidence import choose_unit


def slow_noise(rng: np.random.Generator, ticks: int = 3000) -> np.ndarray:
    """Noise that remembers itself for 0.1 to 20 s, smoothed as signals are."""
    keep = np.exp(-1.0 / 10.0 ** rng.uniform(0.0, 2.3))
    x = np.zeros(ticks)
    for i, e in enumerate(rng.standard_normal(ticks - 1), 1):
        x[i] = keep * x[i - 1] + e
    return smooth(x)


def test_signals_that_have_nothing_in_common_are_hardly_ever_believed():
    rng = np.random.default_rng(1)
    found = [relation(slow_noise(rng), slow_noise(rng)).z for _ in range(200)]
    assert np.mean(np.array(found) > 1.96) < 0.12  # 5 % by chance, three deviations of 200 above it
    assert max(found) < believed_z(1000)


def test_a_signal_that_is_a_multiple_of_another_in_noise_is_believed_with_its_gain_and_sign():
    rng = np.random.default_rng(2)
    a, noise = slow_noise(rng), slow_noise(rng)
    found = relation(a, -3.0 * a + 0.5 * noise * np.nanstd(a) / np.nanstd(noise))
    assert found.is_believed
    assert found.sign == -1
    assert found.low == pytest.approx(3.0, rel=0.1)
    assert found.low <= found.gain <= found.high


def test_holes_are_left_out_of_a_comparison():
    rng = np.random.default_rng(3)
    a = slow_noise(rng)
    b = 2.0 * a
    b[500:1500] = np.nan
    assert relation(a, b).correlation == pytest.approx(1.0)
    assert relation(a, np.full(len(a), np.nan)).z == 0.0


@pytest.mark.parametrize(
    ("stated", "size", "name", "sure"),
    [
        ("km/h", 1 / 3.6, "km/h", True),
        ("", 1 / 3.6, "km/h", True),
        ("", 0.447, "mph", False),  # a knot is as likely
        ("m/s", 1 / 3.6, "km/h", True),  # the database is wrong
        ("", 30.0, None, False),
    ],
)
def test_the_unit_is_the_one_that_the_gain_fits(stated, size, name, sure):
    unit = choose_unit(stated, "speed", size / 1.2, size * 1.2)
    assert (unit.name if unit else None) == name
    assert bool(unit and unit.is_sure) == sure
