"""The mount estimator: it finds a matrix for the accelerometer and a matrix for the gyroscope.

Order of the steps:

1. `SignalBlockMaker` takes every tick. Every 6.4 s it returns a block of signals on an even time
grid. Each tick of the block has a flag that says whether the tick is usable
(`motion.signal_health`).
2. `CarriedForce` integrates the direction of gravity through the block and subtracts gravity from
the force.
3. `SignalChecks` compares the signals with one another. When a contradiction begins or ends, the
search for the mount starts again.
4. `Evidence` takes the block and, when there is enough evidence, solves for all unknowns
(`joint.state`).
5. `joint.sudden_changes`, `joint.moves` and `MountChanges` compare the block with the earlier
estimate. If the sensor was moved, the mount becomes suspect and the evidence begins again with the
data after the move. A move that is too small to mislead a consumer is only reported. The deviation
is then enlarged by this move until there is enough evidence after the move.
6. `ServedMount` determines the state, with hysteresis, and changes the applied correction without a
jump. `MountEstimate` reports state and correction, and the evidence that each angle still needs.

Without a gyroscope, the evidence uses the vehicle's yaw rate or steering angle. Without a speed
signal, the evidence eliminates the speed as an unknown (`drive.unknown_speed`). Steps 3 and 5 then
skip the tests that need a speed.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping

import numpy as np
from msgspec.structs import replace

from imucald.core.arrays import Array, inverse
from imucald.core.rotations import (
    Matrix3,
    orthonormalised,
    rotation_from_vector,
    vector_from_rotation,
)
from imucald.core.samples import GRAVITY
from imucald.drive.unknown_speed import Steered
from imucald.motion.ticks import TickRow
from imucald.mount.carried_force import CarriedForce
from imucald.mount.contradictions import StandingFault
from imucald.mount.creep import Creep
from imucald.mount.estimate import Correction, MountEstimate, MountState, SentDeviations
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.explanation import (
    LevelChange,
    ProgressWatch,
    creep_details,
    estimate_details,
    left_out_details,
    level_details,
    mount_troubles,
    waiting_reasons,
)
from imucald.mount.hand_moves import YAW, HandMove
from imucald.mount.hysteresis import GOOD
from imucald.mount.joint.drift import LOG_ONSETS, NAMED, Drift
from imucald.mount.joint.drift import NONE as NO_DRIFT
from imucald.mount.joint.evidence import MIDDLES, Block, Evidence, Solution
from imucald.mount.joint.known import CHANCE_AS_BEFORE, KnownSensor
from imucald.mount.joint.moves import Move
from imucald.mount.joint.state import PHI, ZERO_VECTOR, OtherSignals, Priors
from imucald.mount.joint.sudden_changes import TURNED_STD
from imucald.mount.mount_changes import (
    ALERT_DEVIATIONS,
    ALERT_LIMIT,
    GoodMount,
    MountChange,
    MountChanges,
    SuddenTurn,
    blocks_since,
)
from imucald.mount.off_vertical_limit import is_off_vertical
from imucald.mount.served_mount import ServedMount
from imucald.mount.signal_blocks import (
    BLOCK_S,
    NOMINAL_SPEED,
    MountSoFar,
    SignalBlock,
    SignalBlockMaker,
)
from imucald.mount.signal_checks import Acceptance, SignalChecks
from imucald.mount.states import Manoeuvres, MountKnowledge
from imucald.mount.steering import SteeringOffsetEstimator

KEPT_BLOCKS = 55
"""Number of blocks that are stored: 350 s."""
OPEN_BLOCKS = 20
"""Number of blocks (2 min) after which new evidence decides the cause of a sudden change. After
this time, the filter has absorbed the change.
"""
MINUTE_BLOCKS = 10
"""Number of blocks (a minute) that decide which conditions are missing, because a condition that
fails in a single block is usually met soon after. Numbers out of range are reported for this time
after their last occurrence.
"""
FROZEN_TICKS = 40
"""Number of ticks of a block that are not trusted, from which learning counts as frozen."""
SOLUTIONS_KEPT = 32
"""Number of stored solutions: all solutions of the first three minutes. Later solutions follow at
longer intervals."""
MOVE_UNSEEN_S = 60.0
"""Uncertainty of the time of a move. The time found is exact to one or two blocks, but too late for
a slow move. Blocks within 60 s before this time may therefore contain a part of the move.
"""
STEERING_ZERO = math.radians(2.0)
"""Assumed zero error of a steering wheel angle whose zero error was not measured."""
ASKED = 2
"""Interval of the test for a moved sensor, in blocks (13 s)."""
REMEMBERED = 240
"""Number of blocks (26 min) for which the estimated drift is stored."""
CREEP_CHANCE = 0.05
"""Assumed probability that the mount creeps: one sensor in twenty is held by tape or a soft
holder."""
UNKNOWN_YAW = (math.pi / math.sqrt(3.0)) ** 2
"""Variance of an unknown direction [rad^2]."""


class JointEstimator:
    """Estimates the response of both sensors to motion. The steps are in the module docstring.

    `_signals`: ticks, offsets, signal health. `_joint`: the evidence since the last move of the
    sensor, with the earlier knowledge of the sensor itself (`known`). `_carried`: direction of
    gravity in the same time. `_checks`, `_changes`: evidence against the rotation. `_known`:
    knowledge by which the state is judged. `_served`: the state and the applied correction.
    `_next`: the evidence after a move that is too small to mislead a consumer. Until `_next` is
    usable, the earlier solution is applied, with its deviations enlarged by the move.
    """

    def __init__(self, settings: EstimatorSettings | None = None) -> None:
        self._settings = settings or EstimatorSettings()
        self._signals = SignalBlockMaker(self._settings)
        self._kept: deque[SignalBlock] = deque(maxlen=KEPT_BLOCKS)
        self._steering = SteeringOffsetEstimator()
        self._carried, self._driven = CarriedForce(self._settings), Manoeuvres()
        self._checks = SignalChecks(self._settings)
        self._changes = MountChanges()
        self._stepped = np.zeros(3)  # change of the zero in this drive, sensor axes [m/s^2]
        self._before_step: Solution | None = None  # solution before the zero changed
        self._may_be_turn = False  # the last step of the zero may be a turn of the sensor
        self._level: LevelChange | None = None
        self._is_gravity_open = False  # something has changed, and it is not known what
        self._instead = -math.inf  # log odds of what else may be in place of a drift
        self._lately: deque[tuple[int, ...]] = deque(maxlen=MINUTE_BLOCKS)
        self._off_vertical = self._failed_for = 0
        self._known_before: KnownSensor | None = None
        self._has_zero = self._has_gyro = self._fits_no_sensor = False
        self._lately_known: deque[tuple[float, Solution]] = deque(maxlen=SOLUTIONS_KEPT)
        self._joint = self._new_evidence()
        self._next: Evidence | None = None
        self._doubt = np.zeros(3)
        self._creep: Creep | None = None
        self._crept = 0  # road segment of the last test
        self._taken_until = self._now = -math.inf
        self._corrected: tuple[Solution, Creep | None, Correction] | None = None  # the last one
        self._drift, self._has_drifted = NO_DRIFT, False
        self._drifts: deque[tuple[float, Drift]] = deque(maxlen=REMEMBERED)
        self._known = MountKnowledge(begun=False, accelerometer=False)
        self._served = ServedMount(self._settings)
        self._progress = ProgressWatch()
        self._estimate: MountEstimate | None = None

    @property
    def correction(self) -> Correction | None:
        """The correction to apply now, or None."""
        return self._served.correction

    @property
    def state(self) -> MountState:
        """The present state."""
        return self._served.state

    @property
    def solution(self) -> Solution | None:
        """Present solution: the response of both sensors to motion; None before it is known."""
        return self._joint.solution

    @property
    def faults(self) -> tuple[str, ...]:
        """Present contradictions, by the names of `StandingFault`."""
        return tuple(fault.value for fault in self._checks.standing)

    @property
    def stuck_signals(self) -> Mapping[str, bool]:
        """True or False for each vehicle signal: whether it is stuck, see
        `mount.estimate.JudgesSignals`."""
        return self._signals.stuck

    def take_usual_signals(self, former: JointEstimator, channels: Collection[str]) -> None:
        """Copy the usual repeat times of the vehicle's signals from another estimator.

        channels: channels that have the same sources in both estimators. A signal that is stuck is
        left out.
        """
        self._signals.health.take_usual(former._signals.health, channels)

    # tick by tick ---------------------------------------------------------------------------

    def step(self, tick: TickRow) -> None:
        """Process one tick."""
        self._served.move_on()
        if self._signals.push(tick):
            self._signals.take_mount(self._known_mount())
            self._take_block(self._signals.block())
            self._estimate = None

    def quiet_ticks(self) -> int:
        """Number of next ticks that are only stored, see `mount.estimate.KeepsTicks`."""
        return 0 if self._served.is_turning else self._signals.until_block - 1

    def keep_quiet(self, ticks: Array) -> None:
        """Process ticks (n, COLUMNS), at most `quiet_ticks`."""
        self._signals.push_all(ticks)

    def gap(self) -> None:
        """Note a jump of time: signals before the jump are not joined with signals after it."""
        self._signals.restart()
        self._kept.clear()
        self._carried.gap()
        self._taken_until = -math.inf
        self._joint.gap()
        if self._next is not None:
            self._next.gap()
        self._estimate = None

    def _new_evidence(
        self, known: KnownSensor | None = None, is_moved: bool = False, past: Drift | None = None
    ) -> Evidence:
        s = self._settings
        vehicle = self._signals_now(), s.delays["speed"], s.lever_arm
        return Evidence(self.priors, known, is_moved, past, *vehicle)

    def _signals_now(self) -> OtherSignals:
        """Return which signals other than the accelerometer are available at present."""
        s, speed = self._settings, not self._signals.without_speed
        if self._has_gyro:
            return OtherSignals(speed=speed)
        if "yaw_rate" in self._signals.seen:
            return OtherSignals(gyro=False, late=s.delays["yaw_rate"].mean, speed=speed)
        if not (s.uses_steering and "steering" in self._signals.seen):
            return OtherSignals(gyro=False, turns=False, speed=speed)
        path = s.vehicle.steering_ratio * s.vehicle.wheelbase
        steered = None if speed else Steered(NOMINAL_SPEED, s.understeer / s.vehicle.wheelbase)
        return OtherSignals(False, bend=STEERING_ZERO / path, speed=speed, steered=steered)

    @property
    def priors(self) -> Priors:
        """Priors of the solution, including the values of the configuration."""
        s = self._settings
        configured = s.calibration.cross_axis
        usual = Priors()
        return Priors(
            cross_axis=((configured, 1.0),) if configured else usual.cross_axis,
            zero=max(usual.zero, s.calibration.accelerometer_bias),
            slope=s.slope,
            crown=(s.crown, s.vehicle.crown_std),
        )

    # what is the sensor's own -------------------------------------------------------------------

    def known_sensor(self) -> KnownSensor | None:
        """Return the knowledge about the sensor itself, which does not depend on the mount."""
        known, creep = self._joint.known_sensor, self._creep
        if known is None or creep is None or self.solution is None:
            return known
        return known.turned(creep.level, creep.variance)

    @property
    def contradiction(self) -> float | None:
        """Chi-square (3 degrees of freedom) between this mount and the mount of an earlier drive;
        None if there is no comparison."""
        if self.solution is None or self._joint.is_moved:
            return None
        return self.solution.contradiction

    def leave_mount(self) -> None:
        """Discard the mount of the earlier drive because the sensor was moved since, and keep the
        knowledge of the sensor itself."""
        self._joint.leave_mount()

    def take_known_sensor(self, known: KnownSensor, is_moved: bool) -> None:
        """Begin with the knowledge of the sensor from an earlier drive.

        The call has no effect once the present drive has begun.
        """
        if self._joint.seconds:
            return
        self._known_before = known.away()
        self._joint = self._new_evidence(self._known_before, is_moved)

    def _solution_until(self, t: float) -> Solution | None:
        """Return a solution from a time early enough to contain no move at t [s]; None if no such
        solution is stored."""
        for end, solution in reversed(self._lately_known):
            if end <= t - MOVE_UNSEEN_S:
                return solution
        return None

    # block by block -------------------------------------------------------------------------

    def _take_block(self, p: SignalBlock) -> None:
        """Learn from a block.

        If numbers are beyond the range of the arithmetic, the evidence begins again and a fault is
        reported.
        """
        self._failed_for = max(self._failed_for - 1, 0)
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                self._learn_from(p)
        except (np.linalg.LinAlgError, ArithmeticError):
            self._failed_for = MINUTE_BLOCKS
            self._begin_without_rotation()  # impossible numbers are in the evidence
        self._judge(p)

    def _learn_from(self, p: SignalBlock) -> None:
        """Do steps 2 to 5 of the module docstring."""
        carried, signals, changes = self._carried, self._signals, self._changes
        is_watched = self._watched is not None
        self._now = float(p.t[-1])
        self._kept.append(p)
        self._driven.add_accelerations(*carried.take_block(p))
        self._follow_steering(p)
        turned = None
        if carried.R is not None:
            turned = changes.at_once(p, carried, signals, is_watched)
        if turned is not None or self._is_gravity_open:  # no sign and no unit is contradicted
            self._checks.contradictions.forget_forces()
        checked = p, carried, signals, self._kept, self._fits_no_sensor
        if turned is None and self._checks.take_block(*checked):
            self._begin_without_rotation([p])
        self._solve_with(p)
        self._follow_creep()
        if not self._was_moved_by_hand(p, turned):
            change: MountChange | None = self._sudden_change()
            if change is None and not (self._is_gravity_open or self._checks.is_motion_accused):
                change = self._small_change()
            if change is not None:
                self._take_change(change)
        self._drift = self._joint.drift
        self._drifts.append((self._now, self._joint.in_sensor_axes(self._drift)))

    def _solve_with(self, p: SignalBlock) -> None:
        self._has_gyro = self._has_gyro or bool(p.had_rate.any())
        if (self._next or self._joint).signals != self._signals_now():
            self._follow_signals()
        target = self._next or self._joint
        block = _block(p, target.signals)
        known = bool(p.ok_rate.any())
        if known and not self._has_zero:
            target.subtract_rate_zero(p.gyro_bias, p.turn_zero_std)
        self._has_zero = self._has_zero or known
        if self._now <= self._taken_until:  # after a move it was among those that count
            return
        target.add_block(block)
        if target is not self._joint and not self._joint.signals.speed:  # the speed may stay away
            self._joint.add_block(_block(p, self._joint.signals))
            _is_solved(self._joint)
        if (
            self._is_gravity_open
        ):  # a solution would mix what was before the change with what is after
            return
        if not _is_solved(target):
            self._fits_no_sensor, self._carried.is_sure = True, False
            if target is self._next:
                self._next = self._filled([])
            else:
                self._begin_again([])
            return
        if target is self._joint:
            self._remember(self._now)
        elif self._is_usable(target.solution):
            self._joint, self._next = target, None
            self._forget_moves()
            self._changes.know_borne()
        if self._carried.follow(self._joint):
            self._checks.contradictions.forget_forces()  # the forces showed another rotation

    def _follow_signals(self) -> None:
        """Begin new evidence with all signals that are now available, and use the stored blocks
        again."""
        former, kept = self._next or self._joint, list(self._kept)
        if self._now > self._taken_until:  # the last one is taken after this
            kept.pop()
        known, is_moved = former.known, former.is_moved
        has_begun = self._signals_now().speed and not former.signals.speed
        if has_begun:  # blocks without a speed do not count again, nor in the tests that use it
            known, is_moved = former.known_sensor, former.solution is None and is_moved
            kept, last = [], self._kept[-1]
            self._kept.clear()
            self._kept.append(last)
            self._changes.skip()
        made = self._new_evidence(known, is_moved)
        for p in kept[max(len(kept) - former.blocks, 0) :]:
            made.add_block(_block(p, made.signals))
        if has_begun and self.solution is not None:  # it is served until the new one is usable
            self._next = made
            return
        self._joint, self._next = made, None
        self._forget_moves()
        self._lately_known.clear()

    def _forget_moves(self) -> None:
        self._changes.borne[:], self._doubt = 0.0, np.zeros(3)
        self._creep, self._crept = None, 0

    def _follow_creep(self) -> None:
        """Test whether the mount creeps, once in each road segment."""
        if self._joint.has_fitted and self._joint.segment != self._crept:
            self._crept = self._joint.segment
            self._creep = self._joint.creep(CREEP_CHANCE, len(self._changes.history))

    def _remember(self, t: float) -> None:
        solution, lately = self.solution, self._lately_known
        if solution is not None and (not lately or lately[-1][1] is not solution):
            lately.append((t, solution))

    def _known_mount(self) -> MountSoFar | None:
        """Return the mount that is used to check a speed that stays constant."""
        carried = self._carried
        up = carried.vertical.up
        if carried.R is None or up is None or not carried.is_sure:
            return None
        return MountSoFar(carried.R[0], up, *carried.delay[:2])

    def _follow_steering(self, p: SignalBlock) -> None:
        """Estimate the steering offset from the measured yaw rate. The steering angle alone shows
        no offset."""
        measured = self._carried.own_gyro or "yaw_rate" in self._signals.seen
        if not measured or not np.count_nonzero(p.ok_steering) or self._signals.without_speed:
            return
        use = p.ok_steering & p.ok_speed & p.learn
        self._steering.add_block(p.steering, p.speed, self._carried.turn_rate, use)
        fitted = self._steering_fitted()
        if fitted is not None:
            self._signals.steering_offset = fitted[0]

    def _steering_fitted(self) -> tuple[float, float] | None:
        s = self._settings
        return self._steering.fitted(s.crown, 1.5 * s.vehicle.crown_std)

    def _was_moved_by_hand(self, p: SignalBlock, turned: HandMove | None) -> bool:
        """Handle a rotation that this block alone shows, and gravity far from the vertical.

        turned: result of the test of this block. Returns True if there was a change.
        """
        carried, changes = self._carried, self._changes
        if carried.R is None:
            changes.skip()
            return False
        if is_off_vertical(p, carried.R, p.speed * carried.turn_rate):
            self._off_vertical += 1
            self._begin_without_rotation([p])
            return True
        if turned is None:
            return False
        if self.state in GOOD:
            self._take_change(turned)
        else:  # nothing is served as good; the fit is young
            self._begin_without_rotation()
            self._served.has_moved = self._served.was_good
        return True

    @property
    def _watched(self) -> Evidence | None:
        """The evidence whose filter tests for sudden changes; None while its solution cannot be
        used."""
        evidence = self._next or self._joint
        is_possible = evidence.signals.gyro and evidence.signals.speed
        if not is_possible or self._checks.is_motion_accused:
            return None
        return evidence if self._is_usable(evidence.solution) else None

    def _sudden_change(self) -> SuddenTurn | None:
        """Return a sudden turn of the sensor that is certain. Begin the evidence again after a step
        of a zero error.

        If it is not certain whether the sensor turned or a zero error stepped, new evidence
        decides.
        """
        evidence, self._is_gravity_open, self._instead = self._watched, False, -math.inf
        found = None if evidence is None else evidence.sudden_change()
        if evidence is None or found is None:
            return None
        self._instead = found.grade - LOG_ONSETS
        least = ALERT_LIMIT if found.is_turn else NAMED
        if not found.is_certain or float(np.linalg.norm(found.size)) < least:
            return None
        self._instead = max(self._instead, found.log_odds)
        if not found.is_decided and found.blocks <= OPEN_BLOCKS:
            self._is_gravity_open = True
            return None
        if not found.is_decided:
            self._served.has_moved = True
            self._changes.restart()
        elif found.is_turn:
            return SuddenTurn.from_change(found)
        else:
            if not self._stepped.any():
                self._before_step = self.solution
            self._may_be_turn = True
            self._stepped += inverse(evidence.watch_axes) @ found.size
            self._level = LevelChange(found.level, found.level + float(found.size[2]))
        self._lately_known.clear()
        self._known_before = None  # of another zero
        self._begin_again(blocks_since(found, self._kept))
        return None

    def _small_change(self) -> Move | None:
        """Return a certain small move of the sensor in the last minutes, or None."""
        if self._signals.blocks % ASKED:
            return None
        asked = self._joint if not self._joint.signals.speed else self._next or self._joint
        try:
            found = asked.move()
        except np.linalg.LinAlgError:  # windows that say nothing yet of one of the answers
            found = None
        self._doubt = np.zeros(3)
        if found is None:
            return None
        self._doubt[found.axis] = found.doubt
        return found if found.is_certain else None

    def _take_change(self, found: MountChange) -> None:
        """Handle a moved sensor: the evidence continues with the blocks after the move only."""
        after = blocks_since(found, self._kept)
        since = found.blocks if isinstance(found, Move) else 0
        changes, block, good = self._changes, self._signals.blocks, self._good_mount()
        before = self._solution_until(self._began(after, since))
        if good is not None and before is not None:  # what is served may have followed the move
            good = _good_mount_of(before)
        std = self._misleading()[found.axis]
        changes.end_of_mounting(good)
        if self.state in GOOD and changes.is_bearable(found, std):
            changes.bear(found, block, std, good)
            self._next, self._doubt = self._filled(after, since), np.zeros(3)  # no doubt any more
            return
        turn = found.turn if isinstance(found, SuddenTurn) else None
        is_far = turn is not None and float(np.linalg.norm(turn)) > TURNED_STD  # beyond first order
        if isinstance(found, HandMove) or is_far:  # nobody knows about the other axes
            self._begin_afresh(after)
        else:
            self._served.has_moved = True
            changes.restart()
            self._carry(after, self._carried, turn)
            self._begin_again(after, since)
        changes.note_change(found, block, std, good)

    def _carry(
        self,
        blocks: Iterable[SignalBlock],
        before: CarriedForce | None = None,
        turn: Array | None = None,
    ) -> None:
        """Integrate the direction of gravity again, through these blocks alone.

        before: object whose rotation is the start, turned by `turn`, the rotation vector (3,) of
        the sensor since then [rad]. The rotation of `before` is close to the present rotation.
        """
        self._carried, self._driven = CarriedForce(self._settings), Manoeuvres()
        if before is not None:
            self._carried.start_from(before, turn)
        for p in blocks:
            self._driven.add_accelerations(*self._carried.take_block(p))

    def _begin_without_rotation(self, blocks: Iterable[SignalBlock] = ()) -> None:
        """Begin again from these blocks. The rotation found so far is not used, not even as a
        hint."""
        self._changes.end_of_mounting(self._good_mount())
        self._begin_afresh(blocks)

    def _begin_afresh(self, blocks: Iterable[SignalBlock]) -> None:
        kept = list(blocks)
        self._served.has_moved = True
        self._changes.restart()
        self._checks.restart()
        self._signals.offsets.doubt_gyro()
        self._carry(kept)
        self._begin_again(kept)

    def _begin_again(self, blocks: list[SignalBlock], since: int = 0) -> None:
        self._joint, self._next, self._drift = self._filled(blocks, since), None, NO_DRIFT
        self._is_gravity_open = False
        self._forget_moves()

    def _began(self, blocks: list[SignalBlock], since: int) -> float:
        """Return the time [s] at which the blocks after a move begin. since: number of blocks since
        the move.
        """
        began = float(blocks[0].t[0]) if blocks else self._now
        return min(began, self._now - since * BLOCK_S) if since > len(blocks) else began

    def _filled(self, blocks: list[SignalBlock], since: int = 0) -> Evidence:
        """Return new evidence with the blocks after a move. since: number of blocks since the move;
        it is larger than the number of given blocks if older blocks are no longer stored."""
        began = self._began(blocks, since)
        if (before := self._solution_until(began)) is not None:
            self._known_before = before.sensor(self.priors)
        self._lately_known.clear()
        certain = began - 2.0 * BLOCK_S  # the change may be in the blocks since; later ones count
        drifts = [drift for end, drift in self._drifts if end < certain]
        past = drifts[-1] if drifts else None
        made = self._new_evidence(self._known_before, is_moved=True, past=past)
        for p in blocks:
            made.add_block(_block(p, made.signals))
            self._taken_until = float(p.t[-1])
        return made

    # judging, and saying what is known --------------------------------------------------------

    def _judge(self, p: SignalBlock) -> None:
        """Judge the state. After a drift of its zero error, the accelerometer has a fault until the
        end of the drive, because the new zero error is unknown.
        """
        checks, block = self._checks, self._signals.blocks
        self._fits_no_sensor &= not self._is_usable(self.solution)
        is_drift = self._drift.is_named and self._drift.log_odds > self._instead
        self._has_drifted |= is_drift and self._is_usable(self.solution)
        if self._has_drifted:
            checks.accuse_lasting(StandingFault.ACCEL_DRIFT, block)
        if self._failed_for:
            checks.accuse(StandingFault.NUMERICS)
        if self._fits_no_sensor and not checks.standing:  # then the signals contradict each other
            checks.accuse(StandingFault.FORCE_TURNS)
        self._hold_against_orientation()
        self._look_for_turned_step()
        for fault in self._stepped_zeros():
            checks.accuse_lasting(fault, block)
        self._known = self._knowledge(p)
        acceptance = self._acceptance()
        is_doubted = bool(checks.standing) or self._is_gravity_open
        self._served.judge(self._known, acceptance, is_doubted, self._found_correction)
        self._progress.note_knowledge(block * BLOCK_S, self._known, self._settings, acceptance)

    def _look_for_turned_step(self) -> None:
        """Take a step of the zero error for a turn of the sensor, if the responses to motion after
        the step are turned about the vertical.

        A step of the zero error does not turn the responses. The filter that found the step is
        linear, so it cannot describe a turn by more than some degrees. The first usable solution
        after the step decides: later turns have other causes.
        """
        before, now = self._before_step, self.solution
        if not self._may_be_turn or before is None or now is None or not self._is_usable(now):
            return
        self._may_be_turn = False
        turn = vector_from_rotation(now.housing @ before.housing.T)
        std = math.sqrt(float((now.covariance + before.covariance)[PHI, PHI][YAW, YAW]))
        size = float(turn[YAW])
        if abs(size) <= ALERT_DEVIATIONS * std:
            return
        self._stepped, self._before_step, self._level = np.zeros(3), None, None
        self._checks.forget_rotation()
        self._signals.offsets.doubt_gyro()
        good = _good_mount_of(before)
        found = SuddenTurn(YAW, size, size / std, self._joint.blocks, turn)
        self._changes.note_change(found, self._signals.blocks, std, good)

    def _stepped_zeros(self) -> Iterator[StandingFault]:
        """Yield the faults of an accelerometer whose zero error has stepped and not returned, along
        or across the vertical.

        If a new solution is usable, the level part of the step is computed from the new solution.
        """
        R = self._carried.R
        if R is None or not self._stepped.any():
            return
        x, y, z = (R @ self._stepped).tolist()
        if self._is_usable(self.solution):
            before = ZERO_VECTOR if self._before_step is None else self._before_step.bias
            x, y, _ = (R @ (self._joint.bias - before)).tolist()
        if abs(z) > NAMED:
            yield StandingFault.ACCEL_LEVEL
        if math.hypot(x, y) > NAMED:
            yield StandingFault.ACCEL_ZERO

    def _hold_against_orientation(self) -> None:
        """Compare the orientation that a person states with the estimated rotation, or with
        gravity."""
        R, is_yaw_known = self._carried.R, True
        if R is None:
            level = self._carried.levelled(self.priors.zero)
            if level is None:
                return
            R, is_yaw_known = level[0], False
        self._checks.hold_against_orientation(R, is_yaw_known, self._signals.blocks)

    def _good_mount(self) -> GoodMount | None:
        good = self._served.good
        return None if good is None else GoodMount(good.rotation, self._stated())

    def _sent(self, solution: Solution) -> SentDeviations:
        return solution.sent(self._turned(), self._drift.variance())

    def _turned(self) -> Array:
        """Return the additional variance (3,) of the rotation [rad^2], from tolerated moves,
        uncertain moves and creep.
        """
        variance = self._changes.borne**2 + self._doubt**2
        return variance if self._creep is None else variance + self._creep.variance

    def _stated(self) -> tuple[float, ...]:
        """Return the deviations (3,) of the housing's angles [rad]. An unconfirmed change is not
        included."""
        if self.solution is None:
            return (math.inf,) * 3
        own = self.solution.covariance[PHI, PHI].diagonal() + self._changes.borne**2
        return tuple(np.sqrt(own).tolist())

    def _misleading(self) -> tuple[float, ...]:
        """Return the standard deviations (3,) of the errors left in corrected data, as roll, pitch
        and yaw [rad]. An unconfirmed change of the mount is not included."""
        if self.solution is None:
            return (math.inf,) * 3
        return _as_angles(self.solution.sent(self._changes.borne**2))

    def _is_usable(self, solution: Solution | None) -> bool:
        if solution is None:
            return False
        roll, pitch, yaw = _as_angles(solution.sent())
        limits = self._settings.limits
        return yaw < limits.usable_yaw and max(roll, pitch) < limits.usable_tilt

    def _knowledge(self, p: SignalBlock) -> MountKnowledge:
        frozen = ~p.learn & p.ok_force
        self._lately.append(tuple(map(np.count_nonzero, (p.ok_force, p.ok_speed, frozen))))
        lately, has_speed = self._lately, not self._signals.without_speed
        hz = math.fsum(ok for _, ok, _ in lately) / (len(lately) * BLOCK_S)
        carried, driven = self._carried, self._driven
        known = MountKnowledge(
            gravity=carried.gravity.known,
            straight=driven.straight,
            lefts=driven.lefts,
            rights=driven.rights,
            stops=carried.gravity.stops,
            accelerometer=any(ok for ok, _, _ in lately),
            speed=has_speed and any(ok for _, ok, _ in lately),
            speed_hz=hz if has_speed else 0.0,
            frozen=lately[-1][2] >= FROZEN_TICKS,
            turning=carried.own_gyro or bool(self._signals.seen & {"yaw_rate", "steering"}),
            has_gyro=self._joint.signals.gyro,
            without_speed=not has_speed,
        )
        solution = self.solution
        if solution is None:
            return known
        sent = self._sent(solution)
        return replace(
            known,
            gravity=True,
            std=_as_angles(sent),
            cross_talk=(sent.xy, sent.yx),
            std_without_drift=_as_angles(solution.sent(self._turned())),
            std_of_sound=_as_angles(solution.sent()),
        )

    def _acceptance(self) -> Acceptance:
        solution = self.solution
        return Acceptance(
            self._checks,
            self._changes,
            self._is_gravity_open,
            is_delay_beyond=self._carried.delay.is_beyond,
            has_speed=not self._signals.without_speed,
            has_speed_now=self._known.speed,
            are_signs_known=solution is not None and solution.same >= CHANCE_AS_BEFORE,
        )

    def _found_correction(self) -> Correction:
        """Return the correction that follows from the present solution."""
        solution, last, creep = self.solution, self._corrected, self._creep
        assert solution is not None
        if last is None or last[0] is not solution or last[1] is not creep:
            turn = np.eye(3) if creep is None else rotation_from_vector(creep.level)
            made = turn @ solution.force, turn @ solution.rate, turn @ solution.zero
            housing = orthonormalised(made[0])
            self._corrected = last = solution, creep, Correction.with_matrices(housing, *made)
        return last[2]

    def estimate(self) -> MountEstimate:
        """Return the present estimate. The returned object is the same until the estimator has
        learnt something new.
        """
        if self._estimate is None:
            self._estimate = self._new_estimate()
        return self._estimate

    def _new_estimate(self) -> MountEstimate:
        state, changes, checks = self.state, self._changes, self._checks
        acceptance, solution, creep = self._acceptance(), self.solution, self._creep
        moved, level = changes.shifted_again(), self._level
        troubles = mount_troubles(state, checks.standing, creep_details(creep), moved, level)
        words, codes = waiting_reasons(self._known, state, self._settings, acceptance, troubles)
        R, covariance = self._housing()
        details: dict[str, object] = {}
        if R is not None:
            found = self._known, changes, checks, self._steering_fitted(), self._good_mount(), creep
            details = estimate_details(self._carried, self._signals, *found)
            details["gravity_change"] = level_details(level)
        details["not_learnt_from"] = left_out_details(self._signals)
        if self._off_vertical:
            details["off_vertical"] = self._off_vertical
        can_be_fine = acceptance.can_become_fine
        progress = None if troubles else self._progress.after(state, self._known, can_be_fine)
        sent = None if solution is None else self._sent(solution)
        return MountEstimate(
            state,
            R,
            covariance,
            words,
            codes,
            details,
            self.faults,
            self._settings.limits.about_axes(),
            matrices=None if solution is None else self._found_correction(),
            deviations=sent,
            judged_as=None if sent is None else _as_angles(sent),
            progress=progress,
        )

    def _housing(self) -> tuple[Matrix3 | None, Array | None]:
        """Return R_vehicle_from_sensor (3, 3) and its covariance (3, 3); None for a part that is
        not known.

        The covariance is too small if the cross-axis errors are antisymmetric. Antisymmetric errors
        look like a rotation, and their size is estimated from the symmetric errors.
        """
        if self.solution is not None:
            covariance = self.solution.covariance[PHI, PHI] + np.diag(self._turned())
            if self._checks.is_motion_accused:
                covariance[2] = covariance[:, 2] = 0.0
                covariance[2, 2] = UNKNOWN_YAW
            return self._found_correction().matrix(), covariance
        level = self._carried.levelled(self.priors.zero)
        if level is None:
            return None, None
        return level[0], np.diag([*level[1], UNKNOWN_YAW])

    def take_stated_mount(self, R: Matrix3) -> None:
        """Use the mount that a person states.

        If the estimate agrees with this mount, the statement excludes alternatives that no signal
        can exclude.
        """
        self._checks.alternatives.take_mount(R)


def _is_solved(evidence: Evidence) -> bool:
    """Solve if a solution is due. Returns False if the signals contradict one another;
    `SignalChecks` then reports the contradiction."""
    try:
        evidence.solve_when_due()
    except np.linalg.LinAlgError:
        return False
    return True


def _good_mount_of(solution: Solution) -> GoodMount:
    own = tuple(np.sqrt(solution.covariance[PHI, PHI].diagonal()).tolist())
    return GoodMount(Correction.turning(solution.housing).rotation, own)


def _as_angles(sent: SentDeviations) -> tuple[float, float, float]:
    """Return three angles [rad]: level zero y and level zero x as tilts, and the larger of
    cross-talk xy and yx as a yaw."""
    return sent.zero_y / GRAVITY, sent.zero_x / GRAVITY, max(sent.xy, sent.yx)


def _block(p: SignalBlock, signals: OtherSignals) -> Block:
    """Return the part of a block that the joint solution uses. signals: signals that the vehicle
    has.
    """
    use, speed = p.ok_force & p.learn, p.speed
    if signals.speed:
        use &= p.ok_speed & p.has_speed
    else:  # in the first blocks it was not known yet that none comes
        speed = p.nominal_speed
    knots = MIDDLES if p.speed_knots is None else p.speed_knots
    if signals.gyro:
        use &= p.had_rate
        known = bool(p.ok_rate.any())
        of_rate = known, p.gyro_bias, p.rate_walk
        of_drive = knots, p.least_speed, p.rest
        return Block(p.force, p.rate, speed, use, *of_rate, *of_drive, p.turn_zero_std)
    if signals.turns:
        use &= p.ok_yaw
    rate = np.zeros_like(p.rate)
    rate[:, 2] = p.yaw_rate * p.ok_yaw
    least = p.least_speed
    return Block(p.force, rate, speed, use, knots=knots, least_speed=least, rest=p.rest)
