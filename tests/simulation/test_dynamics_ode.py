"""Single track and suspension against scipy's ODE solver on other formulations of them."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from imucald.core.samples import GRAVITY
from imucald.model.vehicle import Chassis
from imucald.simulation.filters import filtered, second_order
from imucald.simulation.single_track import handle

RATE = 200.0


def single_track_reference(chassis, speed, steer, bank, duration):
    """Sideslip angle and yaw rate, as functions of time; forces and moments in newtons."""
    m, inertia = chassis.mass_kg, chassis.yaw_inertia_kgm2
    lf, L = chassis.cg_to_front_m, chassis.wheelbase_m
    lr = L - lf
    c_rear = chassis.rear_cornering_stiffness_npr
    # Front stiffness from the textbook's understeer gradient, solved by hand.
    c_front = 1.0 / ((chassis.understeer_gradient * L / m + lf / c_rear) / lr)

    def force(c, load, slip):
        if not chassis.tyre_saturation:
            return c * slip
        limit = chassis.friction * load
        return np.sign(slip) * limit / np.hypot(1.0, limit / max(c * abs(slip), 1e-9))

    def rhs(t, state):
        beta, r = state
        v, a = speed(t), (speed(t + 1e-4) - speed(t - 1e-4)) / 2e-4
        front = force(c_front, m * GRAVITY * lr / L, steer(t) - beta - lf * r / v)
        rear = force(c_rear, m * GRAVITY * lf / L, -beta + lr * r / v)
        side = front + rear - m * GRAVITY * np.sin(bank(t))
        return [side / (m * v) - r - beta * a / v, (lf * front - lr * rear) / inertia]

    return solve_ivp(rhs, (0.0, duration), [0.0, 0.0], max_step=0.01, rtol=1e-8, atol=1e-10,
                     dense_output=True).sol  # fmt: skip


@pytest.mark.parametrize("saturating", [False, True])
@pytest.mark.parametrize("gradient", [0.0025, 0.0, -0.0005])
def test_yaw_rate_and_sideslip_agree_with_an_ode_solver(saturating, gradient):
    chassis = Chassis(tyre_saturation=saturating, understeer_gradient=gradient)

    def speed(t):
        return 18.0 + 0.8 * t - 4.0 * np.sin(0.5 * t)

    def steer(t):
        return 0.03 * np.sin(2.0 * t) * min(t, 1.0) + 0.02 * (t > 4.0) * min(t - 4.0, 1.0)

    def bank(t):
        return 0.03 * np.sin(0.7 * t)

    t = np.arange(0.0, 10.0, 1.0 / RATE)
    found = handle(
        chassis, speed(t), np.array([steer(x) for x in t]), np.array([bank(x) for x in t]), RATE
    )
    beta, r = single_track_reference(chassis, speed, steer, bank, 10.0)(t)
    assert np.max(np.abs(r)) > 0.1
    assert np.max(np.abs(found.yaw_rate - r)) < 2e-3
    assert np.max(np.abs(found.lateral_velocity / speed(t) - beta)) < 1e-3


def test_at_walking_speed_and_in_reverse_the_wheels_roll_without_slip():
    chassis = Chassis()
    t = np.arange(0.0, 30.0, 1.0 / RATE)
    speed = np.where(t < 15.0, 2.0, -2.0) * np.abs(np.sin(2.0 * np.pi * t / 30.0))
    steer = np.full(len(t), 0.3)
    found = handle(chassis, speed, steer, np.zeros(len(t)), RATE)
    moving = np.abs(speed) > 1.0
    kinematic = speed * 0.3 / chassis.wheelbase_m
    np.testing.assert_allclose(found.yaw_rate[moving], kinematic[moving], rtol=0.03)
    assert np.max(np.abs(found.yaw_rate[np.abs(speed) < 1e-3])) < 5e-3


def test_standing_on_a_bank_does_not_move_the_vehicle():
    found = handle(Chassis(), np.zeros(2000), np.zeros(2000), np.full(2000, 0.05), RATE)
    assert np.max(np.abs(found.lateral_velocity)) < 0.01
    assert np.max(np.abs(found.yaw_rate)) < 0.01


def test_suspension_agrees_with_an_ode_solver():
    frequency, damping, gain = 1.6, 0.3, 0.008

    def push(t):
        return 3.0 * np.sin(1.3 * t) + 2.0 * np.exp(-(((t - 4.0) / 0.2) ** 2))

    stiffness, inertia = 50e3, 50e3 / (2.0 * np.pi * frequency) ** 2
    damper = 2.0 * damping * np.sqrt(stiffness * inertia)

    def rhs(t, state):
        moment = stiffness * gain * push(t)
        return [state[1], (moment - stiffness * state[0] - damper * state[1]) / inertia]

    t = np.arange(0.0, 8.0, 1.0 / RATE)
    solved = solve_ivp(rhs, (0.0, 8.0), [0.0, 0.0], rtol=1e-9, atol=1e-12, t_eval=t, max_step=0.01)
    angle = second_order(gain * push(t), RATE, frequency, damping)
    angle_rate = second_order(gain * push(t), RATE, frequency, damping, derivative=True)
    assert np.max(np.abs(angle - solved.y[0])) < 2e-3 * np.max(np.abs(solved.y[0]))
    assert np.max(np.abs(angle_rate - solved.y[1])) < 5e-3 * np.max(np.abs(solved.y[1]))


def test_recursive_filter_equals_scipys():
    from scipy.signal import lfilter

    x = np.random.default_rng(1).standard_normal(500)
    b, a = [0.2, 0.3, 0.1], [1.5, -0.9, 0.2]
    np.testing.assert_allclose(filtered(b, a, x, settled=False), lfilter(b, a, x), atol=1e-12)
    shifted = filtered(b, a, x + 3.0)
    assert shifted[0] == pytest.approx((x[0] + 3.0) * sum(b) / sum(a))
