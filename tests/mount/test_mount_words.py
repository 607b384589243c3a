"""One convention for "±", and reasons that are said once."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.config.vehicle import VehicleSettings
from imucald.core.samples import GRAVITY
from imucald.mount.contradictions import WORDS, StandingFault
from imucald.mount.estimate import MountEstimate, MountState
from imucald.mount.estimator_settings import LEVEL, EstimatorSettings
from imucald.mount.explanation import LevelChange, mount_troubles
from imucald.mount.mount_words import (
    change_words,
    half_width,
    how_it_sits,
    left_out_words,
    mirror_note,
    moved_words,
    plus_minus,
    reasons_line,
    steep_note,
)
from imucald.runtime.summary import mount_dict
from imucald.service.running_status import status_line

DEG = math.radians(1.0)


def estimate(angles=(0.0, 0.0, 0.0), std=(0.5, 0.4, 0.3), state=MountState.USABLE, **more):
    R = Rotation.from_euler("ZYX", angles[::-1], degrees=True).as_matrix()
    return MountEstimate(state, R, np.diag((np.array(std) * DEG) ** 2), **more)


def test_an_interval_of_95_percent_is_two_deviations_and_holds_as_often():
    rng = np.random.default_rng(2)
    inside = np.abs(rng.normal(0.0, 0.7, 200_000)) <= half_width(0.7)
    assert inside.mean() == pytest.approx(0.9545, abs=0.002)
    assert plus_minus(0.355) == "±0.71°"
    assert plus_minus(0.355, 1, unit="") == "±0.7"
    assert plus_minus(None) == plus_minus(90.0) == plus_minus(math.inf) == "-"


def test_sizes_of_gravity_stand_behind_what_they_belong_to():
    faults = [StandingFault.ACCEL_LEVEL, StandingFault.NUMERICS]
    level = LevelChange(9.78, 10.13)
    text = mount_troubles(MountState.SUSPECT, faults, {}, (), level)["yaw"]
    sized = f"{WORDS[StandingFault.ACCEL_LEVEL]} (9.78 to 10.13 m/s^2)"
    assert text == f"{sized}; {WORDS[StandingFault.NUMERICS]}"


def test_roll_has_the_roads_crown_in_interval_and_target():
    settings = EstimatorSettings(vehicle=VehicleSettings(driving_side="right"))
    x, y, z = settings.targets.fine
    assert (y, z) == (settings.limits.fine_tilt, settings.limits.fine_yaw)
    assert math.degrees(x) == pytest.approx(
        math.hypot(math.degrees(LEVEL[1] / GRAVITY), math.degrees(0.0065)), rel=1e-3
    )


def test_the_json_has_words_targets_and_the_deviations_as_before():
    found = mount_dict(estimate(targets=EstimatorSettings().limits.about_axes()))
    assert found["sits"] == "x points forward; y points left; z points up"
    assert found["steep"] is None
    assert found["std_deg"] == {"x": 0.5, "y": 0.4, "z": 0.3}
    assert found["target_std_deg"]["fine"]["z"] == pytest.approx(0.3)
    assert found["target_std_deg"]["usable"]["y"] == pytest.approx(1.1685)
    assert mount_dict(MountEstimate(MountState.WAITING))["sits"] is None


def test_a_heading_that_is_not_known_is_not_stated():
    words = how_it_sits(estimate((0, 20, 50), std=(1.0, 1.0, 104.0)))
    assert words is not None
    assert "which way is forward is not known yet" in words
    assert "left" not in words


def test_only_a_steep_mount_has_the_note():
    assert steep_note(estimate((0, 69, 0))) is None
    for pitch in (71, -88):
        note = steep_note(estimate((10, pitch, 20)))
        assert note is not None
        assert "quaternion" in note


def test_only_a_mount_upside_down_and_backwards_that_nothing_confirmed_has_a_note():
    unconfirmed = {"not_checked": ["inverted signs of the whole accelerometer"]}
    for angles in ((5, 180, -10), (-150, 14, -174), (180, 0, 170)):
        note = mirror_note(estimate(angles, details=unconfirmed))
        assert note is not None, angles
        assert "sign: -1" in note
        assert "If it is, write 'calibration: {orientation: {up: -z}}'" in note
        assert mirror_note(estimate(angles, details={"not_checked": []})) is None
    for angles in ((0, 0, 0), (180, 0, 0), (0, 0, 180), (10, 40, 90)):
        assert mirror_note(estimate(angles, details=unconfirmed)) is None, angles
    # as long as forward is not known, nobody can say backwards
    assert mirror_note(estimate((0, 180, 0), (1.0, 1.0, 104.0), details=unconfirmed)) is None


def test_equal_reasons_are_stated_once_and_troubles_apart():
    waiting = {"roll": "a standstill", "pitch": "a standstill", "yaw": "more driving"}
    assert reasons_line(waiting) == "waiting for roll, pitch: a standstill; yaw: more driving"
    trouble = next(iter(WORDS.values()))
    assert reasons_line(dict.fromkeys(("roll", "pitch", "yaw"), trouble)) == trouble
    assert reasons_line({}) == ""


def test_the_line_for_systemd_has_now_target_and_words():
    line = status_line(
        estimate(
            (5, 0, -10.6),
            (0.5, 0.4, 0.35),
            targets=EstimatorSettings().targets,
            waiting_for={"yaw": "more driving"},
        ),
        "up",
    )
    assert line.startswith("usable; roll +5.00 ±0.99°; ")
    assert (
        "yaw -10.60 ±0.70°; ± 95 %; still needed for fine: error about the up axis below "
        "±0.60° (now ±0.70°);" in line
    )
    assert "pitch -0.00 ±0.81°;" in line or "pitch +0.00 ±0.81°;" in line
    assert "± 95 %" in line
    assert "x points forward, 11 deg right" in line
    assert line.endswith("waiting for yaw: more driving")
    assert status_line(MountEstimate(MountState.WAITING), "down") == "bus down; waiting"


@pytest.mark.parametrize(
    ("turn", "words"),
    [
        (None, "the drive shows +3.6 deg about the forward axis"),
        ([0.4, 9.9, -0.8], "by +9.9 deg about the left axis"),
        ([0.02, 0.0, -0.03], "by less than 0.1 deg"),
        ([6.0, -8.0, 0.0], "by 10.0 deg (+6.0, -8.0, +0.0 about x, y, z)"),
    ],
)
def test_a_moved_sensor_is_said_by_the_mounts_before_and_after_where_both_are_known(turn, words):
    shift = {"t": 5.0, "angle": "roll", "size_deg": 3.6, "turn_deg": turn}
    assert moved_words(shift) == words


def test_a_change_within_its_interval_is_worded_as_evidence_and_not_as_a_move():
    borne = {"t": 5.0, "angle": "yaw", "size_deg": 0.3, "turn_deg": None, "within_deg": 1.0}
    expected = "the evidence of yaw changed by +0.3 deg, within ±1.0 deg: the interval was widened"
    assert change_words(borne) == expected
    assert change_words(borne | {"within_deg": None}).startswith("the sensor was found moved: ")


def test_data_that_were_not_used_are_named_in_words_once():
    causes = [("speed", "speed_jump", 235.0), ("speed", "no valid samples", 4.0),
              ("yaw_rate", "stuck", 12.0), ("accel", "saturated", 0.2)]  # fmt: skip
    left = [{"signal": s, "cause": c, "seconds": t} for s, c, t in causes]
    assert left_out_words({"not_learnt_from": left}) == (
        "235 s (speed jumps), 4 s (no valid speed sample), 12 s (yaw rate stuck)"
    )
