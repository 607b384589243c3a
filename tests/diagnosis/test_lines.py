"""Lines in spectra of noise that this file makes."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.diagnosis.fit.chance import beyond_chance
from imucald.diagnosis.left_over.adequacy import _of_line

SEGMENTS, ROWS = 40, 300
HZ = np.fft.rfftfreq(ROWS, 0.1)
ASKED = np.flatnonzero((HZ > 0.25) & (HZ < 4.5))
WINDOW = np.hanning(ROWS) * np.sqrt(2.0 / (0.375 * ROWS**2))


def found(seed=0, amplitude=0.0, hz=2.3, shape=None, segments=SEGMENTS):
    """Noise of 0.2 m/s^2 rms, with a swing in so many segments."""
    rng = np.random.default_rng(seed)
    y = rng.standard_normal((SEGMENTS, ROWS))
    if shape is not None:
        y = np.fft.irfft(np.fft.rfft(y, axis=1) * shape(HZ), ROWS, axis=1)
    y *= 0.2 / y.std()
    phase = rng.uniform(0.0, 6.3, (SEGMENTS, 1))
    swing = amplitude * np.sin(2.0 * np.pi * hz * 0.1 * np.arange(ROWS) + phase)
    y[:segments] += swing[:segments]
    z = np.fft.rfft(y * WINDOW, axis=1)
    return beyond_chance([_of_line("accel_y", z, HZ, ASKED, 0.06)])


def test_a_swing_at_one_frequency_is_a_line_there():
    (one,) = found(amplitude=0.15)
    assert one.signal == "accel_y"
    assert "at 2.30 Hz" in one.text
    size = float(one.text.split("amplitude of ")[1].split()[0])
    assert size == pytest.approx(0.15, rel=0.15)


def body(hz):
    """A mass on a spring, damped by 0.2 of critical."""
    x = hz / 1.3
    return 1.0 / np.sqrt((1.0 - x**2) ** 2 + (0.4 * x) ** 2)


@pytest.mark.parametrize("shape", [None, body, lambda hz: 1.0 / (0.1 + hz) ** 2])
def test_noise_a_body_on_springs_and_a_road_have_no_line(shape):
    assert [found(seed, shape=shape) for seed in range(20)] == [[]] * 20


def test_a_swing_smaller_than_a_correct_zero_is_not_reported():
    assert found(amplitude=0.05) == []


def test_two_segments_of_forty_do_not_decide():
    assert found(amplitude=3.0, segments=2) == []
