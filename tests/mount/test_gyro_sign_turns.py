"""A sign of the gyroscope that turns in mid-drive, on simulated drives."""

from __future__ import annotations

import numpy as np
import pytest
from test_estimator import GOOD, drive

from imucald.core.samples import Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.contradictions import StandingFault
from imucald.mount.estimator import JointEstimator
from mount_settings import joint_settings

AT, LOOKED_AT_S = 480.0, 90.0
SIGNS = {"x": (-1.0, 1.0, 1.0), "y": (1.0, -1.0, 1.0), "z": (1.0, 1.0, -1.0), "all": (-1.0,) * 3}


@pytest.mark.slow
@pytest.mark.parametrize("axes", list(SIGNS))
def test_it_is_not_good_after_a_minute_and_a_half_and_the_gyroscope_is_named(axes):
    samples = dict(drive(minutes=15.0).samples)
    series = samples["gyro"]
    late = (series.t >= AT)[:, None]
    samples["gyro"] = Series(series.t, np.where(late, series.values * SIGNS[axes], series.values))
    estimator, was_good = JointEstimator(joint_settings()), False
    for k, row in enumerate(ticks_from_samples(samples, 0, 9000, {}).tolist()):
        estimator.step(row)
        was_good = was_good or (k < 10 * AT and estimator.state in GOOD)
        if k > 10 * (AT + LOOKED_AT_S):
            assert estimator.state not in GOOD
    assert was_good
    seen = {fault["fault"] for fault in estimator.estimate().details["faults"]}
    assert seen & {StandingFault.GYRO_AXES.value, StandingFault.TURN_YAW_RATE.value}
