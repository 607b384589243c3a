"""Method C as the package has it against the text, formula by formula."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imucald.attitude.filter import AttitudeFilter
from imucald.attitude.interval import Interval
from imucald.attitude.kalman import NineStateFilter
from imucald.attitude.measurements import heading_difference, tilt
from imucald.attitude.propagation import Propagator
from imucald.attitude.right_forward_up import (
    vehicle_angles,
    vehicle_from_rfu,
)
from imucald.attitude.sensor_check import rest_errors
from imucald.config.attitude import FilterSettings
from imucald.core.rotations import levelling_rotation, times
from publications import method_c as text
from publications.on_the_van import NAME, beginning, rms_off, tilted
from publications.recordings import recording

G = text.G
UP = np.array([0.0, 0.0, G])
RNG = np.random.default_rng(2014)


def attitudes(count: int):
    """Pitch, roll, azimuth; +-90 deg of pitch and upside down among them."""
    for p, r in ((1.5533, 0.2), (-1.5533, -1.0), (0.0, 3.14), (0.3, -3.1), (0.0, 0.0)):
        yield p, r, float(RNG.uniform(0.0, 2.0 * math.pi))
    for _ in range(count):
        p, r, y = RNG.uniform([-1.5, -3.1, 0.0], [1.5, 3.1, 2.0 * math.pi])
        yield float(p), float(r), float(y)


def matrix(C: np.ndarray) -> tuple[float, ...]:
    return tuple(C.ravel().tolist())


def apart(a: float, b: float) -> float:
    return abs(math.remainder(a - b, 2.0 * math.pi))


def test_1_and_2_system_errors_at_rest() -> None:
    for _ in range(40):
        w, f = RNG.normal(0.01, 0.02, (50, 3)), RNG.normal(0.0, 0.3, (50, 3)) + UP
        bs, ds = text.system_errors(w, f)
        found = rest_errors(tuple(w.mean(axis=0)), tuple(f.mean(axis=0)), is_level=True)
        assert found[0] == pytest.approx(tuple(bs), abs=1e-12)
        assert found[1] == pytest.approx(tuple(ds), abs=1e-12)


def test_3_and_14_the_matrix_and_its_angles() -> None:
    for p, r, y in attitudes(200):
        C = text.attitude_matrix(p, r, y)
        roll, pitch, heading = vehicle_angles(matrix(C))
        pg, rg, yg = text.angles_of_matrix(C)
        assert apart(-pitch, pg) < 1e-9
        assert apart(roll, rg) < 1e-9
        assert apart(heading, yg) < 1e-9


def test_4_pitch_and_roll_at_the_start() -> None:
    for p, r, y in attitudes(40):
        f = text.attitude_matrix(p, r, y).T @ [0.0, 0.0, G]
        level = levelling_rotation(f)
        roll, pitch, _ = vehicle_angles(matrix(level))
        assert text.angles_of_force(f) == pytest.approx((-pitch, roll), abs=1e-9)


@pytest.mark.parametrize("dt", [0.02, 0.05, 0.1])
def test_5_to_7_the_matrix_carried_along(dt: float) -> None:
    """A rate that is constant in each period, as the text has it."""
    w = RNG.normal(0.0, 1.0, 3)
    ours, C = Propagator(0.5, (0.0, 0.0, 0.0)), np.eye(3)
    ours.gyro(0.0, tuple(w), (0.0, 0.0, 0.0))
    for k in range(1, 400):
        ours.gyro(dt * k, tuple(w), (0.0, 0.0, 0.0))
        C = text.propagated(C, w, dt)
    assert np.array(ours.C).reshape(3, 3) == pytest.approx(C, abs=1e-11)


def interval_of(gravity: tuple[float, float, float]) -> Interval:
    nothing = (0.0, 0.0, 0.0)
    return Interval(gravity, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, nothing, nothing, 0.0, 0.1, 0.1)


def test_13_and_18_measurements_to_first_order() -> None:
    """Errors of a third of a degree at leans up to 17 deg: z and H x agree to the second order.

    The package writes the differences about level axes, where pitch +-90 deg is no special place;
    the text's differ by the lean's cosine, which is what the bounds are.
    """
    filter_ = text.Filter(np.eye(3), 0.0, 0.0, 0.0, 0.01, 0.02)
    for _ in range(200):
        p, r, y = RNG.uniform([-0.3, -0.3, 0.0], [0.3, 0.3, 2.0 * math.pi])
        true = text.attitude_matrix(p, r, y)
        error, d = RNG.normal(0.0, 0.005, 3), RNG.normal(0.0, 0.03, 3)
        C = text.expm(text.skew(-error)) @ true
        force = true.T @ [0.0, 0.0, G] + d
        filter_.C = C
        z, H, _ = filter_.measurement(force, y)
        seen = times(matrix(C), tuple(force))
        ours = [*tilt(interval_of(seen), seen, matrix(C), (0.0, 0.0, 0.0), 0.0),
                heading_difference(y, matrix(C), 0.02)]  # fmt: skip
        x = np.concatenate([error, np.zeros(3), d])
        lean = max(abs(p), abs(r))
        for i, (h, ours_z, _, _) in enumerate(ours):
            sign = -1.0 if i == 2 else 1.0  # the text's azimuth is taken the other way about
            bound = 2e-4 + 0.06 * lean * (abs(error).max() + abs(d).max() / G) * 6.0
            assert abs(sign * ours_z - z[i]) < bound + (lean * 0.01 if i == 2 else 0.0)
            assert abs(float(h @ x) - ours_z) < bound + (lean * 0.01 if i == 2 else 0.0)
            assert abs(float(H[i] @ x) - z[i]) < 5e-4


def test_19_and_20_time_and_measurement_update() -> None:
    """Numbers one by one against all at once with an inverse."""
    for run in range(30):
        ours = NineStateFilter(FilterSettings(gate=1e9))
        ours.start(0.1, 0.5, 0.01)
        P, b, d = ours.P.copy(), np.zeros(3), np.zeros(3)
        C = text.attitude_matrix(0.2, -0.4, 0.1 * run)
        s = ours.settings
        for _ in range(20):
            dt = float(RNG.uniform(0.1, 1.0))
            ours.predict(matrix(C), dt, 0.0)
            F = text.transition(C, dt)
            keep = math.exp(-dt / s.accel_random_time)
            F[6:9, 6:9] *= keep
            P = F @ P @ F.T
            P += np.diag([s.gyro_noise[0] ** 2 * dt] * 3
                         + [2.0 * s.gyro_random[0] ** 2 * dt / s.gyro_random_time] * 3
                         + [ours.accel_random[0] ** 2 * (1.0 - keep**2)] * 3)  # fmt: skip
            d *= keep
            H, z = RNG.normal(0.0, 1.0, (3, 9)), RNG.normal(0.0, 0.1, 3)
            R = np.diag(RNG.uniform(1e-4, 1e-2, 3))
            error = ours.update([(h, float(v), float(n), False)
                                 for h, v, n in zip(H, z, np.diag(R), strict=True)])  # fmt: skip
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x = K @ z
            P = (np.eye(9) - K @ H) @ P
            b, d = b + x[3:6], d + x[6:9]
            assert error == pytest.approx(tuple(x[0:3]), abs=1e-9)
            assert np.linalg.norm(ours.P - P) < 1e-9 * np.linalg.norm(P)
        assert ours.bias == pytest.approx(tuple(b), abs=1e-9)
        assert ours.accel_error == pytest.approx(tuple(d), abs=1e-9)


def test_c1_the_check_repeats_on_command() -> None:
    """Before step 101: once at first use, "or by hand when needed"."""
    attitude = AttitudeFilter()
    t = 0.0

    def stand(seconds: float, error: float) -> None:
        nonlocal t
        for _ in range(round(seconds * 20.0)):
            t += 0.05
            attitude.speed(t, 0.0)
            attitude.gyro(t, RNG.normal(error, 1e-4, 3).tolist())
            attitude.accel(t, (RNG.normal(0.0, 0.01, 3) + UP).tolist())

    stand(60.0, 0.004)
    assert attitude.checked
    found = vehicle_from_rfu(*attitude.constant_bias)
    assert found == pytest.approx((0.004,) * 3, abs=2e-5)
    attitude.check_again()
    assert not attitude.checked
    stand(60.0, 0.006)
    assert attitude.checked
    found = vehicle_from_rfu(*attitude.constant_bias)
    assert found == pytest.approx((0.006,) * 3, abs=1e-4)


def test_c2_noise_is_that_of_each_axis() -> None:
    """(11): the data sheet gives the dynamic noise of each axis."""
    noise = (1e-4, 2e-4, 4e-4)
    ours = NineStateFilter(
        FilterSettings(gyro_noise_deg_s=tuple(math.degrees(n) for n in noise), gyro_scale=0.0)
    )
    ours.start(0.0, 0.0, 0.0)
    C = text.attitude_matrix(0.3, 0.4, 1.0)
    ours.predict(matrix(C), 0.5, 0.0)
    right, forward, up = noise[1], noise[0], noise[2]  # the keys are of vehicle axes
    expected = C @ np.diag(np.square([right, forward, up]) * 0.5) @ C.T
    assert ours.P[0:3, 0:3] == pytest.approx(expected, abs=1e-15)


@pytest.mark.slow
def test_kingston_the_literal_filter_is_good_and_ours_is_better() -> None:
    """C on B's corrected samples, each sample a period; errors against the INS after a minute.

    Of an hour the first 15 minutes: a matrix exponential a sample takes a minute for all.
    """
    roll, pitch = rms_off(*tilted(beginning(recording(NAME), 900.0), with_filter=True))
    assert roll < 0.3  # ours 0.08 and 0.10, see benchmarks.attitude
    assert pitch < 0.4
