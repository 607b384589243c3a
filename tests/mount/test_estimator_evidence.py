"""Each kind of evidence by itself, on signals made from closed formulas."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.samples import GRAVITY
from imucald.motion.ticks import empty_rows
from imucald.mount.carried_force import CarriedForce
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.offsets import Offsets
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlockMaker
from imucald.mount.steering import SteeringOffsetEstimator
from signal_block import block


def test_places_are_counted_not_samples():
    carried = CarriedForce(EstimatorSettings())
    rest = np.ones(BLOCK_TICKS, dtype=bool)
    for _ in range(100):
        carried.take_block(block(rest=rest, speed=np.zeros(BLOCK_TICKS)))
    assert carried.gravity.stops == 1
    assert carried.levelled(0.0)[1] == pytest.approx(0.02**2)
    for _ in range(32000 // BLOCK_TICKS):
        carried.take_block(block())
    assert carried.gravity.metres == pytest.approx(32000.0)
    assert carried.levelled(0.0)[1] == pytest.approx(0.02**2 * 400 / 32000, rel=0.5)


def test_steering_offset_in_curves_of_both_sides():
    rng = np.random.default_rng(9)
    steering = SteeringOffsetEstimator()
    for _ in range(200):
        v = np.full(BLOCK_TICKS, rng.uniform(6.0, 25.0))
        r = np.full(BLOCK_TICKS, rng.normal() * 1.5 / v[0])
        angle = (
            15.0 * (2.7 + 0.003 * v * v) * r / v + 0.03 + 0.01 * rng.standard_normal(BLOCK_TICKS)
        )
        steering.add_block(angle, v, r, np.ones(BLOCK_TICKS, dtype=bool))
    fitted = steering.fitted(0.0, 0.0)
    assert fitted is not None
    assert fitted[0] == pytest.approx(0.03, abs=0.003)


def test_a_moving_vehicle_teaches_no_rest_offset():
    offsets = Offsets()
    force = np.tile([0.0, 0.0, GRAVITY], (BLOCK_TICKS, 1))
    offsets.learn_gyro(np.tile([0.0, 0.0, 0.3], (BLOCK_TICKS, 1)), force)
    assert offsets.gyro_ticks == 0.0
    offsets.learn_gyro(np.tile([0.001, 0.0, 0.005], (BLOCK_TICKS, 1)), force)
    assert offsets.gyro_bias == pytest.approx([0.001, 0.0, 0.005])


def test_empty_ticks_prepare_to_nothing_learnt():
    preparer = SignalBlockMaker(EstimatorSettings())
    for row in empty_rows(BLOCK_TICKS):
        complete = preparer.push(row)
    assert complete
    prepared = preparer.block()
    assert not prepared.learn.any()
    assert not prepared.ok_speed.any()
