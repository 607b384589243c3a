"""z and H of the nine-state filter: the text's differences, and derivatives taken by numbers."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imucald.attitude.interval import Interval
from imucald.attitude.measurements import heading_difference, rest_rates, rounding, tilt
from imucald.attitude.right_forward_up import vehicle_angles

G = 9.80665
SMALL = st.floats(-0.003, 0.003)
ANGLES = st.tuples(st.floats(-0.4, 0.4), st.floats(-0.4, 0.4), st.floats(0.0, 6.28))


def interval(**changes):
    values = {
        "up": (0.0, 0.0, G), "t0": 0.0, "t1": 1.0, "speed": 10.0, "forward_acceleration": 0.0,
        "force_variance": 0.0, "n": 50.0, "rate": (0.0, 0.0, 0.0),
        "rate_variance": (0.0, 0.0, 0.0), "angle": 0.0, "sigma_forward": 0.1, "sigma_lateral": 0.2,
    }  # fmt: skip
    return Interval(**{**values, **changes})


def matrix(roll, pitch, heading):
    """C_nav_from_body, axes right, forward, up: ISO 8855 roll and pitch, heading from north."""
    return Rotation.from_euler("ZXY", [-heading, -pitch, roll]).as_matrix()


def rows(roll, pitch, heading):
    return tuple(matrix(roll, pitch, heading).ravel().tolist())


@given(ANGLES, st.tuples(SMALL, SMALL, SMALL))
def test_z_is_propagated_less_accelerometer(angles, error):
    """Pitch (nose up) and roll (right side down) as the text takes them, for small errors."""
    roll, pitch, heading = angles
    true = matrix(roll, pitch, heading)
    estimated = Rotation.from_rotvec(error).as_matrix().T @ true
    force = true.T @ [0.0, 0.0, G]  # in body axes: x right, y forward, z up
    by_accel = (
        math.atan2(force[1], math.hypot(force[0], force[2])), math.atan2(-force[0], force[2])
    )  # fmt: skip
    C = tuple(estimated.ravel().tolist())
    mine = vehicle_angles(C)
    (_, z_pitch, *_), (_, z_roll, *_) = tilt(
        interval(), tuple(estimated @ force), C, (0.0, 0.0, 0.0), 0.0
    )
    assert z_pitch == pytest.approx(-mine[1] - by_accel[0], abs=1e-4)
    # about the level forward axis: less than the Z-Y-X roll by the cosine of the pitch
    assert z_roll == pytest.approx((mine[0] - by_accel[1]) * math.cos(pitch), abs=1e-4)


@given(ANGLES, st.tuples(SMALL, SMALL, SMALL), st.tuples(SMALL, SMALL, SMALL))
def test_h_is_the_derivative_of_z(angles, error, bias):
    """Attitude errors, and accelerometer errors in body axes, from the geometry."""
    true = matrix(*angles)
    estimated = Rotation.from_rotvec(error).as_matrix().T @ true
    accel_error = 10.0 * np.array(bias)
    force = true.T @ [0.0, 0.0, G] + accel_error
    C = tuple(estimated.ravel().tolist())
    for h, z, _, _ in tilt(interval(), tuple(estimated @ force), C, (0.0, 0.0, 0.0), 0.0):
        x = np.concatenate([error, np.zeros(3), accel_error])
        assert z == pytest.approx(float(h @ x), abs=2e-4)


def test_a_late_interval_shows_the_gyroscopes_error():
    C = rows(0.0, 0.0, 0.0)
    (h, *_), _ = tilt(interval(), (0.0, 0.0, G), C, (0.0, 0.0, 0.0), 0.7)
    # the error now is that of the middle less what the zero error has turned since
    assert h[3:6] == pytest.approx([-0.7, 0.0, 0.0])


def test_noise_is_that_of_the_interval():
    C = rows(0.0, 0.0, 1.0)
    pitch, roll = tilt(interval(), (0.0, 0.0, G), C, (0.0, 0.0, 0.0), 0.0)
    assert (pitch[2], roll[2]) == pytest.approx(((0.1 / G) ** 2, (0.2 / G) ** 2))


def test_falling_shows_nothing():
    C = rows(0.0, 0.0, 0.0)
    assert tilt(interval(), (0.1, 0.0, 0.2), C, (0.0, 0.0, 0.0), 0.0) == []


def test_rates_at_rest_are_the_error():
    rest = interval(rate=(0.01, 0.02, 0.03))
    found = rest_rates(rest, (0.0, 0.02, 0.0), (1e-4,) * 3, (1e-4,) * 3)
    assert [z for _, z, _, _ in found] == pytest.approx([0.01, 0.0, 0.03])
    assert [int(np.flatnonzero(h)[0]) for h, *_ in found] == [3, 4, 5]


def test_no_number_of_rests_shows_an_error_finer_than_the_signal_is_rounded():
    step = 0.004
    rest = interval(rate=(0.01, 0.02, 0.03))
    known = [1e-3] * 3
    for _ in range(200):
        for h, _, variance, _ in rest_rates(rest, (0.0,) * 3, (1e-6,) * 3, tuple(known), step):
            i = int(np.flatnonzero(h)[0]) - 3
            known[i] = known[i] * variance / (known[i] + variance)
    assert known == pytest.approx([step**2 / 12.0] * 3, rel=0.02)


@pytest.mark.parametrize("kind", ["noise", "tone"])
@pytest.mark.parametrize("noise", [0.0, 0.1, 0.2, 0.3, 0.43, 0.6, 1.0])
def test_means_of_rounded_numbers_are_off_by_what_is_stated(noise, kind):
    """True values anywhere between two steps; the steps are one."""
    rng = np.random.default_rng(3)
    true = rng.uniform(0.0, 1.0, 2000)
    shaken = rng.normal(0.0, noise, (2000, 400))
    if kind == "tone":
        shaken = math.sqrt(2.0) * noise * np.sin(rng.uniform(0.0, 2.0 * math.pi, (2000, 400)))
    shown = np.round(true[:, None] + shaken)
    errors = shown.mean(axis=1) - true
    stated = np.mean([rounding((v, v, v), 1.0) for v in shown.var(axis=1)]) + noise**2 / 400.0
    assert np.mean(errors**2) < 1.3 * stated + 1e-4
    if noise == 0.0:
        assert np.mean(errors**2) == pytest.approx(stated, rel=0.1)


def test_the_quietest_axis_decides_and_no_step_rounds_nothing():
    assert rounding((1.0, 0.0, 1.0), 0.1) == pytest.approx(0.01 / 12.0)
    assert rounding((0.0, 0.0, 0.0), 0.0) == 0.0


@given(st.floats(0.0, 6.28), st.floats(-0.5, 0.5))
def test_a_heading_is_compared_the_short_way_round(heading, error):
    C = rows(0.1, -0.1, heading)
    h, z, variance, gated = heading_difference(heading + error + 4 * math.pi, C, 0.1)
    assert z == pytest.approx(error, abs=1e-9)
    assert h[2] == -1.0
    assert variance == pytest.approx(0.01)
    assert not gated
