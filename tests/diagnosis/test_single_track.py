"""The yaw rate behind the steering, beside the same vehicle integrated in time."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hidden import Effect, hidden_drive
from imucald.core.samples import GRAVITY
from imucald.diagnosis.diagnose import diagnose
from imucald.diagnosis.fit.intervals import estimate
from imucald.diagnosis.fit.score import Hypothesis
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import drive_of
from imucald.drive.single_track import (
    followed_angle,
    load_transfer,
    sideways,
    single_track,
    slip_delay,
)
from imucald.model.model import model_from_mapping
from imucald.model.vehicle import Chassis
from imucald.simulation import random_model, simulate

SIGMA_M, RACK_S, HZ, ANGLE = 0.4, 0.03, 0.7, 0.02
T = np.arange(0.0, 30.0, 0.1)
SETTLED = slice(100, 250)


def integrated(c: Chassis, v: float) -> np.ndarray:
    """(2, N) sideways speed of the centre of gravity and yaw rate, under a sine at the wheel: tyres
    that build up their force, a gear that lags."""
    a, b, m, rear = c.cg_to_front_m, c.cg_to_rear_m, c.mass_kg, c.rear_cornering_stiffness_npr
    front = b / (c.understeer_gradient * c.wheelbase_m / m + a / rear)

    def rates(t, x):
        v_y, r, force_f, force_r, angle = x
        hands = ANGLE * np.sin(2.0 * np.pi * HZ * t)
        return [
            (force_f + force_r) / m - v * r,
            (a * force_f - b * force_r) / c.yaw_inertia_kgm2,
            (front * (angle - (v_y + a * r) / v) - force_f) * v / SIGMA_M,
            (rear * (b * r - v_y) / v - force_r) * v / SIGMA_M,
            (hands - angle) / RACK_S,
        ]

    return solve_ivp(rates, (0.0, T[-1]), np.zeros(5), t_eval=T, rtol=1e-6).y[:2]


@pytest.mark.parametrize("v", [6.0, 17.0, 30.0])
def test_yaw_rate_follows_the_steering_as_an_integrated_vehicle_does(v):
    c = Chassis()
    true = integrated(c, v)[1, SETTLED]
    gain = v / (c.wheelbase_m + c.understeer_gradient * v * v)
    steer = ANGLE * np.sin(2.0 * np.pi * HZ * T)
    followed = followed_angle(steer, np.full(len(T), v), c, c.understeer_gradient)
    assert np.std(true - gain * followed[SETTLED]) < 0.05 * np.std(true)
    # The angle itself would be far off.
    assert np.std(true - gain * steer[SETTLED]) > 0.15 * np.std(true)


def test_a_steady_angle_is_followed_by_itself():
    followed = followed_angle(np.full(600, 0.3), np.linspace(0.0, 40.0, 600), Chassis(), 0.002)
    assert followed == pytest.approx(np.full(600, 0.3))


@pytest.mark.parametrize("v", [17.0, 30.0])
def test_rear_slip_is_behind_the_sideways_force(v):
    """Without the delay three times as much is left of the sideways speed."""
    c, speed = Chassis(), np.full(len(T), v)
    v_y, r = integrated(c, v)
    slip = c.mass_kg * c.cg_to_front_m / (c.wheelbase_m * c.rear_cornering_stiffness_npr) * v

    def left(late):
        made = c.cg_to_rear_m * r - slip * v * np.interp(T - late, T, r)
        return np.std((v_y - made)[SETTLED]) / np.std(slip * v * r[SETTLED])

    assert left(slip_delay(speed, slip, c)) < left(0.0) / 3.0


@pytest.mark.parametrize("along", [-3.0, 2.0])
def test_the_load_that_braking_shifts_turns_the_car_into_the_curve(along):
    """Steady turn; the stiffness of each axle goes with its load. Without the term the yaw rate is
    off by a tenth in hard braking, and the slip of the rear axle by a quarter."""
    c, v, height, sideways_force = Chassis(), 20.0, 0.5, 3.0
    a, b, m = c.cg_to_front_m, c.cg_to_rear_m, c.mass_kg
    length, rear = c.wheelbase_m, c.rear_cornering_stiffness_npr
    front = b / (c.understeer_gradient * length / m + a / rear)
    slip_f = m * sideways_force * b / length / (front * (1.0 - height * along / (GRAVITY * b)))
    slip_r = m * sideways_force * a / length / (rear * (1.0 + height * along / (GRAVITY * a)))
    r, one = sideways_force / v, np.ones(50)
    steer = np.arctan(length / v * r + slip_f - slip_r) * one

    kappa, gradient = m * a / (length * rear), c.understeer_gradient
    transfer = load_transfer(height, kappa, gradient, c)
    known = (v * one, steer, 0.0 * one, 1.0, gradient, 0.0, length)
    assert single_track(*known, along * one, transfer)[0] == pytest.approx(r, rel=0.01)
    assert abs(single_track(*known, along * one, 0.0)[0] / r - 1.0) > 0.03
    t = 0.1 * np.arange(50)
    v_y = sideways(v * one, r * one, t, kappa, along * one, height, c)
    assert v_y[-1] == pytest.approx(b * r - slip_r * v, rel=0.01)


@pytest.mark.parametrize("seed", [11, 13])
def test_the_steering_of_our_own_simulator_is_as_late_as_its_model_says(seed):
    """Hands, gear, tyres: what drives and what diagnoses have the same."""
    model = random_model(seed)
    drive = simulate(model, seed, 10.0)
    problem = State([drive_of(drive.samples)], model, model, {}).evaluated()
    e = estimate(problem, Hypothesis("", ("steering.delay_s",)), 1)
    assert abs(e.value[0]) < 0.02


@pytest.mark.slow
def test_a_body_that_rolls_more_than_its_file_says_is_found_though_its_lag_is_another():
    """A car of the second generator: with the lag of the file, its roll was held for the road's."""
    made = hidden_drive(4_420_007, (Effect("body_roll", "large"),), 12.0)
    found = diagnose([made.samples], model_from_mapping(dict(made.model), "baseline"))
    assert [cause.name for cause in found.causes] == ["body_roll"]
