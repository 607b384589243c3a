"""The search moves the model from where a cause was asked."""

from __future__ import annotations

import numpy as np
import pytest

from hidden import hidden_drive
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
