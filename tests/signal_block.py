"""One block of prepared signals: straight driving on the level, unless given otherwise."""

from __future__ import annotations

import numpy as np

from imucald.core.samples import GRAVITY
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlock


def block(t0: float = 0.0, **given: np.ndarray) -> SignalBlock:
    yes, no = np.ones(BLOCK_TICKS, dtype=bool), np.zeros(BLOCK_TICKS, dtype=bool)
    values = {
        "t": t0 + 0.1 * np.arange(BLOCK_TICKS),
        "force": np.tile([0.0, 0.0, GRAVITY], (BLOCK_TICKS, 1)),
        "rate": np.zeros((BLOCK_TICKS, 3)),
        "speed": np.full(BLOCK_TICKS, 10.0),
        "accel": np.zeros(BLOCK_TICKS),
        "yaw_rate": np.zeros(BLOCK_TICKS),
        "ok_force": yes,
        "ok_rate": yes,
        "ok_speed": yes,
        "ok_yaw": yes,
        "rest": no,
        "learn": yes,
        "steering": np.zeros(BLOCK_TICKS),
        "ok_steering": no,
        "had_rate": yes,
        "gyro_bias": np.zeros(3),
    }
    return SignalBlock(**(values | given))  # type: ignore[arg-type]
