"""Manoeuvres, sign votes, states and the slewed rotation of the published solver, each alone."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.core.rotations import levelling_rotation, rotation_from_angles, vector_from_rotation
from imucald.motion.speed import SpeedInterval
from imucald.mount.estimate import Correction, Missing, MountState
from imucald.mount.method_a.levelling import Tilt
from imucald.mount.method_a.settings import PublishedSettings
from imucald.mount.method_a.sign import VOTES_NEEDED, SignEvidence, SignVotes
from imucald.mount.method_a.states import TiltAndAngle, judged, waiting_for
from imucald.mount.method_a.target_angle import (
    FLOOR_STD,
    CombinedAngle,
    Manoeuvre,
    ManoeuvreBook,
    combined,
    combined_axis,
)
from imucald.mount.slewing import SlewedCorrection

DEG = math.radians(1.0)
G = 9.80665


def book_of(mount: Rotation, motions: list[list[tuple[float, float]]]) -> ManoeuvreBook:
    """Manoeuvres whose intervals are (dv/dt, v r); force is exactly theirs, in sensor axes."""
    book = ManoeuvreBook(100)
    for intervals in motions:
        m = Manoeuvre(0.0, signed=True)
        for dvdt, lateral in intervals:
            f = mount.inv().apply([dvdt, lateral, 0.0]).tolist()
            m.add_interval(interval(0.0), f, dvdt, lateral, 0.7)
        book.add_manoeuvre(m)
    return book


@pytest.mark.parametrize("euler", [(0.3, 0.1, -0.2), (-2.5, 0.9, 2.8), (1.0, 0.0, 3.1)])
def test_manoeuvres_with_lateral_acceleration_give_the_exact_target_angle(
    euler: tuple[float, float, float],
) -> None:
    mount = Rotation.from_euler("ZYX", euler)
    level = levelling_rotation(mount.inv().apply([0.0, 0.0, G]))
    book = book_of(mount, [[(1.5, 0.4), (0.8, 0.2)], [(-2.0, 0.3)], [(-1.0, -0.5)]])
    lam = combined(book.pointers(level))
    assert lam is not None
    R = Rotation.from_euler("Z", lam.value) * Rotation.from_matrix(level)
    assert np.degrees((R * mount.inv()).magnitude()) < 1e-6


def test_the_axis_of_the_same_manoeuvres_is_the_angle_up_to_a_half_turn() -> None:
    mount = Rotation.from_euler("ZYX", [2.6, 0.3, 0.2])
    level = levelling_rotation(mount.inv().apply([0.0, 0.0, G]))
    book = book_of(mount, [[(1.5, 0.0)], [(-2.0, 0.0)]])
    lam, axis = combined(book.pointers(level)), combined_axis(book.axis_pointers(level))
    assert lam is not None
    assert axis is not None
    assert math.sin(lam.value - axis.value) == pytest.approx(0.0, abs=1e-9)


def pointers(angles_deg: list[float], sizes: list[float] | None = None) -> np.ndarray:
    return np.array(sizes or [1.0] * len(angles_deg)) * np.exp(1j * np.radians(angles_deg))


def test_one_manoeuvre_that_disagrees_does_not_decide() -> None:
    alone = combined(pointers([0.0, 1.0, -1.0, 0.5, -0.5]))
    joined = combined(pointers([0.0, 1.0, -1.0, 0.5, -0.5, 80.0]))
    assert alone is not None
    assert joined is not None
    assert abs(math.degrees(joined.value)) < 1.5, "a plain mean would be off by 13 deg"
    assert joined.std > alone.std


def test_the_interval_holds_the_truth_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(5)
    inside = 0
    for _ in range(300):
        found = combined(
            pointers(rng.normal(0.0, 5.0, 12).tolist(), rng.uniform(1, 3, 12).tolist())
        )
        assert found is not None
        inside += abs(found.value) < 1.96 * found.std
    assert 0.90 <= inside / 300 <= 0.99


def test_few_manoeuvres_are_not_believed_even_where_they_agree() -> None:
    two, many = combined(pointers([3.0, 3.0])), combined(pointers([3.0] * 40))
    assert two is not None
    assert many is not None
    assert two.std > 1.5 * DEG
    assert FLOOR_STD < many.std < 0.5 * DEG
    assert combined(pointers([])) is None


def test_votes_decide_only_by_a_clear_lead() -> None:
    votes = SignVotes()
    ahead, back = (1.0, 0.2, 0.0), (-1.0, 0.1, 0.0)
    for k in range(VOTES_NEEDED):
        assert votes.sign((1.0, 0.0, 0.0)) == 0.0, k
        votes.add_vote("brake", ahead)
    assert votes.sign((1.0, 0.0, 0.0)) == 1.0
    assert votes.sign((-1.0, 0.0, 0.0)) == -1.0
    assert votes.sign((0.0, 1.0, 0.0)) == 0.0, "across the axis tells nothing"
    votes.add_vote("brake", back)
    assert votes.sign((1.0, 0.0, 0.0)) == 0.0
    for _ in range(20):
        votes.add_vote("brake", ahead)
    assert votes.sign((1.0, 0.0, 0.0)) == 1.0


def interval(t: float, yaw_rate: float = 0.0) -> SpeedInterval:
    return SpeedInterval(t, t + 0.5, 0.0, 0.0, G, math.nan, math.nan, yaw_rate, True)


UP = (0.0, 0.0, 1.0)


def evidence(kind: str, reverse: bool) -> dict[str, object]:
    """Show one piece of evidence of a sensor in vehicle axes; return what was voted for +x."""
    e = SignEvidence(("brake", "turn", "first_motion"))
    flip = -1.0 if reverse else 1.0
    for _ in range(VOTES_NEEDED):
        if kind == "first_motion":
            e.depart(0.0)
            for k in range(6):
                e.take_straight(interval(0.5 * k), (flip * 1.5, 0.1, 0.0), UP, reverse, False)
        elif kind == "brake":
            for k in range(4):
                e.take_straight(
                    interval(100.0 + 0.5 * k), (flip * -1.5, 0.1, 0.0), UP, reverse, True
                )
        elif kind == "turn":
            for k in range(6):
                e.take_turn(interval(0.5 * k, 0.3), (0.0, 3.0, 0.0), UP, reverse)
            e.take_turn(interval(4.0, 0.0), (0.0, 0.0, 0.0), UP, reverse)
    return {"counts": dict(e.votes.counts), "sign": e.votes.sign((1.0, 0.0, 0.0))}


@pytest.mark.parametrize("kind", ["first_motion", "brake", "turn"])
def test_each_source_of_sign_works_alone(kind: str) -> None:
    assert evidence(kind, reverse=False) == {"counts": {kind: VOTES_NEEDED}, "sign": 1.0}


def test_reverse_gear_is_allowed_for() -> None:
    assert evidence("first_motion", reverse=True)["sign"] == 1.0
    assert evidence("brake", reverse=True)["sign"] == 1.0
    assert evidence("turn", reverse=True)["counts"] == {}


def test_a_source_that_is_switched_off_does_not_vote() -> None:
    e = SignEvidence(("turn",))
    for k in range(8):
        e.take_straight(interval(0.5 * k), (-2.0, 0.0, 0.0), UP, False, True)
    assert e.votes.counts == {}


SETTINGS = PublishedSettings()


def known(
    yaw_std: float, tilt_std: float = 0.8, manoeuvres: int = 20, sign: bool = True
) -> TiltAndAngle:
    return TiltAndAngle(
        Tilt(UP, tilt_std * DEG, 5),
        CombinedAngle(0.1, yaw_std * DEG, manoeuvres),
        sign,
        5,
        manoeuvres,
    )


def test_states_climb_and_are_left_with_hysteresis() -> None:
    def after(before: MountState, k: TiltAndAngle) -> MountState:
        return judged(k, before, SETTINGS)

    assert after(MountState.WAITING, TiltAndAngle()) == MountState.WAITING
    assert after(MountState.WAITING, TiltAndAngle(tilt=Tilt(UP, DEG, 1))) == MountState.LEVELLED
    assert after(MountState.LEVELLED, known(3.1)) == MountState.LEVELLED
    assert after(MountState.LEVELLED, known(2.9)) == MountState.USABLE
    assert after(MountState.USABLE, known(3.1)) == MountState.USABLE
    assert after(MountState.USABLE, known(4.3)) == MountState.SUSPECT
    assert after(MountState.SUSPECT, known(3.1)) == MountState.SUSPECT
    assert after(MountState.SUSPECT, known(2.9)) == MountState.USABLE
    assert after(MountState.USABLE, known(0.9)) == MountState.FINE
    assert after(MountState.FINE, known(1.3)) == MountState.FINE
    assert after(MountState.FINE, known(1.5)) == MountState.USABLE


def test_each_condition_alone_keeps_from_usable() -> None:
    for k in (known(1.0, tilt_std=2.6), known(1.0, manoeuvres=2), known(1.0, sign=False)):
        assert judged(k, MountState.LEVELLED, SETTINGS) == MountState.LEVELLED


def test_waiting_for_names_one_thing_per_angle() -> None:
    nothing = waiting_for(TiltAndAngle(), SETTINGS)
    assert nothing["pitch"] == ("a standstill of 2 s", Missing.STANDSTILL)
    assert set(nothing) == {"roll", "pitch", "yaw"}
    few = waiting_for(TiltAndAngle(Tilt(UP, 0.9 * DEG, 3), None, False, 3, 1), SETTINGS)
    assert few == {
        "yaw": (
            "straight acceleration above 0.8 m/s2 (1 of 3 seen)",
            Missing.ACCELERATION,
        )
    }
    sign = waiting_for(known(0.5, sign=False), SETTINGS)
    assert sign["yaw"][1] == Missing.DIRECTION_OF_TRAVEL
    spread = waiting_for(known(5.0), SETTINGS)
    assert spread["yaw"][1] == Missing.AGREEMENT
    assert waiting_for(known(0.5), SETTINGS) == {}


def turn_of(a: Correction, b: Correction) -> float:
    A, B = (m.matrix() for m in (a, b))
    return float(np.degrees(np.linalg.norm(vector_from_rotation(A @ B.T))))


def test_the_applied_rotation_turns_at_a_limited_rate_and_arrives() -> None:
    slewed = SlewedCorrection(rate=0.5 * DEG)
    slewed.move_on()
    assert slewed.correction is None
    slewed.aim(Correction.turning(rotation_from_angles(0.1, -0.2, 0.3)))
    assert slewed.correction is not None, "the first answer is taken at once"
    goal = Correction.turning(rotation_from_angles(0.1, -0.2, 0.3 + 2.0 * DEG))
    slewed.aim(goal)
    steps = 0
    while turn_of(slewed.correction, goal) > 1e-9:
        before = slewed.correction
        slewed.move_on()
        assert turn_of(slewed.correction, before) <= 0.05 + 1e-9
        steps += 1
    assert steps == 40
    R = slewed.correction.matrix()
    assert pytest.approx(np.eye(3), abs=1e-12) == R @ R.T


def test_another_answer_is_taken_at_once() -> None:
    slewed = SlewedCorrection(rate=0.5 * DEG)
    goal = Correction.turning(rotation_from_angles(0.0, 0.0, math.pi))
    slewed.aim(Correction.turning(np.eye(3)))
    slewed.aim(goal)
    slewed.move_on()
    assert turn_of(slewed.correction, goal) < 1e-6


def test_manoeuvres_of_two_minds_are_not_averaged_with_confidence() -> None:
    found = combined(pointers([0.0] * 30 + [180.0] * 15))
    assert found is not None
    assert found.std > 40.0 * DEG
