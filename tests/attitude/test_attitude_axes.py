"""Axes and plain-number rotations of the attitude, against scipy and the project's own frames."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imucald.attitude.right_forward_up import (
    rfu_from_vehicle,
    vehicle_angles,
    vehicle_from_rfu,
)
from imucald.core.rotations import (
    angles_from_rotation,
    quaternion_from_vector,
    quaternion_product,
    rotation_from_angles,
    rows_from_quaternion,
    times,
    transposed_times,
)

ANGLE = st.floats(-3.1, 3.1)
SMALL = st.floats(-1.5, 1.5)
VECTOR = st.tuples(SMALL, SMALL, SMALL)


@given(VECTOR)
def test_the_exponential_is_scipys(v):
    expected = Rotation.from_rotvec(v).as_matrix().ravel()
    assert rows_from_quaternion(quaternion_from_vector(*v)) == pytest.approx(expected, abs=1e-12)


@given(VECTOR.map(lambda v: tuple(c * 1e-5 for c in v)))
def test_the_exponential_of_small_vectors_is_scipys(v):
    expected = Rotation.from_rotvec(v).as_quat()
    w, x, y, z = quaternion_from_vector(*v)
    assert (x, y, z, w) == pytest.approx(tuple(expected), abs=1e-15)


@given(VECTOR, VECTOR, VECTOR)
def test_products_and_matrices_are_scipys(a, b, v):
    p, q = quaternion_from_vector(*a), quaternion_from_vector(*b)
    both = Rotation.from_rotvec(a) * Rotation.from_rotvec(b)
    assert times(rows_from_quaternion(quaternion_product(p, q)), v) == pytest.approx(
        both.apply(v), abs=1e-12
    )
    assert transposed_times(rows_from_quaternion(q), v) == pytest.approx(
        Rotation.from_rotvec(b).inv().apply(v), abs=1e-12
    )


@given(ANGLE, st.floats(-1.5, 1.5), st.floats(0.0, 6.28))
def test_angles_are_those_of_the_vehicle_in_iso_8855(roll, pitch, heading):
    """Truth by the project's own Z-Y-X angles of R_earth_from_vehicle, yaw being -heading."""
    C = Rotation.from_euler("ZXY", [-heading, -pitch, roll]).as_matrix()
    text = np.array([rfu_from_vehicle(*axis) for axis in np.eye(3)]).T
    # earth axes of the project: x north, y west, z up; of the text: east, north, up
    earth = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    R_earth_from_vehicle = earth @ C @ text
    assert rotation_from_angles(roll, pitch, -heading) == pytest.approx(
        R_earth_from_vehicle, abs=1e-9
    )
    found = vehicle_angles(tuple(C.ravel().tolist()))
    assert found[:2] == pytest.approx(angles_from_rotation(R_earth_from_vehicle)[:2], abs=1e-9)
    assert math.remainder(found[2] - heading, 2 * math.pi) == pytest.approx(0.0, abs=1e-9)


@given(VECTOR)
def test_axes_there_and_back(v):
    assert vehicle_from_rfu(*rfu_from_vehicle(*v)) == v


def test_forward_left_up_are_where_the_text_has_them():
    assert rfu_from_vehicle(1.0, 0.0, 0.0) == (0.0, 1.0, 0.0)  # forward is y
    assert rfu_from_vehicle(0.0, 1.0, 0.0) == (-1.0, 0.0, 0.0)  # left is minus right


def test_a_million_turns_leave_a_unit_quaternion():
    q = (1.0, 0.0, 0.0, 0.0)
    step = quaternion_from_vector(0.011, -0.007, 0.019)
    for _ in range(100_000):
        q = quaternion_product(q, step)
    assert sum(c * c for c in q) == pytest.approx(1.0, abs=1e-14)
