"""The full mount estimator: roll, pitch and yaw of the sensor with their covariance.

Order of the steps:

1. Every tick goes to `SignalBlockMaker`; every 6.4 s it gives a block of even signals, each tick
with a flag that says whether it is usable (`motion.signal_health`).
2. `MountSolver.add` takes the block. The gyroscope carries the vertical through it. The force minus
   this vertical goes to windows in the frequency domain and to the mean of gravity.
3. `SignalChecks` compares the signals with one another: a contradiction that begins or ends makes
   the solver restart. `ForceLevel` compares the size of gravity with its own past.
4. `MountSolver.fit` turns all evidence so far into one rotation with variances, as soon as enough
   has come since the last one (`RestartableSolver.is_turn`).
5. Once gyro bias and rotation are known, `RestartableSolver` goes through the first minutes again.
6. After that `MountChanges` compares every block with what was known before it. If the sensor was
   moved, the mount becomes suspect and the solver starts again with the data after the change. If
   the change misleads no consumer, it is reported, and the interval covers it until a second solver
   knows the new mount.
7. `ServedMount` gives the state, with hysteresis, and follows a good rotation without a jump.
   `MountEstimate` reports all of it, and what each angle waits for.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterable, Mapping

import numpy as np
from msgspec.structs import replace

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.motion.ticks import TickRow
from imucald.mount.acceptance import Acceptance
from imucald.mount.contradictions import StandingFault
from imucald.mount.estimate import Correction, MountEstimate, MountState, SentDeviations
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.explanation import (
    ProgressWatch,
    creep_details,
    estimate_details,
    left_out_details,
    level_details,
    mount_troubles,
    waiting_reasons,
)
from imucald.mount.force_level import ForceLevel
from imucald.mount.hysteresis import GOOD
from imucald.mount.large_change import LargeChange
from imucald.mount.mount_changes import GoodMount, MountChange, MountChanges, blocks_since
from imucald.mount.off_vertical_limit import is_off_vertical
from imucald.mount.restartable_solver import RestartableSolver
from imucald.mount.saved_information import SavedInformation
from imucald.mount.served_mount import ReportedRotation, ServedMount
from imucald.mount.signal_blocks import BLOCK_S, MountSoFar, SignalBlock, SignalBlockMaker
from imucald.mount.signal_checks import SignalChecks
from imucald.mount.solver import MountSolver
from imucald.mount.states import MountKnowledge, targets_in_force
from imucald.mount.steering import SteeringOffsetEstimator
from imucald.mount.zero_step import GravityMoved

FAILED_BLOCKS = 14
"""Numbers out of range stay reported as a fault for this many blocks after the last of them (90 s).
"""
MINUTE_BLOCKS = 10
"""Blocks (a minute) that decide which conditions are missing. A condition that fails in a single
block usually returns.
"""
TURNING = frozenset({"yaw_rate", "steering"})
FROZEN_TICKS = 40
"""Learning counts as frozen when at least this many ticks of a block are not trusted."""


class FullEstimator:
    """Estimate the mount from all evidence; see the steps in the module docstring.

    State: `_signals` (ticks, offsets, signal health), `_solvers` (the evidence and its rotation),
    `_checks` and `_changes` (evidence against that rotation), `_known` (knowledge by which the
    state is judged), `_served` (the state and the applied correction).
    """

    def __init__(self, settings: EstimatorSettings | None = None) -> None:
        self._settings = settings or EstimatorSettings()
        self._signals = SignalBlockMaker(self._settings)
        self._steering = SteeringOffsetEstimator()
        self._solvers = RestartableSolver(self._settings)
        self._is_catching_up = False  # as of the solvers, which each tick would have to ask
        self._checks = SignalChecks(self._settings)
        self._changes = MountChanges(self._settings)
        self._level = ForceLevel()
        self._lately: deque[tuple[int, ...]] = deque(maxlen=MINUTE_BLOCKS)
        self._off_vertical = 0
        self._failed_for = 0
        self._known = MountKnowledge(begun=False, accelerometer=False)
        self._rotation = ReportedRotation(self._settings)
        self._served = ServedMount(self._settings)
        self._progress = ProgressWatch()
        self._estimate: MountEstimate | None = None

    @property
    def correction(self) -> Correction | None:
        """The rotation to apply now, or None."""
        return self._served.correction

    @property
    def state(self) -> MountState:
        """The present state."""
        return self._served.state

    @property
    def faults(self) -> tuple[str, ...]:
        """Contradictions that stand now, by the names of `StandingFault`."""
        return tuple(fault.value for fault in self._checks.standing)

    @property
    def stuck_signals(self) -> Mapping[str, bool]:
        """For each vehicle signal, whether it is stuck, see `mount.estimate.JudgesSignals`."""
        return self._signals.stuck

    def take_usual_signals(self, former: FullEstimator, channels: Collection[str]) -> None:
        """Take over, from another estimator, how long the vehicle's signals usually keep a value.

        channels: those that come from the same sources in both. Nothing is taken from a signal that
        is stuck.
        """
        self._signals.health.take_usual(former._signals.health, channels)

    @property
    def _solver(self) -> MountSolver:
        return self._solvers.now

    # tick by tick ---------------------------------------------------------------------------

    def step(self, tick: TickRow) -> None:
        """Take one tick."""
        self._served.step()
        if self._is_catching_up:
            self._solvers.step()
            self._is_catching_up = self._solvers.is_catching_up
            self._estimate = None
        if self._signals.push(tick):
            self._signals.take_mount(self._known_mount())
            self._take_block(self._signals.block())
            self._is_catching_up = self._solvers.is_catching_up
            self._estimate = None

    def expect(self, ticks: Array) -> None:
        """Prepare the next ticks (n, COLUMNS), see `mount.estimate.KeepsTicks`."""
        self._signals.expect(ticks)

    def quiet_ticks(self) -> int:
        """Number of next ticks that are only stored, see `mount.estimate.KeepsTicks`."""
        if self._is_catching_up or self._served.is_turning:
            return 0
        return self._signals.until_block - 1

    def keep_quiet(self, ticks: Array) -> None:
        """Take ticks (n, COLUMNS), at most `quiet_ticks`."""
        self._signals.push_all(ticks)

    def gap(self) -> None:
        """Note a jump of time: signals before it are not joined with those after it."""
        self._signals.restart()
        self._solvers.gap()
        self._is_catching_up = self._solvers.is_catching_up
        self._level.gap()
        self._changes.zero.restart()
        self._estimate = None

    # block by block -------------------------------------------------------------------------

    def _take_block(self, p: SignalBlock) -> None:
        """Learn from a block.

        Numbers beyond the range of the arithmetic freeze learning and are reported.
        """
        self._failed_for = max(self._failed_for - 1, 0)
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                self._learn_from(p)
        except (np.linalg.LinAlgError, ArithmeticError):
            self._failed_for = FAILED_BLOCKS
            self._begin_without_rotation()  # impossible numbers are in the evidence
        self._judge(p)

    def _learn_from(self, p: SignalBlock) -> None:
        """Steps 2 to 6."""
        solvers, signals, changes = self._solvers, self._signals, self._changes
        solvers.take(p, signals.without_speed)
        self._follow_steering(p)
        vertical = solvers.now.vertical
        if (solvers.can_compare and vertical.is_held) or p.rest.all():  # it is free of the motion
            self._level.add(p, vertical.up)
        turned = changes.at_once(p, solvers.now, signals) if solvers.can_compare else None
        if turned is not None:  # moved by hand: no sign and no unit is contradicted
            self._checks.forget_forces()
        elif self._checks.add(p, solvers.now, signals, solvers.kept):
            self._begin_without_rotation([p])
        is_refitting = solvers.is_refitting
        is_turn = changes.is_near or solvers.is_turn(signals.blocks, self.state is MountState.FINE)
        if (is_turn or solvers.is_young) and solvers.fit():
            self._checks.forget_forces()  # the forces showed another rotation
        self._take_beside()
        solvers.follow_creep(len(changes.history))
        if self._look_for_large_change(p, turned) or is_refitting:
            return
        if not solvers.has_looked_again:
            solvers.look_again(signals.offsets)
            return
        change: MountChange | None = solvers.now.step(self._is_rotation_good)
        if change is None and not self._checks.is_motion_accused:
            change = self._small_change(is_turn)
        if change is not None:
            self._take_change(change)

    def _small_change(self, is_turn: bool) -> MountChange | None:
        """Look for a small move of the sensor in the last minutes.

        is_turn: the rotation was fitted now.
        """
        return self._changes.small(self._solvers.now) if is_turn else None

    @property
    def _is_rotation_good(self) -> bool:
        """True if the solver's rotation is good enough to compare gravity with it."""
        return self.state in GOOD

    def _known_mount(self) -> MountSoFar | None:
        """Return the mount that is used to check a speed that stays constant."""
        solver = self._solver
        up = solver.vertical.up
        if solver.R is None or up is None or not self._solvers.can_compare or not solver.sure():
            return None
        delay = solver.delay_speed
        return MountSoFar(solver.R[0], up, delay.value, delay.std)

    def _follow_steering(self, p: SignalBlock) -> None:
        """Find the steering offset from the measured yaw rate; steering alone shows no offset."""
        measured = self._solver.own_gyro or "yaw_rate" in self._signals.seen
        if not measured or not np.count_nonzero(p.ok_steering) or self._signals.without_speed:
            return
        use = p.ok_steering & p.ok_speed & p.learn
        self._steering.add(p.steering, p.speed, self._solver.turn_rate, use)
        fitted = self._steering_fitted()
        if fitted is not None:
            self._signals.steering_offset = fitted[0]

    def _steering_fitted(self) -> tuple[float, float] | None:
        s = self._settings
        return self._steering.fitted(s.crown, 1.5 * s.vehicle.crown_std)

    def _look_for_large_change(self, p: SignalBlock, turned: LargeChange | None) -> bool:
        """Look for a rotation by several degrees, and for gravity far from the vertical.

        turned: result of the block alone. Returns True if there was a change, which is then
        handled.
        """
        solver, changes = self._solver, self._changes
        if solver.R is None or not self._solvers.can_compare:
            changes.skip()
            return False
        if is_off_vertical(p, solver.R, p.speed * solver.turn_rate):
            self._off_vertical += 1
            self._begin_without_rotation([p])
            return True
        changes.add(p, solver, self._signals)
        if self.state not in GOOD:  # nothing is served as good; the fit is young
            if turned is not None:
                self._begin_without_rotation()
                self._served.has_moved = self.correction is not None
            return turned is not None
        found = changes.large(solver) if turned is None else turned
        if found is not None:
            self._take_change(found)
        return found is not None

    def _take_change(self, found: MountChange) -> None:
        """Handle a moved sensor: only the blocks after the move count."""
        after = blocks_since(found, self._solvers.kept)
        changes, block, good = self._changes, self._signals.blocks, self._good_mount()
        std = self._misleading()[found.axis]
        changes.end_of_mounting(good)
        if self.state in GOOD and changes.is_bearable(found, self._solver, std):
            if changes.bear(found, block, std, good):
                self._ask_for_zero(found, after)
                self._solvers.begin_beside(after, self._signals.offsets)
            return
        self._ask_for_zero(found, after)
        if isinstance(found, LargeChange):  # of one axis; nobody knows about the others
            self._begin_afresh(after)
        else:
            self._served.has_moved = True
            changes.restart()
            self._solvers.begin_after_change(after, self._signals.offsets)
        changes.take(found, block, std, good)

    def _ask_for_zero(self, found: MountChange, after: list[SignalBlock]) -> None:
        """Check for a step of the accelerometer's zero, which looks like a tilt; the gyroscope
        tells them apart.
        """
        if found.axis < 2 and self._solver.own_gyro:
            end = float(self._solvers.kept[-1].t[0]) + BLOCK_S
            self._changes.zero.ask(float(after[0].t[0]) if after else end)

    def _take_beside(self) -> None:
        """Switch to the second solver, which uses the data after a harmless change, once it knows
        the mount.
        """
        if not self._solvers.has_beside and self._served.has_arrived:
            self._changes.borne[:] = 0.0  # the applied mount is now the present one
        if self._solvers.take_beside(self._settings.limits):
            self._changes.know_borne()

    def _begin_without_rotation(self, blocks: Iterable[SignalBlock] = ()) -> None:
        """Begin again from these blocks, without the rotation so far even as a hint."""
        self._changes.end_of_mounting(self._good_mount())
        self._changes.zero.restart()
        self._begin_afresh(blocks)

    def _begin_afresh(self, blocks: Iterable[SignalBlock]) -> None:
        """Begin again from these blocks. The check of the cause of the gravity change continues."""
        self._served.has_moved = True
        self._changes.restart()
        self._checks.restart()
        self._signals.offsets.doubt_gyro()
        self._solvers.begin_without_rotation(blocks)

    # judging, and saying what is known --------------------------------------------------------

    def _judge(self, p: SignalBlock) -> None:
        checks, solver = self._checks, self._solver
        if self._failed_for:
            checks.accuse(StandingFault.NUMERICS)
        checks.hold_against_orientation(solver, self._signals.blocks)
        if self._level.change is not None:
            checks.accuse_lasting(StandingFault.ACCEL_LEVEL, self._signals.blocks)
        if self._changes.zero.cause is GravityMoved.STEPPED:
            checks.accuse_lasting(StandingFault.ACCEL_ZERO, self._signals.blocks)
        self._known = self._knowledge(p)
        self._served.judge(
            self._known,
            self._acceptance(),
            has_faults=bool(checks.standing),
            is_refitting=self._solvers.is_refitting,
            found_correction=self._found_correction,
        )
        t = self._signals.blocks * BLOCK_S
        self._progress.take(t, self._known, self.state, self._settings, self._acceptance())

    def _found_correction(self) -> Correction:
        """Return the correction that the evidence so far asks for."""
        found = self._rotation.of(self._solver, self._moving(), self._is_yaw_known)
        return Correction.turning(found[0])

    @property
    def _is_yaw_known(self) -> bool:
        return self._solver.yaw_known and not self._checks.is_motion_accused

    def _knowledge(self, p: SignalBlock) -> MountKnowledge:
        """Return the knowledge after a block."""
        solver, driven, fused = self._solver, self._solvers.driven, self._solver.fused
        frozen = ~p.learn & p.ok_force
        self._lately.append(tuple(map(np.count_nonzero, (p.ok_force, p.ok_speed, frozen))))
        lately = self._lately
        std = (math.inf, math.inf, math.inf)
        if fused is not None:
            x, y, z = (math.sqrt(v) for v in (fused.variance + self._moving()).tolist())
            std = (x, y, z if self._is_yaw_known else math.inf)
        return MountKnowledge(
            gravity=fused is not None,
            std=std,
            straight=driven.straight,
            lefts=driven.lefts,
            rights=driven.rights,
            stops=solver.gravity.stops,
            accelerometer=any(ok for ok, _, _ in lately),
            speed=not self._signals.without_speed and any(ok for _, ok, _ in lately),
            frozen=lately[-1][2] >= FROZEN_TICKS,
            yaw_seen=solver.yaw_seen,
            has_past=solver.past_drives is not None,
            cross_axis=solver.cross_axis_std,
            turning=solver.own_gyro or bool(self._signals.seen & TURNING),
            speed_hz=0.0
            if self._signals.without_speed
            else math.fsum(ok for _, ok, _ in lately) / (len(lately) * BLOCK_S),
            driven_s=solver.blocks * BLOCK_S,
        )

    def _good_mount(self, R: Matrix3 | None = None) -> GoodMount | None:
        """Return the mount that is good now. R: known rotation where it is not applied yet."""
        good = self._served.good
        if good is None:
            return None
        if R is not None:
            good = Correction.turning(R)
        return GoodMount(good.rotation, self._stated())

    def _stated(self) -> tuple[float, ...]:
        """Return the deviations (3,) of the housing's angles, without an unconfirmed change
        [rad]."""
        return self._changes.stated(self._solver, self._signals.blocks)

    def _misleading(self) -> tuple[float, ...]:
        """Return the deviations (3,) of sent data, as angles, without an unconfirmed change."""
        return self._stated()

    def _moving(self) -> Array:
        return self._changes.variance(self._solver, self._signals.blocks)

    def _acceptance(self) -> Acceptance:
        has_speed = not self._signals.without_speed
        return Acceptance(self._solver, self._checks, self._changes, has_speed)

    def estimate(self) -> MountEstimate:
        """Return the present state of knowledge; the object stays the same until something was
        learnt.
        """
        if self._estimate is None:
            self._estimate = self._new_estimate()
        return self._estimate

    def _new_estimate(self) -> MountEstimate:
        solver, state, changes, checks = self._solver, self.state, self._changes, self._checks
        creeping = creep_details(solver.creep)
        troubles = mount_troubles(
            state, checks.standing, creeping, changes.shifted_again(), self._level.change
        )
        words, codes = waiting_reasons(
            self._known, state, self._settings, self._acceptance(), troubles
        )
        if solver.fused is None:
            R = covariance = None
            details: dict[str, object] = {}
        else:
            R, covariance = self._rotation.of(solver, self._moving(), self._is_yaw_known)
            steering = self._steering_fitted()
            details = estimate_details(
                solver, self._signals, self._known, changes, checks, steering, self._good_mount(R)
            )
            details["gravity_change"] = level_details(self._level.change)
        details["not_learnt_from"] = left_out_details(self._signals)
        if self._off_vertical:
            details["off_vertical"] = self._off_vertical
        targets = targets_in_force(self._known, state, self._settings)
        can_be_fine = self._acceptance().can_become_fine
        progress = None if troubles else self._progress.after(state, self._known, can_be_fine)
        made = MountEstimate(
            state,
            R,
            covariance,
            words,
            codes,
            details,
            self.faults,
            targets,
            progress=progress,
        )
        if R is None or made.std is None or solver.bias is None:
            return made
        along, across, _ = (R @ solver.bias).tolist()
        return replace(made, deviations=SentDeviations.of_rotation(*made.std, zero=(along, across)))

    # what a person says, and what outlives the process; see `mount.restored` ------------------

    def take_stated_mount(self, R: Matrix3) -> None:
        """Take the mount that a person states.

        If it is the mount that is found, it excludes alternatives that no signal can exclude.
        """
        self._checks.take_mount(R)

    @property
    def contradiction(self) -> float | None:
        """Chi-square (3) of this drive's evidence against that of past drives; None without past
        drives.
        """
        return self._solvers.contradiction

    def saved_information(self) -> SavedInformation | None:
        """Information of all evidence, for the next start; None if there is too little."""
        return self._solvers.saved_information()

    def join_information(self, kept: SavedInformation) -> None:
        """Add the information that past drives found."""
        self._solvers.join(kept)
        self._estimate = None

    def drop_information(self) -> None:
        """Continue with the evidence of this drive alone."""
        self._solvers.drop_past_drives()
        self._estimate = None
