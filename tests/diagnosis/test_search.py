"""The search moves the model from where a cause was asked."""

from __future__ import annotations

import numpy as np
import pytest

from hidden import hidden_drive
from imucald.core.samples import Series
from imucald.diagnosis.search import search as searching
from imucald.diagnosis.search.state import State
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
