"""What an ideal filter could see of an effect that the catalogue lacks."""

from __future__ import annotations

from benchmarks.diagnosis.ideal import Ideal

from hidden import hidden_drive
from imucald.core.samples import Series
from imucald.model.model import model_from_mapping


def test_a_drive_that_an_effect_makes_shorter_shows_nothing_in_what_is_lost():
    """Frames that wait in a full queue at the end of a log are lost with it."""
    drive = hidden_drive(5, minutes=6.0)
    ideal = Ideal(drive.samples, model_from_mapping(dict(drive.model), "baseline"))
    end = drive.samples["speed"].t[-1] - 40.0
    shorter = {n: Series(s.t[s.t < end], s.values[s.t < end]) for n, s in drive.samples.items()}
    assert max(s.ratio for s in ideal.of(shorter)) < 1.0
    accel = shorter["accel"]
    off = {**shorter, "accel": Series(accel.t, accel.values * 1.5)}
    assert max(s.ratio for s in ideal.of(off)) > 1.0
