"""A vehicle without a speed: what its gear and its rest say from the first block on."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.samples import GRAVITY, Series
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimator import _block
from imucald.mount.joint.state import OtherSignals
from imucald.mount.signal_blocks import NOMINAL_SPEED, SignalBlock, SignalBlockMaker
from mount_settings import joint_settings


def blocks(reverse_until: float) -> list[SignalBlock]:
    """A minute on a rough road without a speed, in reverse until then."""
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 60.0, 0.02)
    force = np.array([0.0, 0.0, GRAVITY]) + 0.5 * rng.standard_normal((len(t), 3))
    samples = {
        "accel": Series(t, force),
        "gyro": Series(t, 0.05 * rng.standard_normal((len(t), 3))),
        "reverse": Series(t, (t < reverse_until).astype(float)),
    }
    maker, found = SignalBlockMaker(joint_settings()), []
    for row in ticks_from_samples(samples, 0, 600, {}).tolist():
        if maker.push(row):
            found.append(maker.block())
    return found


@pytest.mark.parametrize("reverse_until", [0.0, 20.0, 99.0])
def test_the_gear_counts_from_the_first_block_on(reverse_until: float) -> None:
    made = blocks(reverse_until)
    assert made[0].has_speed
    assert not made[-1].has_speed
    for p in made[1:]:
        in_reverse = _block(p, OtherSignals(speed=False)).speed == -NOMINAL_SPEED
        assert not p.rest.any()
        if abs(p.t[0] - reverse_until) > 15.0:
            assert in_reverse.all() == (p.t[0] < reverse_until)
