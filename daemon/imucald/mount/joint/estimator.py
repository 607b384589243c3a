"""The joint estimator: the response of both sensors to the vehicle's motion, with a matrix each.

The joint estimator uses the same blocks of even signals, the same detectors of faults and of large
moves, and the same models of a creeping mount as the full estimator. The joint estimator finds
smaller moves itself (`moves`). The applied correction, the stated deviations and the time when it
is good come from the joint solution (`evidence`). Without a gyroscope, that solution uses the
vehicle's yaw rate or steering angle. Without a speed there is no joint solution, and the full
estimator's own is served.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np
from msgspec.structs import replace

from imucald.core.arrays import Array
from imucald.core.rotations import orthonormalised, rotation_from_vector
from imucald.core.samples import GRAVITY
from imucald.mount.acceptance import WATCH, Acceptance
from imucald.mount.contradictions import StandingFault
from imucald.mount.creep import Creep
from imucald.mount.estimate import Correction, MountEstimate, SentDeviations
from imucald.mount.estimator import FullEstimator
from imucald.mount.estimator_settings import EstimatorSettings, Limits
from imucald.mount.joint.drift import NONE as NO_DRIFT
from imucald.mount.joint.drift import Drift
from imucald.mount.joint.evidence import MIDDLES, Block, Evidence, Solution
from imucald.mount.joint.known import CHANCE_AS_BEFORE, KnownSensor
from imucald.mount.joint.moves import Move
from imucald.mount.joint.state import PHI, OtherSignals, Priors
from imucald.mount.mount_changes import MountChange, blocks_since
from imucald.mount.signal_blocks import BLOCK_S, SignalBlock
from imucald.mount.states import NEEDED, MountKnowledge

SOLUTIONS_KEPT = 32
"""Number of solutions kept: those of the first three minutes; later ones are further apart."""
MOVE_UNSEEN_S = 60.0
"""The found time of a move is exact to one or two blocks, and too late for a slow move. Blocks
within this time before it may therefore contain a part of the move.
"""
LEVEL = (0.2, 0.1)
"""Level zero below which an estimate is usable, and fine [m/s^2]."""
STEERING_ZERO = math.radians(2.0)
"""Zero error of an angle of the steering wheel that nothing has measured (assumption)."""
ASKED = 2
"""The test for a moved sensor runs once in this many blocks (13 s)."""
NO_SPEED = "a speed: without one, a turn of the sensor would not be noticed"
"""Text of the reason why a mount that lost its speed is not *fine*."""
REMEMBERED = 240
"""Blocks (26 min) for which the knowledge of a drift is kept."""


class JointSettings(EstimatorSettings, frozen=True):
    """Limits of the states: cross-talk xy and yx as yaw, the level zero as tilt."""

    OWN_LIMITS = Limits(
        usable_yaw=math.radians(1.0),
        usable_tilt=LEVEL[0] / GRAVITY,
        fine_yaw=math.radians(0.3),
        fine_tilt=LEVEL[1] / GRAVITY,
    )
    CREEP_CHANCE = 0.05
    """Probability that the mount creeps: one sensor in twenty is held by tape or a soft holder
    (assumption)."""

    @classmethod
    def of(cls, settings: EstimatorSettings) -> JointSettings:
        """Return the same settings, with these limits where a user gives none."""
        return cls(**{name: getattr(settings, name) for name in settings.__struct_fields__})


class JointAcceptance(Acceptance, frozen=True):
    """Acceptance as in the full estimator, except that *fine* does not wait for the test for a
    small move.

    A move that is too small to show at once is rare. A wait of minutes in every drive is not
    justified. are_signs_known: an earlier drive proved the signs, and no evidence shows a change
    since. *Fine* still waits for all signs. has_speed_now: a speed came in the last minute. Without
    a speed nothing shows that the sensor turns in yaw, so the mount is *usable* at most.
    """

    are_signs_known: bool = False
    has_speed_now: bool = True

    def _missing_of_signals(self) -> str | None:
        return self.checks.doubt if self.are_signs_known else super()._missing_of_signals()

    def shares(self, is_fine: bool) -> dict[str, float]:
        """Return the shares as in the full estimator; no test has to become active."""
        found = super().shares(is_fine)
        found.pop(WATCH, None)
        return found

    def missing_to_be_fine(self) -> str:
        """Return the missing conditions as in the full estimator, and a missing speed."""
        return super().missing_to_be_fine() if self.is_armed else NO_SPEED

    @property
    def is_armed(self) -> bool:
        """True while a sensor that turns would be noticed."""
        return self.has_speed_now


class JointEstimator(FullEstimator):
    """Serves the joint solution, judged by the deviations of the data that a consumer gets.

    `_joint` holds the evidence since the last move of the sensor, and the earlier knowledge of the
    sensor itself (`known`). After a move that misleads no consumer, the earlier solution is served
    with deviations widened by the move, until `_next` is usable.
    """

    def __init__(self, settings: EstimatorSettings | None = None) -> None:
        super().__init__(settings or JointSettings())
        self._known_before: KnownSensor | None = None
        self._has_zero = self._has_gyro = False
        self._lately_known: deque[tuple[float, Solution]] = deque(maxlen=SOLUTIONS_KEPT)
        self._joint = self._new_evidence()
        self._next: Evidence | None = None
        self._widened, self._doubt = np.zeros(3), np.zeros(3)
        self._taken_until = self._now = -math.inf
        self._corrected: tuple[Solution, Creep | None, Correction] | None = None  # the last one
        self._drift, self._has_drifted = NO_DRIFT, False
        self._drifts: deque[tuple[float, Drift]] = deque(maxlen=REMEMBERED)

    def gap(self) -> None:
        """Note a jump of time: signals before it are not joined with those after it."""
        super().gap()
        self._taken_until = -math.inf
        self._joint.gap()
        if self._next is not None:
            self._next.gap()

    @property
    def solution(self) -> Solution | None:
        """Response of both sensors to motion, as known now; None before it is known."""
        return self._joint.solution

    def _new_evidence(
        self, known: KnownSensor | None = None, is_moved: bool = False, past: Drift | None = None
    ) -> Evidence:
        return Evidence(self.priors, known, is_moved, past, self._signals_now())

    def _signals_now(self) -> OtherSignals:
        """Return the signals that are available besides the accelerometer by now."""
        if self._has_gyro:
            return OtherSignals()
        s = self._settings
        if "yaw_rate" in self._signals.seen:
            late = s.delays["yaw_rate"].mean if "yaw_rate" in s.delays else OtherSignals().late
            return OtherSignals(gyro=False, late=late)
        if not (s.uses_steering and "steering" in self._signals.seen):
            return OtherSignals(gyro=False, turns=False)
        path = s.vehicle.steering_ratio * s.vehicle.wheelbase
        return OtherSignals(gyro=False, bend=STEERING_ZERO / path)

    @property
    def priors(self) -> Priors:
        """Assumptions before any data, with what the configuration states."""
        s = self._settings
        configured = s.calibration.cross_axis
        usual = Priors()
        return Priors(
            cross_axis=((configured, 1.0),) if configured else usual.cross_axis,
            zero=max(usual.zero, s.calibration.accelerometer_bias),
            crown=(s.crown, s.vehicle.crown_std),
        )

    # what is the sensor's own -------------------------------------------------------------------

    def known_sensor(self) -> KnownSensor | None:
        """Knowledge about the sensor itself, independent of the mount."""
        known, creep = self._joint.known_sensor, self._solver.creep
        if known is None or creep is None or self.solution is None:
            return known
        return known.turned(creep.level, creep.variance)

    def as_before(self) -> float | None:
        """Probability that sensor and mount are those of the earlier drive; None: no earlier drive
        was taken.
        """
        if not self._joint.compares_with_before or self.solution is None:
            return None
        return self.solution.same

    def take_known_sensor(self, known: KnownSensor, is_moved: bool) -> None:
        """Begin with what an earlier drive found of the sensor.

        This is ignored once the present drive has begun.
        """
        if self._joint.seconds:
            return
        self._known_before = known.away()
        self._joint = self._new_evidence(self._known_before, is_moved)

    def _known_until(self, t: float) -> KnownSensor | None:
        """Return the knowledge about the sensor from a time early enough to contain no move."""
        for end, solution in reversed(self._lately_known):
            if end <= t - MOVE_UNSEEN_S:
                return solution.sensor(self.priors)
        return self._known_before

    # blocks ------------------------------------------------------------------------------------

    def _learn_from(self, p: SignalBlock) -> None:
        self._now = float(p.t[-1])
        super()._learn_from(p)
        self._solve_with(p)
        self._drift = self._joint.drift
        self._drifts.append((self._now, self._joint.in_sensor_axes(self._drift)))

    def _solve_with(self, p: SignalBlock) -> None:
        self._has_gyro = self._has_gyro or bool(p.had_rate.any())
        if self._joint.signals != self._signals_now():
            self._follow_signals()
        block = _block(p, self._joint.signals)
        known = bool(p.ok_rate.any())
        target = self._next or self._joint
        if known and not self._has_zero:
            target.subtract_rate_zero(p.gyro_bias)
        self._has_zero = self._has_zero or known
        if float(p.t[-1]) <= self._taken_until:  # after a move it was among those that count
            return
        target.add(block)
        if self._signals.without_speed:
            return
        try:
            target.solve_when_due()
        except np.linalg.LinAlgError:  # the signals contradict one another; `_checks` shows which
            self._lately_known.clear()
            self._begin_again([])
            return
        if target is self._joint:
            self._remember(float(p.t[-1]))
        if self._next is not None and self._is_usable(self._next.solution):
            self._joint, self._next = self._next, None
            self._forget_moves()

    def _follow_signals(self) -> None:
        """Use the last blocks again with all signals that have come since."""
        former, kept = self._next or self._joint, list(self._solvers.kept)[:-1]
        made = self._new_evidence(former.known, former.is_moved)
        for p in kept[max(len(kept) - former.blocks, 0) :]:
            made.add(_block(p, made.signals))
        self._joint, self._next = made, None
        self._forget_moves()
        self._lately_known.clear()

    def _forget_moves(self) -> None:
        self._widened, self._doubt = np.zeros(3), np.zeros(3)

    def _remember(self, t: float) -> None:
        solution, lately = self.solution, self._lately_known
        if solution is not None and (not lately or lately[-1][1] is not solution):
            lately.append((t, solution))

    def _begin_again(self, blocks: list[SignalBlock], since: int = 0) -> None:
        self._joint, self._next, self._drift = self._filled(blocks, since), None, NO_DRIFT
        self._forget_moves()

    def _filled(self, blocks: list[SignalBlock], since: int = 0) -> Evidence:
        """Return the evidence after a move. since: number of blocks after it, if fewer are kept."""
        began = float(blocks[0].t[0]) if blocks else self._now
        if since > len(blocks):
            began = min(began, self._now - since * BLOCK_S)
        self._known_before = self._known_until(began)
        self._lately_known.clear()
        drifts = [drift for end, drift in self._drifts if end < began]  # later blocks count again
        past = drifts[-1] if drifts else None
        made = self._new_evidence(self._known_before, is_moved=True, past=past)
        for p in blocks:
            made.add(_block(p, made.signals))
            self._taken_until = float(p.t[-1])
        return made

    def _begin_afresh(self, blocks: Iterable[SignalBlock]) -> None:
        kept = list(blocks)
        super()._begin_afresh(kept)
        self._begin_again(kept)

    def _take_change(self, found: MountChange) -> None:
        after = blocks_since(found, self._solvers.kept)
        since = found.blocks if isinstance(found, Move) else 0
        super()._take_change(found)
        if self._served.has_moved:
            self._begin_again(after, since)
        else:
            axis = found.axis
            self._widened[axis] = max(self._widened[axis], abs(found.size))
            self._next, self._doubt = self._filled(after, since), np.zeros(3)  # no doubt any more

    def _small_change(self, is_turn: bool) -> MountChange | None:
        """Look for a small change with the joint solution, if it is served and has a gyroscope."""
        if self._signals.without_speed or not self._joint.signals.gyro:
            return super()._small_change(is_turn)
        self._changes.forget_doubt()  # about the solver's rotation, which decides nothing here
        if self._signals.blocks % ASKED:
            return None
        try:
            found = (self._next or self._joint).move()
        except np.linalg.LinAlgError:  # windows that say nothing yet of one of the answers
            found = None
        self._doubt = np.zeros(3)
        if found is not None:
            self._doubt[found.axis] = found.doubt
        return found if found is not None and found.is_certain else None

    # judging -----------------------------------------------------------------------------------

    def _judge(self, p: SignalBlock) -> None:
        """Judge the state.

        A drifted zero stays at its new, unknown value until the end of the drive.
        """
        if self._drift.is_named and self._is_usable(self.solution):
            self._has_drifted = True
        if self._has_drifted:
            self._checks.accuse_lasting(StandingFault.ACCEL_DRIFT, self._signals.blocks)
        super()._judge(p)

    def _sent(self, solution: Solution) -> SentDeviations:
        return solution.sent(self._turned(), self._drift.variance())

    def _turned(self) -> Array:
        """Return the variance (3,) of a rotation that is tolerated or not certain, and of creep
        [rad^2].
        """
        creep = self._solver.creep
        variance = self._widened**2 + self._doubt**2
        return variance if creep is None else variance + creep.variance

    def _stated(self) -> tuple[float, ...]:
        if self.solution is None:
            return super()._stated()
        own = self.solution.covariance[PHI, PHI].diagonal() + self._widened**2
        return tuple(np.sqrt(own).tolist())

    def _misleading(self) -> tuple[float, ...]:
        if self.solution is None:
            return super()._misleading()
        return _as_angles(self.solution.sent(self._widened**2))

    def _is_usable(self, solution: Solution | None) -> bool:
        if solution is None:
            return False
        roll, pitch, yaw = _as_angles(solution.sent())
        limits = self._settings.limits
        return yaw < limits.usable_yaw and max(roll, pitch) < limits.usable_tilt

    @property
    def _is_rotation_good(self) -> bool:
        """With a known sensor, the state becomes good before the solver's own rotation is good.

        The test for a step in gravity then waits until it knows the usual spread of this drive.
        """
        return super()._is_rotation_good and self._known_before is None

    def _knowledge(self, p: SignalBlock) -> MountKnowledge:
        """Return the knowledge after a block, from the joint solution where there is one."""
        known = super()._knowledge(p)
        if self._signals.without_speed:
            return known
        solution = self.solution
        if solution is None:
            return replace(known, std=(math.inf,) * 3, cross_talk=(math.inf,) * 2)
        sent = self._sent(solution)
        return replace(
            known,
            gravity=True,
            std=_as_angles(sent),
            straight=max(known.straight, NEEDED),
            cross_axis=0.0,
            cross_talk=(sent.xy, sent.yx),
            std_without_drift=_as_angles(solution.sent(self._turned())),
            has_past=self._joint.signals.gyro or known.has_past,
        )

    def _acceptance(self) -> Acceptance:
        own = super()._acceptance()
        if (solution := self.solution) is None:
            return own
        is_as_before = solution.same >= CHANCE_AS_BEFORE
        parts = own.solver, own.checks, own.changes, own.has_speed
        has_speed = self._known.speed
        return JointAcceptance(*parts, are_signs_known=is_as_before, has_speed_now=has_speed)

    def _found_correction(self) -> Correction:
        solution = self.solution
        if solution is None:
            return super()._found_correction()
        last, creep = self._corrected, self._solver.creep
        if last is None or last[0] is not solution or last[1] is not creep:
            turn = np.eye(3) if creep is None else rotation_from_vector(creep.level)
            made = turn @ solution.force, turn @ solution.rate, turn @ solution.zero
            housing = orthonormalised(made[0])
            self._corrected = last = solution, creep, Correction.with_matrices(housing, *made)
        return last[2]

    def _new_estimate(self) -> MountEstimate:
        made = super()._new_estimate()
        solution = self.solution
        if solution is None:
            return made
        correction, sent = self._found_correction(), self._sent(solution)
        return replace(
            made,
            R_vehicle_from_sensor=correction.matrix(),
            covariance=self._housing_covariance(solution),
            details=dict(made.details) | {"speed_delay": solution.delay},
            targets=self._settings.limits.about_axes(),
            matrices=correction,
            deviations=sent,
            judged_as=_as_angles(sent),
        )

    def _housing_covariance(self, solution: Solution) -> Array:
        """Return the covariance of the housing's rotation.

        It is too small if the cross-axis errors are antisymmetric: these look like a rotation, and
        their size is judged by the symmetric ones.
        """
        own = solution.covariance[PHI, PHI]
        return np.asarray(own + np.diag(self._turned()))


def _as_angles(sent: SentDeviations) -> tuple[float, float, float]:
    """Return level zero y and x as tilts, and the larger of cross-talk xy and yx as a yaw [rad]."""
    return sent.zero_y / GRAVITY, sent.zero_x / GRAVITY, max(sent.xy, sent.yx)


def _block(p: SignalBlock, signals: OtherSignals) -> Block:
    """Return the part of a block that the joint solution uses, for the signals that the vehicle
    has.
    """
    use = p.ok_force & p.ok_speed & p.learn
    knots = MIDDLES if p.speed_knots is None else p.speed_knots
    if signals.gyro:
        use &= p.had_rate
        known = bool(p.ok_rate.any())
        return Block(p.force, p.rate, p.speed, use, known, p.gyro_bias, knots, p.least_speed)
    if signals.turns:
        use &= p.ok_yaw
    rate = np.zeros_like(p.rate)
    rate[:, 2] = p.yaw_rate * p.ok_yaw
    return Block(p.force, rate, p.speed, use, knots=knots, least_speed=p.least_speed)
