"""No measurement shows a gain of the sensor, so no correction may contain one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimator import JointEstimator
from imucald.mount.joint.state import own_terms, without_gains
from imucald.simulation import random_model, simulate
from imucald.simulation.imu import gain_matrix
from mount_settings import joint_settings

NUMBERS = st.floats(-0.3, 0.3)


def vector(n: int) -> st.SearchStrategy[list[float]]:
    return st.lists(NUMBERS, min_size=n, max_size=n)


@given(vector(3), vector(9), vector(9), vector(3))
def test_a_correction_without_gains_has_the_same_cross_axis_terms(turn, force, rate, zero):
    housing = rotation_from_vector(np.array(turn))
    W, V = ((np.eye(3) + 0.3 * np.reshape(x, (3, 3))) @ housing for x in (force, rate))
    zero = np.array(zero)
    made = without_gains(housing, W, V, zero)
    assert np.allclose(np.diag(housing @ np.linalg.inv(made[0])), 1.0)
    assert np.allclose(np.diag(housing @ np.linalg.inv(made[1])), 1.0)
    terms = own_terms(housing, *made)
    assert np.allclose(terms[3:9], own_terms(housing, W, V, zero)[3:9])
    assert np.allclose(np.linalg.solve(made[0], made[2]), np.linalg.solve(W, zero)), "same zero"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1820001, 1820008])
def test_the_forward_force_keeps_its_size_where_the_first_axes_were_far_off(seed: int) -> None:
    """Speeds of a diagnostic query: whole km/h, every two seconds."""
    model = random_model(seed)
    made = simulate(model, seed, 5.0)
    samples = {name: one for name, one in made.samples.items() if name != "wheel_speeds"}
    speed, t = samples["speed"], np.arange(0.3, 300.0, 2.0)
    known = np.interp(t - 0.3, speed.t, speed.values)
    samples["speed"] = Series(t, np.rint(3.6 * known) / 3.6)
    estimator = JointEstimator(joint_settings())
    for row in ticks_from_samples(samples, 0, 3000).tolist():
        estimator.step(row)
    solution = estimator.solution
    assert solution is not None
    response = gain_matrix(model.accel) @ made.truth.R_vehicle_from_sensor().T
    assert np.diag(solution.force @ response) == pytest.approx(np.ones(3), abs=0.02)
