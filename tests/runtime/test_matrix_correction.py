"""An estimator that says a matrix and an offset for each sensor: what the frames carry then."""

from __future__ import annotations

import random

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from engine_bus import CONFIGS, ScriptedEstimator, Traffic, columns_of, engine_of, frames_of, load
from imucald.core.samples import Samples, Series
from imucald.mount.estimate import Correction, MountState
from imucald.runtime.pipeline import Pipeline

R = Rotation.from_euler("ZYX", [40.0, -6.0, 3.0], degrees=True).as_matrix()
W = R @ np.array([[1.0, 0.02, -0.01], [0.03, 1.0, 0.015], [-0.02, 0.01, 1.0]])
V = R @ np.array([[1.0, -0.03, 0.0], [0.01, 1.0, 0.02], [0.03, 0.0, 1.0]])
FORCE_OFFSET, RATE_OFFSET = np.array([0.21, -0.14, 0.3]), np.array([0.004, -0.01, 0.02])


class WithMatrices(ScriptedEstimator):
    """Sure of matrices and offsets; they come and go, and the offset changes from tick to tick."""

    @property
    def correction(self) -> Correction | None:
        if self.steps < 3 or self.steps % 17 == 16:
            return None
        return Correction.with_matrices(R, W, V, FORCE_OFFSET * self.steps, RATE_OFFSET)

    @property
    def state(self) -> MountState:
        return MountState.FINE


def test_columns_and_single_samples_get_the_matrix_and_offset_of_their_sensor():
    rng = np.random.default_rng(5)
    t = np.sort(rng.uniform(0.0, 4.0, 400))
    values = {c: rng.normal(size=(400, 3)) for c in ("accel", "gyro", "mag")}
    samples: Samples = {c: Series(t, v) for c, v in values.items()}
    corrections, _ = Pipeline(WithMatrices()).run(samples, {}, 4.0)
    tick = np.floor(t * 10.0).astype(np.int64)
    for channel, matrix, offset in (
        ("accel", W, FORCE_OFFSET), ("gyro", V, RATE_OFFSET), ("mag", R, 0.0 * RATE_OFFSET)
    ):  # fmt: skip
        times = tick[:, None] if channel == "accel" else 1.0
        expected = values[channel] @ matrix.T - offset * times
        expected[(tick < 3) | (tick % 17 == 16)] = np.nan
        found = corrections.turned(channel, tick, values[channel])
        assert found == pytest.approx(expected, abs=1e-12, nan_ok=True)
        for k, row in enumerate(found):
            now = corrections.corrections[tick[k]]
            assert now is None or tuple(row) == now.applied(channel, values[channel][k].tolist())


@pytest.mark.parametrize("name", sorted(CONFIGS))
def test_frame_by_frame_and_in_columns_the_same_is_sent(name, tmp_path):
    loaded = load(CONFIGS[name], tmp_path)
    frames = Traffic(random.Random(7), loaded).frames(400)
    live = engine_of(loaded, WithMatrices())
    expected = [out for frame in frames for out in live.frame(*frame)]
    assert frames_of(engine_of(loaded, WithMatrices()).columns(columns_of(frames))) == expected
