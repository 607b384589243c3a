"""How far an estimate is on its way, and how much driving the rest takes."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest

from imucald.mount.estimate import Gate, MountState, Progress
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.explanation import ProgressWatch
from imucald.mount.states import MountKnowledge
from imucald.runtime.session import make_engine
from simulated_bus import drive_frames, loaded

SETTINGS = EstimatorSettings()
BLOCK_S = 6.4


class Asked:
    """Asks for nothing but small deviations."""

    def shares(self, is_fine: bool) -> dict[str, float]:
        return {}


def progress(*stds: float, state: MountState = MountState.USABLE, **more: Any) -> Progress | None:
    """After blocks with these deviations about the up axis [rad]."""
    watch, asked = ProgressWatch(), Asked()
    known = MountKnowledge()
    for i, std in enumerate(stds, start=1):
        tilt = min(std, 1e-4) if math.isfinite(std) else std
        known = MountKnowledge(gravity=True, std=(tilt, tilt, std), cross_talk=(std, std), **more)
        watch.note_knowledge(i * BLOCK_S, known, SETTINGS, asked)  # type: ignore[arg-type]
    return watch.after(state, known, can_be_fine=True)


def test_information_that_grows_evenly_gives_the_time_at_which_the_limit_is_reached():
    limit = SETTINGS.limits.fine_yaw
    # 1 / std^2 proportional to time; the limit is reached after 60 blocks
    found = progress(*(limit * math.sqrt(60.0 / n) for n in range(1, 21)))
    assert found is not None
    assert found.goal is MountState.FINE
    gates = {gate.name: gate for gate in found.gates}
    assert gates["up axis"].share == pytest.approx(20 / 60)
    assert gates["up axis"].left == pytest.approx(40 * BLOCK_S)
    assert gates["forward axis"].share == 1.0


def test_nothing_is_said_of_the_time_while_no_information_comes():
    limit = SETTINGS.limits.fine_yaw
    for found in (progress(*[2.0 * limit] * 9), progress(2.0 * limit, 3.0 * limit)):
        assert found is not None
        assert found.gates[2].left is None
    frozen = progress(3.0 * limit, 2.0 * limit, frozen=True)
    assert frozen is not None
    assert frozen.gates[2].left is None


def test_until_there_is_a_first_solution_its_part_that_has_come_is_shown():
    """A bar of 0 % for half a minute would say that nothing happens."""

    def first(blocks: int, straight: int) -> Gate:
        found = progress(*[math.inf] * blocks, state=MountState.LEVELLED, straight=straight)
        assert found is not None
        (gate,) = found.gates
        assert gate.name == "first solution (acceleration, braking, bends)"
        assert gate.left is None, "it depends on what is driven"
        return gate

    assert [first(n, 0).share for n in range(1, 5)] == pytest.approx([n / 10 for n in range(1, 5)])
    assert [first(9, n).share for n in range(3)] == pytest.approx([1 / 2, 2 / 3, 5 / 6])
    assert first(9, 3).share == first(20, 9).share == 0.99


def test_the_share_of_a_drive_does_not_fall_before_the_first_solution():
    """A bar of 80 % was followed by five of 0 %."""
    engine = make_engine(loaded("joint"))
    frames, shares = drive_frames(minutes=1.0), []
    for start in range(0, len(frames), 800):
        engine.columns(frames.take(slice(start, start + 800)), keep=False)
        found = engine.pipeline.estimator.estimate().progress
        if found is not None:
            shares.append([gate.share for gate in found.gates])
    first = list(itertools.takewhile(lambda gates: len(gates) == 1, shares))
    assert 4 < len(first) < len(shares)
    assert first == sorted(first)
    assert max(shares[len(first)]) > 0.0


def test_a_fine_mount_waits_for_no_gate():
    assert progress(1.0, state=MountState.FINE) is None


def test_on_a_drive_the_time_that_is_left_is_right_within_a_factor_of_two():
    """Against when it was fine in the end."""
    engine = make_engine(loaded("joint"))
    frames, said = drive_frames(minutes=5.0), []
    for start in range(0, len(frames), 2000):
        engine.columns(frames.take(slice(start, start + 2000)), keep=False)
        estimate = engine.pipeline.estimator.estimate()
        if estimate.state is MountState.USABLE and estimate.progress is not None:
            gates = {gate.name: gate for gate in estimate.progress.gates}
            said.append((engine.timebase.now, gates["up axis"].left))
    fine = engine.pipeline.first_fine
    assert fine is not None
    early = [(t, left) for t, left in said if left and fine - t > 40.0]
    assert len(early) > 10
    within = sum(0.5 < left / (fine - t) < 2.0 for t, left in early)
    assert within > 0.8 * len(early)
