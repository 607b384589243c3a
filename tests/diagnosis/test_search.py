"""The search moves the model from where a cause was asked."""

from __future__ import annotations

import numpy as np
import pytest

from hidden import Effect, hidden_drive
from imucald.core.samples import Series
from imucald.diagnosis.cause_keys import plausible
from imucald.diagnosis.search import search as searching
from imucald.diagnosis.search.state import State, estimate_unstated
from imucald.diagnosis.search.trials import hypotheses
from imucald.diagnosis.signals import drive_of
from imucald.model.model import model_from_mapping

SEED, MINUTES = 21, 10.0


def test_what_is_asked_from_the_edge_of_the_plausible_is_taken_from_there(monkeypatch):
    """A file whose ratio is half as much again: the slope there leads further than any ratio is."""
    drive = hidden_drive(SEED, (), MINUTES)
    right = model_from_mapping(dict(drive.model), "b")
    ratio = right.chassis.steering_ratio
    stated = right.with_changes({"chassis.steering_ratio": 1.5 * ratio})
    state = State([drive_of(drive.samples)], stated, stated, {})
    for name in ("refit", "eliminate", "demote"):
        monkeypatch.setattr(searching, name, lambda *_: None)
    asked = iter((False, True))
    searching.search(state, lambda _: None, lambda: next(asked, True))
    assert [t.hypothesis.name for t in state.named] == ["steering_ratio"]
    assert state.model.chassis.steering_ratio == pytest.approx(ratio, rel=0.05)
    assert np.isfinite(state.named[0].shown)


def test_what_leaves_its_tolerance_is_asked_where_one_step_leads():
    """Of a speed 0.4 s late in whole km/h one step finds a third; from there, more is seen."""
    drive = hidden_drive(SEED, (), MINUTES)
    stated = model_from_mapping(dict(drive.model), "b")
    speed = drive.samples["speed"]
    late = {**drive.samples, "speed": Series(speed.t + 0.4, np.round(speed.values * 3.6) / 3.6)}
    state = State([drive_of(late)], stated, stated, {})
    problem = state.evaluated()
    state.last = searching._trials(problem, state, [])
    at_once = next(t for t in state.last if t.hypothesis.keys == ("speed.delay_s",))
    there = searching._where_it_leads(problem, state)
    assert there is not None
    assert there.hypothesis.keys == ("speed.delay_s",)
    assert 0.0 < at_once.estimate.value[0] < there.estimate.value[0] - 0.1
    assert there.estimate.value[0] < 0.45
    assert there.shown > 2.0 * at_once.shown
    assert state.model == stated, "the question moves nothing"


def test_a_component_of_a_found_vector_is_asked_by_itself():
    """The zero forward may leave its tolerance only after the zeros left and up are found."""
    drive = hidden_drive(SEED, (), MINUTES)
    stated = model_from_mapping(dict(drive.model), "b")
    table = State([drive_of(drive.samples)], stated, stated, {}).evaluated().table

    def keys_of(name: str, *found: str) -> list[tuple[str, ...]]:
        return [h.keys for h in hypotheses(table, stated, found) if h.name == name]

    assert keys_of("accel_bias", "accel.bias.y", "accel.bias.z") == [("accel.bias.x",)]
    assert keys_of("accel_bias", *(f"accel.bias.{axis}" for axis in "xyz")) == []
    gains = [f"gyro.scale.{i}" for i in range(3)]
    assert keys_of("gyro_scale", gains[0]) == [(gains[1],), (gains[2],)], "not the common one"


def test_a_zero_that_a_gain_moves_within_its_tolerance_may_be_found_by_itself():
    stated = model_from_mapping(dict(hidden_drive(SEED, (), MINUTES).model), "b")
    moved = {"accel.scale.2": 0.05, "accel.bias.x": 0.02, "accel.bias.z": 0.49}
    state = State([], stated, stated, {}, changes=moved, held=set(moved))
    assert state.found == ["accel.scale.2", "accel.bias.z"]


def test_what_no_file_states_is_estimated_and_is_no_cause():
    drive = hidden_drive(SEED, (Effect("lever_arm", "large"),), MINUTES)
    file = model_from_mapping(dict(drive.model), "b")
    keys = [f"mount.lever_arm_m.{i}" for i in range(3)]
    unstated = file.with_changes(
        {"known_to": {key: max(map(abs, plausible(file, key))) for key in keys}}
    )
    state = State([drive_of(drive.samples)], unstated, unstated, {})
    estimate_unstated(state)
    true = [drive.truth["lever_arm"][key] for key in keys]
    assert np.abs(np.subtract(state.stated.mount.lever_arm_m, file.mount.lever_arm_m)).max() > 1.0
    assert state.stated.mount.lever_arm_m == pytest.approx(true, abs=0.3)
    searching.search(state, lambda _: None, lambda: False)
    assert state.named == []
    assert not any(t.hypothesis.name == "lever_arm" for t in state.last)


def test_a_late_speed_stays_found_where_one_step_from_the_file_explains_little():
    """The delay is 0.5 s. Backward elimination tests each cause at the value that its step reaches,
    with all other causes applied.
    """
    drive = hidden_drive(23, (Effect("gyro_bias", "large"),), MINUTES)
    stated = model_from_mapping(dict(drive.model), "b")
    speed = drive.samples["speed"]
    late = {
        "accel": drive.samples["accel"], "gyro": drive.samples["gyro"],
        "speed": Series(speed.t + 0.5, np.round(speed.values * 3.6) / 3.6),
    }  # fmt: skip
    state = State([drive_of(late)], stated, stated, {})
    searching.search(state, lambda _: None, lambda: False)
    assert [t.hypothesis.name for t in state.named if "speed.delay_s" in t.hypothesis.keys]
    assert state.changes["speed.delay_s"] > 0.25
