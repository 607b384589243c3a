"""Evidence that outlives the process: what is kept of it, and how it comes back."""

from __future__ import annotations

import json
import math
from functools import cache

import numpy as np
import pytest
from msgspec.structs import replace
from scipy.spatial.transform import Rotation

from imucald.core.errors import EstimateError
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.common_errors import common_errors
from imucald.mount.estimate import BETWEEN_DRIVES_STD, MountState
from imucald.mount.estimator import FullEstimator
from imucald.mount.fusion import CommonCovariance, CommonError, fuse
from imucald.mount.restored import Phase, RestoredEstimator, StoredMount
from imucald.mount.road_segments import AngleEvidence, ScoreSeries
from imucald.mount.saved_information import (
    MAX_SEGMENTS,
    PastDrives,
    SavedInformation,
    SavedSource,
    kept_evidence,
    saved_from,
    together,
)
from imucald.runtime.estimators import estimator_for
from simulated_bus import drive, loaded


def rows(seed: int, minutes: float) -> list[list[float]]:
    made = drive(seed, minutes)
    return list(ticks_from_samples(made.samples, 0, int(minutes * 600)).tolist())


def estimator() -> FullEstimator:
    made = estimator_for(loaded().config)
    assert isinstance(made, FullEstimator)
    return made


@cache
def driven() -> FullEstimator:
    """After a drive of eight minutes."""
    first = estimator()
    for row in rows(3, 8.0):
        first.step(row)
    return first


@cache
def stored() -> StoredMount:
    """What that drive leaves."""
    first = driven()
    found, kept = first.estimate(), first.saved_information()
    assert kept is not None
    assert found.R_vehicle_from_sensor is not None
    assert found.covariance is not None
    return StoredMount(
        found.R_vehicle_from_sensor, found.covariance, MountState.USABLE, evidence=kept
    )


def evidence() -> SavedInformation:
    kept = stored().evidence
    assert kept is not None
    return kept


def turned(mount: StoredMount, degrees: tuple[float, float, float]) -> StoredMount:
    """As if the sensor had been turned the other way since, about vehicle axes."""
    R = Rotation.from_rotvec(degrees, degrees=True).as_matrix()
    kept = mount.evidence
    assert kept is not None
    return replace(
        mount,
        R_vehicle_from_sensor=R @ mount.R_vehicle_from_sensor,
        evidence=replace(kept, R=R @ kept.R),
    )


def test_it_says_what_the_estimate_stated():
    """Fused by itself, without what changes between drives, it gives the mount it came from."""
    settings = driven()._settings
    cross_axis = driven()._solver._cross_axis
    assert sum(p for _, p in cross_axis.scales) == pytest.approx(1.0)
    sharing = CommonCovariance(common_errors(settings))
    kept = evidence()
    fused = fuse(kept_evidence(kept), sharing, cross_axis.scales, cross_axis.answers)
    assert np.abs(fused.error).max() < 1e-9
    crown = loaded().config.vehicle.crown_spread_percent / 100.0
    claimed = np.diag(stored().covariance) - [crown**2, 0.0, 0.0]
    creep = driven()._solver.creep
    assert creep is not None
    claimed -= creep.variance
    assert fused.variance == pytest.approx(claimed, rel=1e-6)
    for name, p in kept.sources.items():
        if p.information.sum() > 0.0 and not name.endswith("gravity"):
            assert p.score.sum() / p.information.sum() == pytest.approx(p.value, abs=0.02)


def test_it_comes_back_from_json_and_is_small():
    text = json.dumps(evidence().plain())
    assert len(text) < 16_000
    back = saved_from(json.loads(text))
    assert back.sources.keys() == evidence().sources.keys()
    for name, piece in evidence().sources.items():
        assert back.sources[name].value == piece.value
        assert back.sources[name].score == pytest.approx(piece.score, rel=1e-5)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda c: c.update(rotation=[2.0] * 9),
        lambda c: c.update(rotation=[1, 0, 0, 0, 1, 0, 0, 0, -1]),
        lambda c: c.update(without_speed=1),
        lambda c: c.update(kinds=[]),
        lambda c: c["kinds"].update(yaw_magic=c["kinds"]["yaw_dvdt"]),
        lambda c: c["kinds"]["yaw_dvdt"].update(value=math.nan),
        lambda c: c["kinds"]["yaw_dvdt"].update(value=4.0),
        lambda c: c["kinds"]["yaw_dvdt"].update(variance=0.0),
        lambda c: c["kinds"]["yaw_dvdt"].update(bias=-1.0),
        lambda c: c["kinds"]["yaw_dvdt"].update(score=[1.0]),
        lambda c: c["kinds"]["yaw_dvdt"].update(score=["1"], information=[1.0]),
        lambda c: c["kinds"]["yaw_dvdt"].update(score=[1.0] * 49, information=[1.0] * 49),
        lambda c: c["kinds"]["yaw_dvdt"].update(score=[1.0], information=[-1.0]),
        lambda c: c["kinds"]["yaw_dvdt"].pop("score"),
    ],
)
def test_what_makes_no_sense_is_refused(spoil):
    content = json.loads(json.dumps(evidence().plain()))
    saved_from(content)
    spoil(content)
    with pytest.raises(EstimateError, match="cannot be used"):
        saved_from(content)
    with pytest.raises(EstimateError):
        saved_from([])


def test_however_many_drives_there_were_its_size_is_bounded_and_nothing_is_lost():
    kept = evidence()
    total = sum(p.information.sum() for p in kept.sources.values())
    for n in range(2, 30):
        kept = together(kept, evidence())
        assert max(len(p.score) for p in kept.sources.values()) <= MAX_SEGMENTS
        assert sum(p.information.sum() for p in kept.sources.values()) == pytest.approx(n * total)
    one, many = evidence().sources["yaw_dvdt"], kept.sources["yaw_dvdt"]
    assert many.value == pytest.approx(one.value, abs=1e-9)
    assert many.variance < one.variance
    assert len(json.dumps(kept.plain())) < 24_000


def test_without_speed_is_other_evidence():
    other = replace(evidence(), without_speed=True)
    assert together(other, evidence()) == together(None, evidence())


def test_what_a_turn_about_the_vehicle_does_to_it():
    turn = Rotation.from_rotvec([0.01, -0.02, 0.03]).as_matrix()
    about = evidence().about(turn @ evidence().R)
    for name, axis in (("roll_turn", 0), ("pitch_dvdt", 1), ("yaw_turn", 2)):
        moved = evidence().sources[name].value - about.sources[name].value
        assert moved == pytest.approx((0.01, -0.02, 0.03)[axis], abs=1e-9)


def piece(value: float, variance: float, bias: float = 0.0) -> SavedSource:
    return SavedSource(value, variance, bias, np.zeros(3), np.ones(3))


def prior(shared: tuple[CommonError, ...] = (), **pieces: SavedSource) -> PastDrives:
    return PastDrives(SavedInformation(np.eye(3), False, pieces), shared, 0.0)


def test_load_and_springs_limit_what_earlier_drives_are_worth():
    before = prior(yaw_turn=piece(0.0, 1e-12), yaw_dvdt=piece(0.0, 1e-12))
    fused = before.fused({"yaw_turn": AngleEvidence(0.0, 1.0, 9.0)}, np.eye(3), (0.0, 0.0))
    assert math.sqrt(fused.variance[2]) == pytest.approx(BETWEEN_DRIVES_STD[2], rel=1e-3)


def test_errors_of_the_sensor_and_its_unknown_bias_are_not_averaged_away():
    shared = (CommonError(0.01, {"yaw_turn": 1.0}),)
    before = prior(shared, yaw_turn=piece(0.0, 1e-4), roll_gravity=piece(0.0, 1e-12, 4e-4))
    now = {
        "yaw_turn": AngleEvidence(0.0, 2e-4, 9.0),
        "roll_gravity": AngleEvidence(0.0, 1e-12 + 3e-4, 9.0),
    }
    fused = before.fused(now, np.eye(3), (3e-4, 0.0))
    assert math.sqrt(fused.variance[2]) >= 0.01
    assert fused.variance[0] >= 3e-4


def test_it_contradicts_as_surely_as_the_difference_is_large():
    before = prior((CommonError(0.5, {"yaw_turn": 1.0}),), yaw_turn=piece(0.0, 1e-6))
    for degrees, least, most in ((0.0, 0.0, 1e-9), (0.3, 2.0, 6.0), (1.0, 30.0, 60.0)):
        now = {"yaw_turn": AngleEvidence(math.radians(degrees), 1e-6, 9.0)}
        before.fused(now, np.eye(3), (0.0, 0.0))
        assert least <= before.contradiction <= most, "what both share speaks for neither"


def test_for_the_shift_test_they_count_no_more_than_load_and_springs_let_them():
    random = np.random.default_rng(1)
    n = np.full(40, 1e5)
    score = n * 0.01 + random.normal(0.0, np.sqrt(n))
    before = prior(yaw_turn=SavedSource(0.01, 1e-7, 0.0, score, n))
    now = ScoreSeries("yaw_turn", np.zeros(5), np.full(5, 1e5))
    (one,) = before.series({"yaw_turn": now}, np.eye(3))
    old, level = one.information[:40], one.score[:40].sum() / one.information[:40].sum()
    assert 1.0 / old.sum() == pytest.approx(BETWEEN_DRIVES_STD[2] ** 2 + 1.0 / n.sum())
    assert level == pytest.approx(score.sum() / n.sum())
    spread = [
        ((s - i * s.sum() / i.sum()) ** 2).sum() / i.sum()
        for s, i in ((score, n), (one.score[:40], old))
    ]
    assert spread[1] == pytest.approx(spread[0]), "as rough as the roads were"
    assert (one.score[40:] == now.score).all()


def second_drive(
    mount: StoredMount, minutes: float = 8.0
) -> tuple[RestoredEstimator, set[MountState], bool]:
    restored = RestoredEstimator(estimator(), mount)
    states, joined = set(), False
    for row in rows(3, minutes):
        restored.step(row)
        states.add(restored.state)
        joined = joined or restored.joined
    return restored, states, joined


@pytest.mark.slow
def test_after_a_restart_it_goes_on_from_there():
    restored, states, joined = second_drive(stored())
    assert joined
    assert restored.phase is Phase.NEW
    assert not states & {MountState.SUSPECT, MountState.RECALIBRATING}
    alone = second_drive(replace(stored(), evidence=None))[0].estimate()
    both = restored.estimate()
    assert alone.std is not None
    assert both.std is not None
    assert all(a < b for a, b in zip(both.std, alone.std, strict=True))
    shares = both.details["evidence_share"]
    assert isinstance(shares, dict)
    assert any(name.endswith("_before") for name in shares["yaw"])
    kept = restored.saved_information()
    assert kept is not None
    sums = [k.sources["yaw_turn"].information.sum() for k in (evidence(), kept)]
    assert sums[1] > 1.5 * sums[0], "the next start has both drives"


@pytest.mark.parametrize("degrees", [(3.0, 0.0, 0.0), (0.0, 2.0, 0.0), (0.0, 0.0, -2.0)])
def test_a_sensor_moved_a_little_while_parked_is_found_out(degrees):
    restored, states, _ = second_drive(turned(stored(), degrees), 10.0)
    assert MountState.SUSPECT in states
    assert not restored.joined, "what was before is left"
    true = drive(3, 10.0).truth.mounts[0][1]
    R = restored.estimate().R_vehicle_from_sensor
    assert R is not None
    assert np.degrees(Rotation.from_matrix(true @ R.T).magnitude()) < 1.2
