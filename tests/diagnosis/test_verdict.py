"""The verdict, of what was found and what is left."""

from __future__ import annotations

import made_diagnosis as made
import pytest

from imucald.diagnosis.outcome import of_signal, verdict_of
from imucald.diagnosis.result import Kind, Structure


@pytest.mark.parametrize("kind", [Kind.NOT_PLAUSIBLE, Kind.TOO_MUCH, Kind.GOES_AGAINST])
def test_beside_what_the_model_cannot_be_right_of_nothing_is_found(kind):
    left = [Structure("accel_x", kind, 2.0, "")]
    assert verdict_of(made.found().causes, (), left) == "unknown"
    assert verdict_of((), (), left) == "unknown"


def test_what_else_is_left_leaves_a_cause_standing():
    causes, left = made.found().causes, [Structure("accel_x", Kind.UNEVEN, 2.0, "")]
    assert verdict_of(causes, (), left) == "found"
    assert verdict_of(causes, (("a", "b"),), left) == "ambiguous"
    assert verdict_of((), (), left) == "unknown"
    assert verdict_of((), (), ()) == "nothing"


def test_each_signal_has_a_verdict_of_its_own():
    causes = made.found().causes
    left = [Structure("gyro", Kind.TOO_MUCH, 2.0, ""), Structure("accel_x", Kind.UNEVEN, 2.0, "")]

    def said(name: str) -> str:
        return of_signal(name, causes, (("body_roll", "accel_scale"),), left)

    assert said("accel_y") == "ambiguous"
    assert said("gyro_x") == "unknown"
    assert said("accel_x") == "unknown"
    assert said("lateral_accel") == "nothing"
