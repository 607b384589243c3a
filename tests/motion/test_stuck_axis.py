"""An axis of a triad that says the same again and again at rest."""

from __future__ import annotations

import numpy as np

from imucald.motion.hops import AxisHops, Carry, hop_rows
from imucald.motion.sensor_judges import AxisRuns

NOISE, STEP = 1.0, 2.0
"""Of 100 Hz, changing at every other sample: 25 Hz are 5 of noise, of which 3 is the finest."""


class Sensor:
    """Half a second after another of a sensor at rest."""

    def __init__(self) -> None:
        self.rng, self.carry, self.value = np.random.default_rng(0), Carry.none(1), 0.0
        self.runs = AxisRuns(NOISE)

    def hop(self, is_held: bool) -> bool:
        """Whether the axis is stuck after 50 samples that change, or do not."""
        change = self.rng.choice([0.0, 0.0, STEP, -STEP], 50) * (not is_held)
        values = self.value + np.cumsum(change)
        self.value = float(values[-1])
        rows = hop_rows(values[:, None], np.zeros(50, np.int64), 1, self.carry)
        stuck, lost = self.runs.take_hop(AxisHops(0, rows), 0, False)
        assert not lost
        return stuck


def stand(axis: Sensor, hops: int) -> None:
    assert not any(axis.hop(False) for _ in range(hops))


def held(axis: Sensor, hops: int) -> list[bool]:
    return [axis.hop(True) for _ in range(hops)]


def test_an_axis_that_was_stuck_for_minutes_is_seen_again_the_next_time() -> None:
    axis = Sensor()
    stand(axis, 60)
    assert held(axis, 600)[2:] == [True] * 598
    stand(axis, 60)
    assert held(axis, 10)[2:] == [True] * 8
