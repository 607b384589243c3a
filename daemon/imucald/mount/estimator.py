"""The full mount estimator: roll, pitch and yaw of the sensor with an honest covariance.

What happens, in order:

1. Every tick goes to `SignalBlockMaker`; every 6.4 s it gives a block of even signals, each tick
   flagged by whether it may be learnt from (`motion.signal_health`).
2. `MountSolver.add` takes the block: the gyroscope carries the vertical through it, what is left
   of the force goes to windows in the frequency domain and to the mean of gravity.
3. `SignalChecks` holds the signals against one another: a contradiction that begins or ends makes
   the solver begin anew.
4. `MountSolver.fit` turns all evidence so far into one rotation with variances.
5. Once gyro bias and rotation are known, `Refit` goes through the first minutes a second time.
6. After that `MountChanges` holds every block against what was known before it. A sensor that was
   moved makes the mount suspect; `Refit` starts again from what came after the change.
7. `judged` gives the state, with hysteresis, `Acceptance` bounds it, and `SlewedRotation` follows
   the rotation without a jump. `MountEstimate` says all of it, and what each angle waits for.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import Matrix3
from imucald.motion.ticks import TickRow
from imucald.mount.acceptance import Acceptance
from imucald.mount.contradictions import StandingFault
from imucald.mount.creep import P_CONSTANT, P_CONSTANT_AGAIN
from imucald.mount.estimate import Correction, MountEstimate, MountState
from imucald.mount.estimate_details import creep_details, estimate_details
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.hysteresis import GOOD
from imucald.mount.large_change import LargeChange
from imucald.mount.manoeuvres import Manoeuvres
from imucald.mount.mount_changes import MountChange, MountChanges, blocks_since
from imucald.mount.off_vertical_limit import is_off_vertical
from imucald.mount.refit import KEPT_BLOCKS, Refit
from imucald.mount.reported_rotation import ReportedRotation
from imucald.mount.saved_information import SavedInformation
from imucald.mount.signal_blocks import SignalBlock, SignalBlockMaker
from imucald.mount.signal_checks import SignalChecks
from imucald.mount.slewing import SlewedRotation
from imucald.mount.solver import MountSolver
from imucald.mount.states import MountKnowledge, judged, reported
from imucald.mount.steering import SteeringOffsetEstimator
from imucald.mount.waiting_reasons import mount_troubles, waiting_reasons

Array = NDArray[np.float64]

EAGER_BLOCKS = 20
"""Up to so many blocks (128 s) each is followed by a fit."""
LAZY_BLOCKS = 2
"""Later every second (13 s): by then a block adds little, and fits are what costs."""
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
FROZEN_TICKS = 40
"""Learning counts as frozen when so many of a block's ticks were not to be trusted."""


class FullEstimator:
    """Estimate from all evidence; see the steps above.

    State: `_signals` (ticks, offsets, signal health), `_solver` (the evidence and its rotation),
    `_refit` (the solver to come, while one is being made), `_kept` (the blocks it is made of),
    `_checks` and `_changes` (what speaks against the rotation), `_driven` and `_known` (what the
    state is judged by), `_served` (what is applied; `_moved`: since it was, the mount has moved
    and nothing good was found).
    """

    def __init__(self, settings: EstimatorSettings | None = None) -> None:
        self._settings = settings or EstimatorSettings()
        self._signals = SignalBlockMaker(self._settings)
        self._solver = MountSolver(self._settings)
        self._refit: Refit | None = None
        self._kept: deque[SignalBlock] = deque(maxlen=KEPT_BLOCKS)
        self._looked_again = False
        self._checks = SignalChecks(self._settings)
        self._changes = MountChanges(self._settings)
        self._driven = Manoeuvres()
        self._steering = SteeringOffsetEstimator()
        self._known = MountKnowledge(begun=False, accelerometer=False)
        self._state = MountState.WAITING
        self._served = SlewedRotation(SLEW_RATE)
        self._moved = False
        self._segment = 0
        self._failed_for = 0
        self._rotation = ReportedRotation(self._settings)
        self._estimate: MountEstimate | None = None

    @property
    def correction(self) -> Correction | None:
        """The rotation to apply now, or None."""
        return self._served.correction

    @property
    def state(self) -> MountState:
        """The present state."""
        return self._state

    @property
    def faults(self) -> tuple[str, ...]:
        """Contradictions that stand now, by the names of `StandingFault`."""
        return tuple(fault.value for fault in self._checks.standing)

    # tick by tick ---------------------------------------------------------------------------

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

    # block by block -------------------------------------------------------------------------

    def _take_block(self, p: SignalBlock) -> None:
        """Learn from a block; numbers that no arithmetic bears freeze learning and are told."""
        self._failed_for = max(self._failed_for - 1, 0)
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                self._learn_from(p)
        except (np.linalg.LinAlgError, ArithmeticError):
            self._failed_for = FAILED_BLOCKS
            self._begin_without_rotation()  # numbers that cannot be are in what was learnt
        self._judge(p)

    def _learn_from(self, p: SignalBlock) -> None:
        self._kept.append(p)
        self._follow_speed()
        self._driven.add(*self._solver.add(p))
        self._follow_steering(p)
        turned = (
            self._changes.at_once(p, self._solver, self._signals) if self._can_compare else None
        )
        if turned is not None:  # the gyroscope turned and the vehicle did not: no sign or unit does
            self._checks.forget_forces()
        elif self._checks.add(p, self._solver, self._signals, self._kept):
            self._begin_without_rotation([p])
        is_refitting = self._refit is not None
        if self._refit is not None:
            self._refit.push(p)
        is_turn = self._signals.blocks % LAZY_BLOCKS == 0 or self._changes.is_near
        if is_turn or self._solver.blocks <= EAGER_BLOCKS:
            self._fit()
        self._follow_creep()
        if self._look_for_large_change(p, turned) or is_refitting:
            return
        if not self._looked_again:
            self._look_again()
        elif (change := self._changes.small(self._solver, thoroughly=is_turn)) is not None:
            self._take_change(change)

    def _follow_speed(self) -> None:
        """Begin anew where a speed has come, or will not come: the evidence is of another kind."""
        if self._signals.without_speed != self._solver.response.without_speed:
            self._solver = self._new_solver()

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

    def _fit(self) -> None:
        starts = self._solver.starts
        self._solver.fit()
        if self._solver.starts > starts:  # what the forces said was said of another rotation
            self._checks.forget_forces()

    def _follow_creep(self) -> None:
        """See once a road segment whether the mount creeps."""
        if self._solver.response.segment != self._segment:
            self._segment = self._solver.response.segment
            self._solver.p_constant = P_CONSTANT_AGAIN if self._changes.history else P_CONSTANT
            self._solver.follow_creep()

    @property
    def _can_compare(self) -> bool:
        """Whether new blocks can be compared with a rotation."""
        is_old = self._moved and self._refit is not None
        return self._solver.R is not None and self._solver.yaw_known and not is_old

    def _look_for_large_change(self, p: SignalBlock, turned: LargeChange | None) -> bool:
        """Look for a turn by several degrees, and for gravity far from the vertical.

        turned: what the block has shown by itself. True: there was one, and it was dealt with.
        """
        solver, changes = self._solver, self._changes
        if solver.R is None or not self._can_compare:
            changes.skip()
            return False
        if is_off_vertical(p, solver.R, p.speed * solver.turn_rate):
            self._begin_without_rotation([p])
            return True
        changes.add(p, solver, not self._signals.without_speed)
        if self._state not in GOOD:  # nothing is served as good, and the fit is young
            if turned is not None:
                self._begin_without_rotation()
                self._moved = self._served.correction is not None
            return turned is not None
        found = changes.large(solver) if turned is None else turned
        if found is not None:
            self._take_change(found)
        return found is not None

    def _take_change(self, found: MountChange) -> None:
        """The sensor was moved: what came in the blocks after is all that counts."""
        self._changes.history.append((self._signals.blocks, found))
        kept = blocks_since(found, self._kept)
        if abs(found.size) > AFRESH:
            self._begin_without_rotation(kept)
            return
        self._moved = self._looked_again = True
        self._solver.past_drives = None  # it is about the mount before
        self._driven = Manoeuvres()
        self._changes.restart()
        self._begin_refit(kept)

    # beginning anew -------------------------------------------------------------------------

    def _new_solver(self) -> MountSolver:
        solver = MountSolver(self._settings)
        solver.response.without_speed = self._signals.without_speed
        return solver

    def _begin_without_rotation(self, blocks: Iterable[SignalBlock] = ()) -> None:
        """Begin anew from these blocks: not even the rotation so far is a hint."""
        self._moved = self._looked_again = True
        self._driven = Manoeuvres()
        self._solver = self._new_solver()
        self._refit = None
        self._changes.restart()
        self._checks.restart()
        for p in blocks:
            self._driven.add(*self._solver.add(p))

    def _look_again(self) -> None:
        """Once gyro bias and rotation are known, go through the first minutes again."""
        is_bias_known = self._signals.offsets.gyro_ticks >= KNOWN_REST_TICKS
        is_rotation_known = self._solver.sure()
        is_long_enough = len(self._kept) >= FIRST_LOOK_BLOCKS
        is_late = len(self._kept) >= LAST_LOOK_BLOCKS
        if is_rotation_known and is_long_enough and (is_bias_known or is_late):
            self._looked_again = True
            self._begin_refit(self._kept)

    def _begin_refit(self, blocks: Iterable[SignalBlock]) -> None:
        fresh = MountSolver(self._settings)
        fresh.start_from(self._solver)
        self._refit = Refit(fresh, list(blocks), self._signals.offsets.gyro_bias.copy())

    def _go_on_refitting(self, refit: Refit) -> None:
        done = refit.step()
        if done is not None:
            if self._moved:
                self._driven.add(*done)
            return
        self._solver, self._refit = refit.fresh, None

    # judging --------------------------------------------------------------------------------

    def _judge(self, p: SignalBlock) -> None:
        if self._failed_for:
            self._checks.accuse(StandingFault.NUMERICS)
        self._checks.hold_against_orientation(self._solver, self._signals.blocks)
        self._known = self._knowledge(p)
        found = self._accepted(judged(self._known, self._state, self._settings))
        was_good, is_serving = self._state in GOOD, self._served.correction is not None
        has_faults, is_refitting = bool(self._checks.standing), self._refit is not None
        self._state = reported(found, has_faults, is_serving, self._moved, is_refitting)
        if self._state not in GOOD:
            return
        self._served.aim(self._rotation.of(self._solver, self._moving())[0])
        if was_good or self._served.has_arrived:
            self._moved = False
        else:  # good again, but what is applied is still on the way from what was wrong
            self._state = MountState.RECALIBRATING

    def _knowledge(self, p: SignalBlock) -> MountKnowledge:
        """What is known after a block."""
        solver, driven, fused = self._solver, self._driven, self._solver.fused
        std = (math.inf, math.inf, math.inf)
        if fused is not None:
            x, y, z = (math.sqrt(v) for v in (fused.variance + self._moving()).tolist())
            std = (x, y, z if solver.yaw_known else math.inf)
        return MountKnowledge(
            gravity=fused is not None,
            std=std,
            straight=driven.straight,
            lefts=driven.lefts,
            rights=driven.rights,
            stops=solver.gravity.stops,
            accelerometer=bool(p.ok_force.any()),
            speed=not self._signals.without_speed and bool(p.ok_speed.any()),
            frozen=int((~p.learn & p.ok_force).sum()) >= FROZEN_TICKS,
            yaw_seen=solver.yaw_seen,
            cross_axis=solver.cross_axis_std,
        )

    def _moving(self) -> Array:
        return self._changes.variance(self._solver, self._signals.blocks)

    @property
    def _acceptance(self) -> Acceptance:
        has_speed = not self._signals.without_speed
        return Acceptance(self._solver, self._checks, self._changes, has_speed)

    def _accepted(self, found: MountState) -> MountState:
        """No *fine* before the tests can see, and nothing good in the face of a contradiction."""
        acceptance = self._acceptance
        is_serving = self._served.correction is not None and not self._moved
        if found in GOOD and not is_serving and acceptance.missing_to_be_good() is not None:
            return MountState.LEVELLED
        if found is MountState.FINE and not acceptance.may_be_fine():
            return MountState.USABLE
        return found

    def estimate(self) -> MountEstimate:
        """Return the present state of knowledge; the same one until something has been learnt."""
        if self._estimate is None:
            self._estimate = self._new_estimate()
        return self._estimate

    def _new_estimate(self) -> MountEstimate:
        solver, state, changes, checks = self._solver, self._state, self._changes, self._checks
        creeping = creep_details(solver.creep)
        troubles = mount_troubles(state, checks.standing, creeping, changes.shifted_again())
        words, codes = waiting_reasons(
            self._known, state, self._settings, self._acceptance, troubles
        )
        if solver.fused is None:
            R = covariance = None
            details: dict[str, object] = {}
        else:
            R, covariance = self._rotation.of(solver, self._moving())
            steering = self._steering_fitted()
            details = estimate_details(
                solver, self._signals, self._known, changes, checks, steering
            )
        targets = self._settings.targets
        return MountEstimate(state, R, covariance, words, codes, details, self.faults, targets)

    # what a person says, and what outlives the process; see `mount.restored` ------------------

    def take_stated_mount(self, R: Matrix3) -> None:
        """A person states the mount: it rules out what no signal may, where it is the one found."""
        self._checks.take_mount(R)

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
