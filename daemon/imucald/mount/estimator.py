"""The full mount estimator: roll, pitch and yaw of the sensor with an honest covariance.

What happens, in order:

1. Every tick goes to `SignalBlockMaker`; every 6.4 s it gives a block of even signals, each tick
   flagged by whether it may be learnt from (`motion.signal_health`).
2. `MountSolver.add` takes the block: the gyroscope carries the vertical through it, what is left
   of the force goes to windows in the frequency domain and to the mean of gravity.
3. `MountSolver.fit` turns all evidence so far into one rotation with variances.
4. Once gyro bias and rotation are known, `Refit` goes through the first minutes a second time.
5. After that every block is held against what was known before it. A sensor that was moved makes
   the mount suspect; `Refit` starts again from what came after the shift.
6. `judged` gives the state, with hysteresis, and `SlewedRotation` follows the rotation without a
   jump. `MountEstimate` says all of it, and what each angle waits for.
"""

from __future__ import annotations

import math
import operator
from collections import deque

import numpy as np
from numpy.typing import NDArray

from imucald.config.base import MAX_SPEED_DELAY
from imucald.core.rotations import Matrix3, rotation_from_vector
from imucald.motion.ticks import TickRow
from imucald.mount.alternatives import TO_BE_FINE, TO_BE_GOOD, Alternatives
from imucald.mount.contradictions import WORDS, Contradictions, StandingFault
from imucald.mount.creep import BELIEVED, P_CONSTANT, P_CONSTANT_AGAIN
from imucald.mount.estimate import ANGLES, Correction, Missing, MountEstimate, MountState
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.evidence_response import GROUP
from imucald.mount.gravity_step import GravityStep
from imucald.mount.hysteresis import GOOD
from imucald.mount.large_change import LargeChange, LargeChangeDetector
from imucald.mount.manoeuvres import Manoeuvres
from imucald.mount.off_vertical_limit import is_off_vertical
from imucald.mount.priors import YAW_PER_CROWN
from imucald.mount.refit import KEPT_BLOCKS, Refit
from imucald.mount.saved_information import SavedInformation
from imucald.mount.shift import Shift
from imucald.mount.signal_blocks import BLOCK_S, SignalBlock, SignalBlockMaker
from imucald.mount.slewing import SlewedRotation
from imucald.mount.solver import MountSolver
from imucald.mount.states import MountKnowledge, judged, reported, waiting_for
from imucald.mount.steering import SteeringOffsetEstimator

Array = NDArray[np.float64]

EAGER_BLOCKS = 20
"""Up to so many blocks (128 s) each is followed by a fit."""
LAZY_BLOCKS = 2
"""Later every second (13 s): by then a block adds little, and fits are what costs."""
NEAR_SHIFT = 0.8
"""While a change comes to so much of the threshold, every block is followed by a fit again."""
SLEW_RATE = math.radians(0.5)
"""The applied rotation turns no faster than this [rad/s]."""
KNOWN_REST_TICKS = 25.0
"""Ticks at rest from which the gyro bias counts as known."""
FIRST_LOOK_BLOCKS = 14
"""The second look takes at least that many blocks (90 s)."""
LAST_LOOK_BLOCKS = 28
"""Without a rest to know the gyro bias from, it waits no longer than that (3 min)."""
FAILED_BLOCKS = 14
"""Numbers out of range stand as a fault for so long after the last of them (90 s)."""
AFRESH = math.radians(20.0)
"""After a turn by more [rad] not even the rotation so far is a hint of the new one."""
STUCK_BLOCKS = 40
"""While a contradiction stands the rotation is sought anew every 4 min: the mount may move."""
FOUND_ANEW = frozenset({StandingFault.FORCE_TURNS, StandingFault.FORCE_SPEED})
"""Faults that end by a rotation that was found while they stood: that one stays."""
SHIFTS_ALLOWED = 1
"""After more of them in one drive the mount is loose: it is never *fine*."""
MOST_OF_LEAN = 0.9
"""Yaw's deviation is at most in so much that of the road's lean: a covariance stays one."""
MIRRORED = (
    "a signal that separates left from right (yaw rate, steering angle, lateral acceleration, "
    "heading), or 'calibration: {orientation: {up: z}}' with the axis that points up: without, an "
    "accelerometer with all signs turned looks the same"
)
"""What keeps an estimate that is certain enough from being *fine* where no signal has sides."""
LATE_SPEED = (
    f"a speed that comes sooner: it seems later than {MAX_SPEED_DELAY:g} s behind the accelerometer"
)
FROZEN_TICKS = 40
"""Learning counts as frozen when so many of a block's ticks were not to be trusted."""


class FullEstimator:
    """Estimate from all evidence; see the steps above.

    State: `_signals` (ticks, offsets, signal health), `_solver` (the evidence and its rotation),
    `_refit` (the solver to come, while one is being made), `_kept` (the blocks it is made of),
    `_driven` and `_known` (what the state is judged by), `_served` (what is applied).
    """

    def __init__(self, settings: EstimatorSettings | None = None) -> None:
        self._settings = settings or EstimatorSettings()
        self._signals = SignalBlockMaker(self._settings)
        self._solver = MountSolver(self._settings)
        self._driven = Manoeuvres()
        self._steering = SteeringOffsetEstimator()
        self._served = SlewedRotation(SLEW_RATE)
        self._state = MountState.WAITING
        self._blocks = 0
        self._kept: deque[SignalBlock] = deque(maxlen=KEPT_BLOCKS)
        self._refit: Refit | None = None
        self._looked_again = False
        self._moved = self._stands_out = False
        self._shifts: list[tuple[int, Shift | GravityStep | LargeChange]] = []
        self._contradictions = Contradictions(self._settings)
        self._alternatives = Alternatives(self._settings)
        self._large = LargeChangeDetector(self._settings)
        self._faults: tuple[StandingFault, ...] = ()
        self._faults_seen: list[tuple[int, StandingFault]] = []
        self._segment = 0
        self._failures = 0
        self._failed_for = 0
        self._known = MountKnowledge(begun=False, accelerometer=False)
        self._estimate: MountEstimate | None = None
        self._answered: tuple[tuple[object, ...], tuple[Array, Array]] | None = None

    @property
    def correction(self) -> Correction | None:
        """The rotation to apply now, or None."""
        return self._served.correction

    @property
    def state(self) -> MountState:
        """The present state."""
        return self._state

    def step(self, tick: TickRow) -> None:
        """Take one tick."""
        self._served.step()
        if self._refit is not None:
            self._go_on_refitting(self._refit)
            self._estimate = None
        if self._signals.push(tick):
            self._take_block(self._signals.block())
            self._estimate = None

    def quiet_ticks(self) -> int:
        """Of the next ticks so many are only kept, see `mount.estimate.KeepsTicks`."""
        if self._refit is not None or self._served.is_moving:
            return 0
        return self._signals.until_block - 1

    def keep_quiet(self, ticks: Array) -> None:
        """Take ticks (n, COLUMNS), no more than `quiet_ticks`."""
        self._signals.push_all(ticks)

    def gap(self) -> None:
        """Time jumped: signals before it are not joined with those after it."""
        self._signals.restart()
        if self._refit is not None and self._moved:
            self._solver = self._refit.fresh  # what came before the shift must not return
        self._solver.gap()
        self._refit = None
        self._kept.clear()
        self._estimate = None

    @property
    def faults(self) -> tuple[str, ...]:
        """Contradictions that stand now, by the names of `StandingFault`."""
        return tuple(fault.value for fault in self._faults)

    def _take_block(self, p: SignalBlock) -> None:
        """Learn from a block; numbers that no arithmetic bears freeze learning and are told."""
        self._blocks += 1
        self._failed_for = max(self._failed_for - 1, 0)
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                self._learn_from(p)
        except (np.linalg.LinAlgError, ArithmeticError):
            self._fail()
        self._judge(p)

    def _fail(self) -> None:
        """Drop what was learnt: numbers that cannot be are in it."""
        self._failures += 1
        self._failed_for = FAILED_BLOCKS
        self._begin_without_rotation([])

    def _learn_from(self, p: SignalBlock) -> None:
        self._kept.append(p)
        self._follow_speed()
        self._driven.add(*self._solver.add(p))
        self._follow_steering(p)
        change = self._turned_by_hand(p)
        if change is None:
            self._watch(p)
        else:  # the gyroscope turned and the vehicle did not: that contradicts no sign and no unit
            self._contradictions.forget_forces()
        if self._refit is not None:
            self._refit.push(p)
        is_turn = self._blocks % LAZY_BLOCKS == 0 or self._stands_out
        is_young = self._solver.blocks <= EAGER_BLOCKS
        is_refitting = self._refit is not None
        if is_turn or is_young:
            starts = self._solver.starts
            self._solver.fit()
            if self._solver.starts > starts:  # what the forces said was said of another rotation
                self._contradictions.forget_forces()
        if self._solver.response.segment != self._segment:
            self._segment = self._solver.response.segment
            self._solver.p_constant = P_CONSTANT_AGAIN if self._shifts else P_CONSTANT
            self._solver.follow_creep()
        if self._look_for_large_change(p, change):
            return
        if not is_refitting and not self._looked_again:
            self._look_again()
        elif not is_refitting:
            self._look_for_shift(thoroughly=is_turn)

    def _watch(self, p: SignalBlock) -> None:
        """Hold the signals against one another; a contradiction that has ended begins anew."""
        solver, signals = self._solver, self._signals
        if signals.without_speed:
            self._faults = ()
            self._alternatives.add_without_speed(p, solver.R, signals.seen)
            return
        R = solver.R if solver.yaw_known else None
        self._contradictions.add(
            p,
            solver.turn_rate,
            solver.own_gyro,
            R,
            signals.steering_offset,
            "yaw_rate" in signals.seen,
            solver.delay_speed.value if solver.delay_speed.is_known else None,
        )
        offset = signals.steering_offset
        self._alternatives.add(self._kept, R, solver.bias, solver.gains(), signals.seen, offset)
        before = tuple(f for f in self._faults if f is not StandingFault.ORIENTATION)
        self._faults = self._contradictions.faults
        if self._alternatives.gyro_accused and (solver.sure() or StandingFault.GYRO_AXES in before):
            self._faults = (*self._faults, StandingFault.GYRO_AXES)
        new = [fault for fault in self._faults if fault not in before]
        self._faults_seen += [(self._blocks, fault) for fault in new]
        is_stuck = bool(self._faults) and self._solver.blocks >= STUCK_BLOCKS
        if new or (before and not self._faults and FOUND_ANEW.isdisjoint(before)) or is_stuck:
            self._begin_without_rotation([p])

    @property
    def _can_compare(self) -> bool:
        """Whether new blocks can be compared with the rotation, where there is one."""
        return self._solver.yaw_known and not (self._moved and self._refit is not None)

    def _turned_by_hand(self, p: SignalBlock) -> LargeChange | None:
        """A turn that is seen at once: while standing, or by the gyroscope alone."""
        solver, large = self._solver, self._large
        if solver.R is None or not self._can_compare:
            return None
        change = large.while_standing(p, solver.R)
        if change is None and solver.own_gyro and self._has_speed:
            motion = solver.motion(p, solver.R)
            change = large.while_driving(p, motion, "yaw_rate" in self._signals.seen)
        return change

    def _look_for_large_change(self, p: SignalBlock, change: LargeChange | None) -> bool:
        """Look for a turn by several degrees, and for gravity far from the vertical.

        change: what was seen at once.
        """
        solver, large = self._solver, self._large
        if solver.R is None or not self._can_compare:
            large.restart()
            return False
        if is_off_vertical(p, solver.R, p.speed * solver.turn_rate):
            self._begin_without_rotation([p])
            return True
        large.add(p, solver.R, solver.motion(p, solver.R), self._has_speed)
        if self._state not in GOOD:  # nothing is served as good, and the fit is young
            if change is not None:
                self._begin_without_rotation([])
                self._moved = self._served.correction is not None
            return change is not None
        if change is None:
            change = large.found((0, 1, 2) if solver.own_gyro else (0, 1))
        if change is None:
            return False
        self._take_shift(change, change.blocks - 1)  # the oldest holds the change itself
        return True

    @property
    def _has_speed(self) -> bool:
        return not self._signals.without_speed

    def _begin_without_rotation(self, blocks: list[SignalBlock]) -> None:
        """Begin anew from these blocks: not even the rotation so far is a hint."""
        self._moved, self._stands_out = True, False
        self._driven = Manoeuvres()
        self._looked_again = True
        self._solver = MountSolver(self._settings)
        self._solver.response.without_speed = self._signals.without_speed
        self._refit = None
        self._large.restart()
        self._contradictions.forget_forces()
        self._alternatives.restart()
        for p in blocks:
            self._driven.add(*self._solver.add(p))

    def _follow_speed(self) -> None:
        """Begin anew where a speed has come, or will not come: the evidence is of another kind."""
        if self._signals.without_speed != self._solver.response.without_speed:
            self._solver = MountSolver(self._settings)
            self._solver.response.without_speed = self._signals.without_speed

    def _follow_steering(self, p: SignalBlock) -> None:
        """Steering offset against the measured yaw rate; steering alone knows no offset."""
        measured = self._solver.own_gyro or "yaw_rate" in self._signals.seen
        if not measured or not p.ok_steering.any() or self._signals.without_speed:
            return
        use = p.ok_steering & p.ok_speed & p.learn
        self._steering.add(p.steering, p.speed, self._solver.turn_rate, use)
        fitted = self._steering_fitted()
        if fitted is not None:
            self._signals.steering_offset = fitted[0]

    def _steering_fitted(self) -> tuple[float, float] | None:
        s = self._settings
        return self._steering.fitted(s.crown, 1.5 * s.vehicle.crown_std)

    def _look_again(self) -> None:
        """Once gyro bias and rotation are known, go through the first minutes again."""
        is_bias_known = self._signals.offsets.gyro_ticks >= KNOWN_REST_TICKS
        is_rotation_known = self._solver.sure()
        is_long_enough = len(self._kept) >= FIRST_LOOK_BLOCKS
        is_late = len(self._kept) >= LAST_LOOK_BLOCKS
        if is_rotation_known and is_long_enough and (is_bias_known or is_late):
            self._looked_again = True
            self._begin_refit(list(self._kept))

    def _begin_refit(self, blocks: list[SignalBlock]) -> None:
        fresh = MountSolver(self._settings)
        fresh.start_from(self._solver)
        self._refit = Refit(fresh, blocks, self._signals.offsets.gyro_bias.copy())

    def _go_on_refitting(self, refit: Refit) -> None:
        done = refit.step()
        if done is not None:
            if self._moved:
                self._driven.add(*done)
            return
        self._solver, self._refit = refit.fresh, None

    def _look_for_shift(self, thoroughly: bool) -> None:
        """Look for a step now, and in the last minutes; on a shift keep what came after it."""
        found: Shift | GravityStep | None = self._solver.step()
        if found is None:
            if not thoroughly:
                return
            found = self._solver.largest_change()
            self._stands_out = found is not None and found.excess > NEAR_SHIFT
            if found is None or found.excess < 1.0:
                return
        after = found.blocks if isinstance(found, GravityStep) else found.segments * GROUP
        self._take_shift(found, after)

    def _take_shift(self, found: Shift | GravityStep | LargeChange, after: int) -> None:
        """The sensor was moved: what came in the blocks after is all that counts."""
        self._shifts.append((self._blocks, found))
        kept = list(self._kept)[max(len(self._kept) - after, 0) :]
        if abs(found.size) > AFRESH:
            self._begin_without_rotation(kept)
            return
        self._moved, self._stands_out = True, False
        self._solver.past_drives = None  # it is about the mount before
        self._driven = Manoeuvres()
        self._large.restart()
        self._looked_again = True
        self._begin_refit(kept)

    def _judge(self, p: SignalBlock) -> None:
        solver = self._solver
        if self._failed_for:
            self._faults = (*self._faults, StandingFault.NUMERICS)
        self._hold_against_orientation()
        fused = solver.fused
        std = (math.inf, math.inf, math.inf)
        if fused is not None:
            x, y, z = (math.sqrt(v) for v in (fused.variance + self._moving()).tolist())
            std = (x, y, z if solver.yaw_known else math.inf)
        self._known = MountKnowledge(
            gravity=fused is not None,
            std=std,
            straight=self._driven.straight,
            lefts=self._driven.lefts,
            rights=self._driven.rights,
            stops=solver.gravity.stops,
            accelerometer=bool(p.ok_force.any()),
            speed=not self._signals.without_speed and bool(p.ok_speed.any()),
            frozen=int((~p.learn & p.ok_force).sum()) >= FROZEN_TICKS,
            yaw_seen=solver.yaw_seen,
            cross_axis=solver.cross_axis_std,
        )
        found = judged(self._known, self._state, self._settings)
        was_good = self._state in GOOD
        self._state = self._state_by(self._allowed(found))
        if self._state not in GOOD:
            return
        self._served.aim(self._answer()[0])
        if was_good or self._served.has_arrived:
            self._moved = False
        else:  # good again, but what is applied is still on the way from what was wrong
            self._state = MountState.RECALIBRATING

    def _hold_against_orientation(self) -> None:
        """A fault where the sensor is found to sit the other way round than a person said."""
        solver, fault = self._solver, StandingFault.ORIENTATION
        if solver.R is None or fault in self._faults:
            return
        if self._alternatives.contradicts_orientation(solver.R, solver.yaw_known):
            self._faults = (*self._faults, fault)
            if fault not in {seen for _, seen in self._faults_seen}:
                self._faults_seen.append((self._blocks, fault))

    def _allowed(self, found: MountState) -> MountState:
        """No *fine* before the tests can see, and nothing good in the face of a contradiction."""
        serving = self._served.correction is not None and not self._moved
        if found in GOOD and not serving and self._hold_back() is not None:
            return MountState.LEVELLED
        if found is MountState.FINE and not self._may_be_fine():
            return MountState.USABLE
        return found

    def _hold_back(self) -> str | None:
        """Why an estimate whose deviations are small enough is not good yet; None: it is."""
        if self._signals.without_speed:
            return None
        if self._solver.delay_speed.is_beyond:
            return LATE_SPEED
        if self._contradictions.doubtful:
            return "more bends, as signals contradict one another"
        return self._alternatives.missing(TO_BE_GOOD)

    def _may_be_fine(self) -> bool:
        """Whether every test is armed, the signals were seen to agree, and little has happened."""
        if len(self._shifts) > SHIFTS_ALLOWED or not self._solver.armed:
            return False
        if not self._alternatives.is_mirror_excluded:
            return False
        if self._signals.without_speed:
            return True
        return self._contradictions.agreed and self._alternatives.are_seen(TO_BE_FINE)

    def _why_not_fine(self) -> str:
        """Why an estimate whose deviations are small enough is not *fine*."""
        if len(self._shifts) > SHIFTS_ALLOWED:
            return f"a mount that stays: it moved {len(self._shifts)} times in this drive"
        if self._alternatives.not_checked:
            return MIRRORED
        if not self._solver.armed:
            return "more driving, until a moved sensor would be noticed"
        return "more turns and changes of speed, until the signals are seen to agree"

    def _state_by(self, found: MountState) -> MountState:
        is_serving = self._served.correction is not None
        return reported(found, bool(self._faults), is_serving, self._moved, self._refit is not None)

    def _moving(self) -> Array:
        """Variance (3,) from a mount that moves: as it creeps, or as it was found to have moved.

        Each shift starts the evidence anew, so that creep hardly shows in what is left. A mount
        that was found turned the same way again and again goes on at that rate.
        """
        creep = self._solver.creep
        more = np.zeros(3) if creep is None else creep.variance.copy()
        for axis, moved in enumerate(self._shifted_again()):
            since = moved / self._blocks * 0.5 * self._solver.blocks
            more[axis] = max(more[axis], since * since)
        return more

    def _shifted_again(self) -> list[float]:
        """How far each angle has moved [rad] where it was found to have shifted again; else 0."""
        by_axis = [[s.size for _, s in self._shifts if s.axis == axis] for axis in range(3)]
        return [math.fsum(x) if len(x) > SHIFTS_ALLOWED else 0.0 for x in by_axis]

    def _answer(self) -> tuple[Array, Array]:
        """R_vehicle_from_sensor with the crown taken out, and its covariance."""
        solver, s = self._solver, self._settings
        if solver.R is None or solver.fused is None:
            return np.eye(3), np.eye(3)
        made_of = (solver.R, solver.fused, solver.creep, solver.yaw_known)
        if self._answered is not None and all(map(operator.is_, self._answered[0], made_of)):
            return self._answered[1]
        R = rotation_from_vector([-s.crown, 0.0, 0.0]) @ solver.R
        variance = solver.fused.variance.copy()
        if solver.creep is not None:
            R = rotation_from_vector(solver.creep.level) @ R
        variance += self._moving()
        if not solver.yaw_known:
            variance[2] = (math.pi / math.sqrt(3.0)) ** 2
        covariance = np.diag(variance)
        lean = s.vehicle.crown_std
        covariance[0, 0] += lean**2
        if solver.yaw_known:  # and no more than yaw's own deviation allows
            of_lean = min(YAW_PER_CROWN * lean, MOST_OF_LEAN * math.sqrt(variance[2]))
            covariance[0, 2] = covariance[2, 0] = lean * of_lean
        self._answered = made_of, (R, covariance)
        return R, covariance

    # what a person says, and what outlives the process; see `mount.restored`

    def take_stated_mount(self, R: Matrix3) -> None:
        """A person states the mount: it rules out what no signal may, where it is the one found."""
        self._alternatives.take_mount(R)

    @property
    def contradiction(self) -> float | None:
        """Chi-square (3) of past drives' evidence against this one's; None without any."""
        past = self._solver.past_drives
        return None if past is None else past.contradiction

    def saved_information(self) -> SavedInformation | None:
        """What all evidence comes to, for the next start; None where there is too little."""
        return None if self._refit is not None and self._moved else self._solver.kept()

    def join_information(self, kept: SavedInformation) -> None:
        """Go on with what past drives found as well."""
        for solver in self._solvers():
            solver.join(kept)
        self._solver.fit()
        self._estimate = None

    def drop_information(self) -> None:
        """Go on with this drive's evidence alone."""
        for solver in self._solvers():
            solver.past_drives = None
        self._solver.fit()
        self._estimate = None

    def _solvers(self) -> list[MountSolver]:
        refit = self._refit
        return [self._solver] if refit is None else [self._solver, refit.fresh]

    def estimate(self) -> MountEstimate:
        """Return the present state of knowledge; the same one until something has been learnt."""
        if self._estimate is None:
            self._estimate = self._knowledge()
        return self._estimate

    def _knowledge(self) -> MountEstimate:
        reasons = waiting_for(self._known, self._settings)
        words = {name: text for name, (text, _) in reasons.items()}
        codes = {name: code for name, (_, code) in reasons.items()}
        for angle, text in self._troubles().items():
            words[angle], codes[angle] = text, Missing.OTHER
        if self._state is MountState.LEVELLED and (held := self._hold_back()) is not None:
            words = {angle: words.get(angle, held) for angle in ANGLES}
            codes = {angle: codes.get(angle, Missing.AGREEMENT) for angle in ANGLES}
        has_no_sides = bool(self._alternatives.not_checked)
        if self._state is MountState.USABLE and (has_no_sides or not words):
            code = Missing.AGREEMENT if has_no_sides else Missing.NOTHING
            words = dict.fromkeys(ANGLES, self._why_not_fine()) | words
            codes = dict.fromkeys(ANGLES, code) | codes
        targets = self._settings.targets
        if self._solver.fused is None:
            return MountEstimate(
                self._state,
                waiting_for=words,
                missing=codes,
                faults=self.faults,
                targets=targets,
            )
        R, covariance = self._answer()
        return MountEstimate(
            self._state, R, covariance, words, codes, self._details(), self.faults, targets
        )

    def _troubles(self) -> dict[str, str]:
        """What more driving does not mend, per angle: contradictions, and a mount that moves."""
        if self._faults:
            text = "; ".join(WORDS[fault] for fault in self._faults)
            return dict.fromkeys(ANGLES, text)
        if self._state is MountState.FINE:
            return {}
        creeping = self._creep()
        if self._state in GOOD:
            return {
                angle: f"the mount creeps: about {abs(found['deg_per_h']):.0f} deg/h"
                for angle, found in creeping.items()
            }
        moved = {angle: found["moved_deg"] for angle, found in creeping.items()}
        for angle, shifted in zip(ANGLES, self._shifted_again(), strict=True):
            if shifted:
                moved[angle] = math.degrees(shifted)
        return {
            angle: f"the mount moves by {abs(degrees):.1f} deg within the drive"
            for angle, degrees in moved.items()
        }

    def _creep(self) -> dict[str, dict[str, float]]:
        """Angles that creep: how fast by the time of driving, how far so far, how sure that is."""
        creep = self._solver.creep
        if creep is None:
            return {}
        an_hour = 3600.0 / (GROUP * BLOCK_S)
        return {
            angle: {
                "deg_per_h": math.degrees(float(creep.rate[i])) * an_hour,
                "moved_deg": math.degrees(float(creep.moved[i])),
                "probability": float(creep.probability[i]),
            }
            for i, angle in enumerate(ANGLES)
            if creep.probability[i] > BELIEVED
        }

    def _details(self) -> dict[str, object]:
        solver, signals, known = self._solver, self._signals, self._known
        fused = solver.fused
        bias = solver.bias
        steering = self._steering_fitted()
        return {
            "evidence_share": {} if fused is None else fused.shares,
            "evidence_std_deg": {
                name: math.degrees(math.sqrt(source.variance))
                for name, source in solver.sources.items()
            },
            "accel_bias": [] if bias is None else bias.tolist(),
            "gyro_bias": signals.offsets.gyro_bias.tolist(),
            "yaw_rate_offset": signals.offsets.yaw_rate,
            "steering_offset": None if steering is None else steering[0],
            "steering_offset_std": None if steering is None else steering[1],
            "speed_delay": solver.delay_speed.value,
            "speed_delay_std": solver.delay_speed.std,
            "gain_dvdt": solver.gains()[0],
            "gain_turn": solver.gains()[1],
            "launches_and_brakings": known.straight,
            "left_turns": known.lefts,
            "right_turns": known.rights,
            "stops": known.stops,
            "distance": solver.gravity.metres,
            "shifts": [
                {
                    "t": block * BLOCK_S,
                    "angle": ANGLES[shift.axis],
                    "size_deg": math.degrees(shift.size),
                    "deviations": shift.deviations,
                }
                for block, shift in self._shifts
            ],
            "creep": self._creep(),
            "cross_axis_std": solver.cross_axis_std,
            "faults": [
                {"t": block * BLOCK_S, "fault": fault.value} for block, fault in self._faults_seen
            ],
            "not_checked": list(self._alternatives.not_checked),
            "frozen_ticks": dict(signals.health.counts),
        }
