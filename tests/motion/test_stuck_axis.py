"""An axis of a triad that says the same again and again at rest."""

from __future__ import annotations

from imucald.motion.sensor_judges import StuckAxis

NOISE, STEP = 1.0, 2.0
"""Of 100 Hz, changing at every other sample: 25 Hz are 5 of noise, of which 3 is the finest."""
NOISY = (50, 25, 8, 1)


def stand(axis: StuckAxis, hops: int) -> None:
    for _ in range(hops):
        assert not axis.take_hop(False, NOISY, STEP, False)


def held(axis: StuckAxis, hops: int) -> list[bool]:
    return [axis.take_hop(False, (50, 0, 50 * k, 50 * k), STEP, False) for k in range(1, hops + 1)]


def test_an_axis_that_was_stuck_for_minutes_is_seen_again_the_next_time():
    axis = StuckAxis(NOISE)
    stand(axis, 60)
    assert held(axis, 600)[2:] == [True] * 598
    stand(axis, 60)
    assert held(axis, 10)[2:] == [True] * 8
