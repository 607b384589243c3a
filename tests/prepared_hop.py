"""One hop of prepared signals: straight driving on the level, unless given otherwise."""

from __future__ import annotations

import numpy as np

from imucald.core.samples import GRAVITY
from imucald.mount.signal_blocks import HOP, Prepared


def hop(t0: float = 0.0, **given: np.ndarray) -> Prepared:
    yes, no = np.ones(HOP, dtype=bool), np.zeros(HOP, dtype=bool)
    values = {
        "t": t0 + 0.1 * np.arange(HOP),
        "force": np.tile([0.0, 0.0, GRAVITY], (HOP, 1)),
        "rate": np.zeros((HOP, 3)),
        "speed": np.full(HOP, 10.0),
        "accel": np.zeros(HOP),
        "yaw_rate": np.zeros(HOP),
        "ok_force": yes,
        "ok_rate": yes,
        "ok_speed": yes,
        "ok_yaw": yes,
        "rest": no,
        "learn": yes,
        "steering": np.zeros(HOP),
        "ok_steering": no,
        "had_rate": yes,
        "gyro_bias": np.zeros(3),
    }
    return Prepared(**(values | given))  # type: ignore[arg-type]
