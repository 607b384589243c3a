"""A stored mount serves at once, as restored, and gives way to new evidence as it should."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimate import (
    ANGLES,
    Correction,
    Gate,
    Missing,
    MountEstimate,
    MountState,
    Progress,
)
from imucald.mount.method_a.estimator import PublishedEstimator
from imucald.mount.mount_in_force import mount_in_force
from imucald.mount.restored import HAND_OVER_RATE, Phase, RestoredEstimator, StoredMount
from imucald.runtime.drive_events import reported_events
from imucald.runtime.estimators import estimator_for
from published_drive import Drive
from simulated_bus import drive, loaded

STORED = Rotation.from_euler("ZYX", [30.0, -5.0, 2.0], degrees=True)
TICK = (0.0,) * 64


def turned(yaw_deg: float = 0.0, pitch_deg: float = 0.0) -> Rotation:
    """The stored mount turned about the vehicle's axes."""
    return Rotation.from_rotvec([0.0, math.radians(pitch_deg), math.radians(yaw_deg)]) * STORED


class Scripted:
    """An estimator that says what it is told to."""

    def __init__(self) -> None:
        self.gaps = 0
        self.say(MountState.WAITING, None, 0.0)

    def say(self, state: MountState, mount: Rotation | None, std_deg: float) -> None:
        self.state = state
        R = None if mount is None else mount.as_matrix()
        covariance = None if mount is None else np.eye(3) * math.radians(std_deg) ** 2
        self.answer = MountEstimate(state, R, covariance)
        good = state in {MountState.USABLE, MountState.FINE}
        self.correction = Correction.turning(R) if good and R is not None else None

    def step(self, tick) -> None:
        pass

    def gap(self) -> None:
        self.gaps += 1

    def estimate(self) -> MountEstimate:
        return self.answer


def restored(std_deg: float = 0.3, doubted: bool = False) -> tuple[RestoredEstimator, Scripted]:
    inner = Scripted()
    covariance = np.eye(3) * math.radians(std_deg) ** 2
    stored = StoredMount(STORED.as_matrix(), covariance, MountState.FINE, doubted)
    return RestoredEstimator(inner, stored), inner


def run(estimator: RestoredEstimator, seconds: float) -> None:
    for _ in range(round(seconds * 10)):
        estimator.step(TICK)


def degrees_from(estimator: RestoredEstimator, mount: Rotation) -> float:
    assert estimator.correction is not None
    now = Rotation.from_matrix(estimator.correction.matrix())
    return math.degrees((now * mount.inv()).magnitude())


def test_it_is_usable_at_once_and_says_that_it_is_restored():
    estimator, _ = restored()
    assert degrees_from(estimator, STORED) < 1e-9
    assert estimator.state is MountState.RESTORED
    estimate = estimator.estimate()
    assert estimate.state is MountState.RESTORED
    assert np.allclose(estimate.R_vehicle_from_sensor, STORED.as_matrix())
    assert all(math.degrees(s) >= 0.3 for s in estimate.std)
    run(estimator, 3600.0)  # a drive without evidence confirms nothing
    assert estimator.state is MountState.RESTORED


def test_a_mount_that_is_fine_from_before_waits_for_nothing():
    """The drive's own estimate may wait for more; what is served does not."""
    estimator, inner = restored()
    inner.say(MountState.USABLE, STORED, 1.0)
    inner.answer = replace(
        inner.answer,
        waiting_for={"yaw": "more driving"},
        missing={"yaw": Missing.MORE_DRIVING},
        progress=Progress(MountState.FINE, (Gate("up axis", 0.5),)),
    )
    assert estimator.estimate().progress is not None, "restored: the drive is to confirm it"
    run(estimator, 3.0)
    found = estimator.estimate()
    assert found.state is MountState.FINE
    assert (found.waiting_for, found.missing, found.progress) == ({}, {}, None)


def test_agreement_confirms_it_only_when_the_new_estimate_can_be_used():
    estimator, inner = restored()
    inner.say(MountState.LEVELLED, turned(0.2), 1.0)
    run(estimator, 60.0)
    assert estimator.phase is Phase.RESTORED
    inner.say(MountState.USABLE, turned(0.2), 1.0)
    run(estimator, 2.0)
    assert estimator.phase is Phase.CONFIRMED
    assert estimator.state is MountState.FINE  # as it was when it was stored
    assert degrees_from(estimator, STORED) < 1e-9


def test_the_new_estimate_takes_over_when_it_is_as_certain_and_without_a_jump():
    estimator, inner = restored()
    inner.say(MountState.FINE, turned(0.5), 0.1)
    before, angles = STORED, []
    for _ in range(40):
        estimator.step(TICK)
        angles.append(math.radians(degrees_from(estimator, before)))
        before = Rotation.from_matrix(estimator.correction.matrix())
    assert max(angles) <= HAND_OVER_RATE * 0.1 + 1e-9
    assert estimator.phase is Phase.NEW
    assert estimator.correction == inner.correction
    assert estimator.state is MountState.FINE


def test_contradiction_makes_it_suspect_and_the_new_estimate_replaces_it():
    estimator, inner = restored()
    inner.say(MountState.LEVELLED, turned(pitch_deg=8.0), 1.0)
    run(estimator, 4.0)
    assert estimator.state is MountState.RESTORED  # one bad road is no remount
    run(estimator, 20.0)
    assert estimator.state is MountState.SUSPECT
    assert degrees_from(estimator, STORED) < 1e-9  # the last good one
    inner.say(MountState.USABLE, turned(pitch_deg=8.0), 1.0)
    run(estimator, 3.0)
    assert estimator.state is MountState.SUSPECT
    assert 0.5 < degrees_from(estimator, STORED) < 3.0  # on its way
    run(estimator, 10.0)
    assert estimator.state is MountState.USABLE
    assert degrees_from(estimator, turned(pitch_deg=8.0)) < 1e-9


@pytest.mark.parametrize(("is_given", "degrees"), [(True, 8.0), (True, 20.0), (False, 8.0)])
def test_a_statement_that_the_drive_contradicts_is_called_so_with_the_angle(is_given, degrees):
    inner = Scripted()
    covariance = np.diag(np.full(3, math.radians(0.2) ** 2))
    stored = StoredMount(STORED.as_matrix(), covariance, MountState.FINE, is_given=is_given)
    estimator = RestoredEstimator(inner, stored)
    inner.say(MountState.LEVELLED, turned(pitch_deg=degrees), 1.0)
    run(estimator, 30.0)
    estimate = estimator.estimate()
    assert estimate.state is MountState.SUSPECT
    assert estimate.details["restored"]["turned_deg"] == pytest.approx(degrees)
    says_so = f"stated mount does not fit this drive: it is off by {degrees:g} "
    assert all((says_so in text) is is_given for text in estimate.waiting_for.values())
    assert bool(estimate.waiting_for) or not is_given
    inner.say(MountState.LEVELLED, turned(0.1), 1.0)
    run(estimator, 2.0)
    assert estimator.estimate().details["restored"]["turned_deg"] is None


@pytest.mark.parametrize("is_given", [True, False])
def test_a_mount_that_was_contradicted_is_reported_also_once_the_new_one_serves(is_given):
    inner = Scripted()
    covariance = np.diag(np.full(3, math.radians(0.2) ** 2))
    stored = StoredMount(STORED.as_matrix(), covariance, MountState.FINE, is_given=is_given)
    estimator = RestoredEstimator(inner, stored)
    run(estimator, 60.0)
    inner.say(MountState.USABLE, turned(pitch_deg=8.0), 0.5)
    run(estimator, 60.0)
    assert estimator.phase is Phase.NEW
    details = estimator.estimate().details
    assert details["restored"]["contradicted"]["t"] == pytest.approx(68.0, abs=2.0)
    assert details["restored"]["contradicted"]["turned_deg"] == pytest.approx(8.0)
    (event,) = reported_events({"details": details})
    whose = "stated mount" if is_given else "mount of an earlier drive"
    wrong = "does not fit this drive: it is off by 8 deg"
    assert event.text == f"the {whose} {wrong}"


def test_a_drive_that_has_faults_of_its_own_contradicts_nothing_that_is_reported():
    estimator, inner = restored()
    inner.say(MountState.LEVELLED, turned(pitch_deg=8.0), 1.0)
    inner.answer = replace(inner.answer, faults=("speed_unit",))
    run(estimator, 30.0)
    assert estimator.phase is Phase.DOUBTED
    assert estimator.estimate().details["restored"]["contradicted"] is None


def test_the_reason_of_a_doubt_goes_along_with_the_mount_until_the_drive_confirms_it():
    estimator, inner = restored(doubted=True)
    estimator.stored = replace(estimator.stored, doubt="the mount creeps")
    in_force = mount_in_force(estimator)
    assert in_force is not None
    assert (in_force.doubted, in_force.doubt) == (True, "the mount creeps")
    inner.say(MountState.USABLE, STORED, 1.0)
    run(estimator, 10.0)
    in_force = mount_in_force(estimator)
    assert in_force is not None
    assert (in_force.doubted, in_force.doubt) == (False, "")


def test_a_doubt_that_the_drive_takes_back_is_not_reported():
    estimator, inner = restored()
    inner.say(MountState.LEVELLED, turned(pitch_deg=8.0), 1.0)
    run(estimator, 30.0)
    assert estimator.estimate().details["restored"]["contradicted"] is not None
    inner.say(MountState.USABLE, STORED, 1.0)
    run(estimator, 10.0)
    assert estimator.state is MountState.FINE
    assert estimator.estimate().details["restored"]["contradicted"] is None


def test_a_statement_is_not_called_wrong_where_the_drive_agrees_with_it_and_doubts_itself():
    inner = Scripted()
    covariance = np.diag(np.full(3, math.radians(0.2) ** 2))
    stored = StoredMount(STORED.as_matrix(), covariance, MountState.FINE, is_given=True)
    estimator = RestoredEstimator(inner, stored)
    inner.say(MountState.USABLE, STORED, 1.0)
    run(estimator, 30.0)
    inner.say(MountState.SUSPECT, STORED, 1.0)
    own = dict.fromkeys(ANGLES, "the mount has moved by 2.0 deg in this drive")
    inner.answer = replace(inner.answer, waiting_for=own)
    run(estimator, 30.0)
    estimate = estimator.estimate()
    assert estimate.state is MountState.SUSPECT
    assert estimate.waiting_for == own


def test_once_the_drives_own_mount_serves_nothing_is_turned_against_it():
    estimator, inner = restored()
    inner.say(MountState.USABLE, turned(pitch_deg=8.0), 0.1)
    run(estimator, 16.0)
    assert estimator.phase is Phase.HANDING_OVER
    assert estimator.estimate().details["restored"]["turned_deg"] == pytest.approx(8.0)
    run(estimator, 20.0)
    assert estimator.phase is Phase.NEW
    assert estimator.estimate().details["restored"]["turned_deg"] is None


def test_what_was_suspect_when_it_was_stored_is_suspect_until_confirmed():
    estimator, inner = restored(doubted=True)
    assert estimator.state is MountState.SUSPECT
    inner.say(MountState.USABLE, turned(0.1), 1.0)
    run(estimator, 2.0)
    assert estimator.phase is Phase.CONFIRMED


def test_an_estimate_with_open_yaw_neither_confirms_nor_contradicts_yaw():
    estimator, inner = restored()
    inner.say(MountState.LEVELLED, turned(120.0), 1.0)
    wide = np.diag([math.radians(1.0) ** 2, math.radians(1.0) ** 2, (math.pi / 2) ** 2])
    inner.answer = MountEstimate(MountState.LEVELLED, turned(120.0).as_matrix(), wide)
    run(estimator, 100.0)
    assert estimator.phase is Phase.RESTORED


def test_a_new_estimate_that_fails_while_taking_over_is_left_again():
    estimator, inner = restored()
    inner.say(MountState.FINE, turned(0.9), 0.1)
    run(estimator, 1.2)
    assert estimator.phase is Phase.HANDING_OVER
    inner.say(MountState.WAITING, None, 0.0)
    run(estimator, 1.0)
    assert estimator.state is MountState.SUSPECT
    assert estimator.correction is not None


def test_a_gap_is_passed_on():
    estimator, inner = restored()
    estimator.gap()
    assert inner.gaps == 1


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(list(MountState)[:6]), st.floats(-170, 170)), max_size=8))
def test_there_is_always_a_correction_and_it_is_a_rotation(script):
    estimator, inner = restored()
    for state, yaw in script:
        inner.say(state, None if state is MountState.WAITING else turned(yaw), 0.5)
        run(estimator, 4.0)
        if estimator.phase is Phase.NEW:
            break
        R = estimator.correction.matrix()
        assert np.allclose(R @ R.T, np.eye(3), atol=1e-9)
        assert np.linalg.det(R) > 0


@pytest.mark.parametrize(("moved_deg", "states"), [(0.0, {0}), (25.0, {0, 4})])
def test_on_a_drive_with_the_published_solver(moved_deg: float, states: set[int]):
    true = Rotation.from_euler("ZYX", [40.0, 3.0, -4.0], degrees=True)
    before = Rotation.from_rotvec([0.0, 0.0, math.radians(moved_deg)]) * true
    stored = StoredMount(before.as_matrix(), np.eye(3) * math.radians(0.7) ** 2)
    estimator = RestoredEstimator(PublishedEstimator(), stored)
    seen = set()
    for row in Drive(minutes=12.0, mount=true).ticks():
        estimator.step(row)
        assert estimator.correction is not None
        seen.add(estimator.state)
    assert (MountState.SUSPECT in seen) == (4 in states)
    assert MountState.RESTORED in seen
    assert estimator.state in {MountState.USABLE, MountState.FINE}
    assert degrees_from(estimator, true) < 2.5


@pytest.mark.parametrize("moved_deg", [0.0, 8.0])
def test_on_a_drive_with_the_full_estimator(moved_deg: float):
    made = drive()
    true = made.truth.mounts[0][1]
    R = Rotation.from_rotvec([0.0, 0.0, math.radians(moved_deg)]).as_matrix() @ true
    stored = StoredMount(R, np.eye(3) * math.radians(0.25) ** 2, MountState.FINE)
    estimator = RestoredEstimator(estimator_for(loaded().config), stored)
    phases = set()
    for row in ticks_from_samples(made.samples, 0, 2400).tolist():
        estimator.step(row)
        phases.add(estimator.phase)
    assert (Phase.DOUBTED in phases) == (moved_deg > 0.0)
    assert (Phase.CONFIRMED in phases) == (moved_deg == 0.0)
    assert degrees_from(estimator, Rotation.from_matrix(true)) < 2.0


class KnowingTheSensor(Scripted):
    """One that compares the mount with that of the earlier drive."""

    contradiction: float | None = None
    was_left = False

    def leave_mount(self) -> None:
        self.was_left, self.contradiction = True, None

    def known_sensor(self) -> None:
        return None

    def take_known_sensor(self, known: object, is_moved: bool) -> None:
        pass

    def take_stated_mount(self, R: object) -> None:
        pass


def knowing() -> tuple[RestoredEstimator, KnowingTheSensor]:
    inner = KnowingTheSensor()
    stored = StoredMount(STORED.as_matrix(), np.eye(3) * math.radians(0.3) ** 2, MountState.FINE)
    return RestoredEstimator(inner, stored), inner


@pytest.mark.parametrize(
    ("distance", "phase"),
    [(None, Phase.CONFIRMED), (9.0, Phase.CONFIRMED), (30.0, Phase.DOUBTED)],
)
def test_an_estimator_that_knows_the_sensor_says_whether_all_is_as_before(
    distance: float | None, phase: Phase
) -> None:
    estimator, inner = knowing()
    inner.contradiction = distance
    inner.say(MountState.USABLE, turned(0.5), 1.0)  # both may share an error: they seem to agree
    run(estimator, 9.0)
    assert estimator.phase is phase


def test_a_mount_that_is_contradicted_only_after_the_new_one_serves_is_suspect_and_then_left() -> (
    None
):
    estimator, inner = knowing()
    inner.contradiction = 5.0
    inner.say(MountState.USABLE, turned(0.5), 0.1)
    run(estimator, 9.0)
    assert estimator.phase is Phase.NEW
    inner.contradiction = 30.0
    run(estimator, 9.0)
    assert estimator.state is MountState.SUSPECT
    assert not inner.was_left, "one bad road is no remount"
    run(estimator, 9.0)
    assert inner.was_left
    assert estimator.state is MountState.USABLE
