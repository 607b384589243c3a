"""What is applied: a matrix and an offset for each sensor, and the way from one to another."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.mount.estimate import HOUSING, Correction
from imucald.mount.slewing import SlewedCorrection

DEG = math.pi / 180.0
STEP = 0.05 * DEG
"""What 0.5 deg/s comes to in a tick."""


def correction(seed: int, angles: tuple[float, float, float] = (5.0, -3.0, 30.0)) -> Correction:
    """Of a sensor with errors of its own, and what they are."""
    rng = np.random.default_rng(seed)
    R = Rotation.from_euler("ZYX", angles[::-1], degrees=True).as_matrix()
    W, V = (R + rng.normal(0.0, 0.03, (3, 3)) for _ in range(2))
    return Correction.with_matrices(R, W, V, rng.normal(0.0, 0.2, 3), rng.normal(0.0, 0.01, 3))


def test_each_sensor_gets_its_own_matrix_and_offset_and_others_the_rotation():
    c = correction(1)
    R, W, V = (np.reshape(m, (3, 3)) for m in (c.rotation, c.force, c.rate))
    v = [0.4, -2.0, 9.5]
    assert c.applied("accel", v) == pytest.approx(W @ v - c.force_offset, abs=1e-14)
    assert c.applied("gyro", v) == pytest.approx(V @ v - c.rate_offset, abs=1e-14)
    for channel in ("mag", "parallel/second", HOUSING):
        assert c.applied(channel, v) == pytest.approx(R @ v, abs=1e-14)
    assert not c.is_rotation
    assert Correction.turning(R).is_rotation


def numbers(c: Correction) -> np.ndarray:
    return np.array([*c.rotation, *c.force, *c.rate, *c.force_offset, *c.rate_offset])


def steps_between(before: Correction, after: Correction) -> list[Correction]:
    slewed = SlewedCorrection(rate=0.5 * DEG)
    slewed.aim(before)
    slewed.aim(after)
    found = [before]
    while slewed.is_moving:
        slewed.move_on()
        assert slewed.correction is not None
        found.append(slewed.correction)
        assert len(found) < 2000
    return found


def test_matrices_and_offsets_arrive_with_the_rotation_and_go_at_the_limited_rate():
    before, after = correction(2), correction(3, (5.0, -3.0, 31.0))
    way = steps_between(before, after)
    assert way[-1] is after
    far = [abs(numbers(a) - numbers(after)).max() for a in way]
    assert far == sorted(far, reverse=True)
    for one, next_ in itertools.pairwise(way):
        R, S = one.matrix(), next_.matrix()
        assert np.linalg.norm(Rotation.from_matrix(S @ R.T).as_rotvec()) <= STEP * 1.001
        level = np.subtract(next_.force_offset, one.force_offset)
        assert abs(level).max() <= 9.81 * STEP * 1.001
        assert abs(np.subtract(next_.force, one.force)).max() <= 2.1 * STEP
    # what takes longest says how many: the largest change of the rest, in angles
    apart = max(
        abs(
            np.subtract(after.force, after.rotation) - np.subtract(before.force, before.rotation)
        ).max(),
        abs(
            np.subtract(after.rate, after.rotation) - np.subtract(before.rate, before.rotation)
        ).max(),
        abs(np.subtract(after.force_offset, before.force_offset)).max() / 9.80665,
        1.0 * DEG,
    )
    assert len(way) - 1 == math.ceil(apart / STEP)


def test_the_same_target_again_starts_nothing():
    slewed = SlewedCorrection(rate=0.5 * DEG)
    for _ in range(2):
        slewed.aim(correction(5))
        assert not slewed.is_moving
    assert slewed.has_arrived


def test_a_zero_error_alone_is_taken_off_slowly():
    R = correction(4).matrix()
    before = Correction.turning(R)
    after = Correction.with_matrices(R, R, R, [0.1, 0.0, 0.0])
    way = steps_between(before, after)
    assert len(way) - 1 == math.ceil(0.1 / 9.80665 / STEP)
    assert all(c.rotation == before.rotation for c in way)


def test_the_way_of_a_rotation_alone_is_a_rotation_for_both_sensors():
    before, after = (Correction.turning(correction(k, (0, 0, 2.0 * k)).matrix()) for k in (0, 1))
    way = steps_between(before, after)
    assert len(way) - 1 == 40
    assert all(c.is_rotation for c in way)
