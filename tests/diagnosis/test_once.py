"""What is made of the same inputs is made once, and of any other inputs anew."""

from __future__ import annotations

import numpy as np
import pytest

from hidden import hidden_drive
from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.equations.reading import Once
from imucald.diagnosis.signals import drive_of
from imucald.model.model import model_from_mapping


def test_the_same_array_is_used_once_and_an_equal_one_again():
    calls = []

    def doubled(x, factor):
        calls.append(factor)
        return factor * x

    once, x = Once({}, True), np.ones(3)
    assert once(doubled, x, 2.0) is once(doubled, x, 2.0)
    once(doubled, x, 3.0)
    once(doubled, x.copy(), 2.0)
    assert calls == [2.0, 3.0, 2.0]


def test_what_is_not_kept_is_gone_with_its_owner_and_what_was_kept_is_found():
    known, x = {}, np.ones(3)
    once = Once(known, False)
    assert once(np.negative, x) is once(np.negative, x)
    assert Once(known, False)(np.negative, x) is not once(np.negative, x)
    kept = Once(known, True)(np.negative, x)
    assert Once(known, False)(np.negative, x) is kept


def test_an_array_that_is_kept_cannot_be_changed():
    kept = Once({}, True)(np.negative, np.ones(3))
    with pytest.raises(ValueError, match="read-only"):
        kept += 1.0


def test_a_column_is_the_same_whether_anything_was_evaluated_before_it_or_not():
    drive = hidden_drive(21, (), 3.0)
    model, signals = model_from_mapping(dict(drive.model), "baseline"), drive_of(drive.samples)
    used = Forward(signals, model, 200)
    base, masks = used.residuals({}), used.usable()
    tilt = used.tilts(base, masks)
    share = used.inertial_share(base, masks, 0.4, tilt)
    used.settle(tilt, share)
    settled, moved = used.residuals({}, by_inertia=True), 0
    for key, row in PARAMETERS.items():
        if not all(signals.has(name) for name in row.needs):
            continue
        changes = {key: row.tolerance}
        fresh = Forward(signals, model, 200)
        fresh.settle(tilt, share)
        fresh.known.clear()
        again = used.residuals(changes, by_inertia=True).of
        for name, y in fresh.residuals(changes, by_inertia=True).of.items():
            assert np.array_equal(again[name], y), (key, name)
            moved += again[name] is not settled.of[name]
    assert moved > 50
