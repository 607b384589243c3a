"""A vehicle that parks with a noisy speed and no wheels' speeds beside it, simulated."""

from __future__ import annotations

import numpy as np
import pytest
from test_estimator import GOOD

from imucald.core.samples import Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimator import JointEstimator
from imucald.simulation import random_model, simulate
from mount_settings import joint_settings

SEED, MINUTES, STANDING_S = 500_000, 20.0, 600.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["signed", "cut off", "size"])
def test_ten_minutes_of_it_move_no_sensor_and_leave_the_mount_good(kind):
    model = random_model(SEED).with_changes({"route.standing_last_s": STANDING_S})
    drive = simulate(model, SEED, MINUTES)
    samples = {name: one for name, one in drive.samples.items() if name != "wheel_speeds"}
    speed = samples["speed"]
    noisy = speed.values + 0.3 * np.random.default_rng(1).standard_normal(len(speed.t))
    values = {"signed": noisy, "cut off": np.maximum(noisy, 0.0), "size": np.abs(noisy)}[kind]
    samples["speed"] = Series(speed.t, values)
    assert np.abs(speed.values[speed.t > 60.0 * MINUTES - STANDING_S + 10.0]).max() < 0.1
    estimator = JointEstimator(joint_settings())
    for k, row in enumerate(ticks_from_samples(samples, 0, int(600 * MINUTES)).tolist()):
        estimator.step(row)
        assert k < 5_500 or estimator.state in GOOD
    assert not estimator.estimate().details["shifts"]
