"""What the signals say of one another: which contradictions stand, and what is seen to agree.

`contradictions` accuses pairs of signals, `alternatives` rules out signs turned and axes exchanged.
Here both come together, block by block, with what follows for the rotation: one that was found
under a contradiction is of no use once the contradiction has ended, or when it is new.
"""

from __future__ import annotations

from collections.abc import Sequence

from imucald.core.rotations import Matrix3
from imucald.mount.alternatives import Alternatives
from imucald.mount.contradictions import Contradictions, StandingFault
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.log_ratios import TO_BE_FINE, TO_BE_GOOD
from imucald.mount.signal_blocks import SignalBlock, SignalBlockMaker
from imucald.mount.solver import MountSolver
from imucald.mount.stated_orientation import Stated

STUCK_BLOCKS = 40
"""While a contradiction stands the rotation is sought anew every 4 min: the mount may move."""
FOUND_ANEW = frozenset({StandingFault.FORCE_TURNS, StandingFault.FORCE_SPEED})
"""Faults that end by a rotation that was found while they stood: that one stays."""

AGAINST_A_PERSON: dict[Stated, StandingFault] = {
    "up": StandingFault.ORIENTATION,
    "forward": StandingFault.FORWARD,
}


OF_NO_PAIR = frozenset(
    {
        *AGAINST_A_PERSON.values(),
        StandingFault.ACCEL_LEVEL,
        StandingFault.ACCEL_ZERO,
        StandingFault.ACCEL_DRIFT,
    }
)
"""Faults that are not of signals against one another: another rotation ends none of them."""


class SignalChecks:
    """Holds the signals of a drive against one another.

    standing: contradictions that stand now. history: all that ever began, each with the number of
    the block in which it did.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        self._contradictions = Contradictions(settings)
        self._alternatives = Alternatives(settings)
        self.standing: tuple[StandingFault, ...] = ()
        self.history: list[tuple[int, StandingFault]] = []

    def add(
        self,
        p: SignalBlock,
        solver: MountSolver,
        signals: SignalBlockMaker,
        kept: Sequence[SignalBlock],
    ) -> bool:
        """Take a block; return whether the rotation is to be sought anew, from this block on.

        solver: it has taken the block already. signals: what made it. kept: the last blocks.
        """
        if signals.without_speed:
            self.standing = ()
            self._alternatives.add_without_speed(p, solver.R, signals.seen)
            return False
        R, offset = solver.R if solver.yaw_known else None, signals.steering_offset
        self._contradictions.add(
            p,
            solver.turn_rate,
            solver.own_gyro,
            R,
            offset,
            "yaw_rate" in signals.seen,
            solver.delay_speed.value if solver.delay_speed.is_known else None,
        )
        self._alternatives.add(kept, R, solver.bias, solver.gains(), signals.seen, offset)
        before = tuple(f for f in self.standing if f not in OF_NO_PAIR)
        self.standing = self._contradictions.faults
        if self._alternatives.gyro_accused and (solver.sure() or StandingFault.GYRO_AXES in before):
            self.accuse(StandingFault.GYRO_AXES)
        new = [fault for fault in self.standing if fault not in before]
        self.history += [(signals.blocks, fault) for fault in new]
        has_ended = bool(before) and not self.standing and FOUND_ANEW.isdisjoint(before)
        is_stuck = bool(self.standing) and solver.blocks >= STUCK_BLOCKS
        return bool(new) or has_ended or is_stuck

    @property
    def is_motion_accused(self) -> bool:
        """Whether the force contradicts dv/dt or v r now: what they say of the mount is no evidence
        of a direction, nor of a move."""
        return not FOUND_ANEW.isdisjoint(self.standing)

    def accuse(self, fault: StandingFault) -> None:
        """Let a fault stand, until the next block is taken."""
        if fault not in self.standing:
            self.standing = (*self.standing, fault)

    def hold_against_orientation(self, solver: MountSolver, block: int) -> None:
        """A fault where the sensor is found to sit the other way round than is stated."""
        if solver.R is None:
            return
        stated = self._alternatives.contradicted_orientation(solver.R, solver.yaw_known)
        if stated is None:
            return
        self.accuse_lasting(AGAINST_A_PERSON[stated], block)

    def accuse_lasting(self, fault: StandingFault, block: int) -> None:
        """The same of a fault that is found outside, block by block; block: its number."""
        self.accuse(fault)
        if fault not in {seen for _, seen in self.history}:
            self.history.append((block, fault))

    def forget_forces(self) -> None:
        """What the forces showed was about another rotation."""
        self._contradictions.forget_forces()

    def restart(self) -> None:
        """The rotation is sought anew: nothing that was seen to agree with it counts."""
        self._contradictions.forget_forces()
        self._alternatives.restart()

    def take_mount(self, R: Matrix3) -> None:
        """A person states R_vehicle_from_sensor (3, 3): that rules out its mirror image."""
        self._alternatives.take_mount(R)

    def missing_to_be_good(self) -> str | None:
        """What is to be seen before an estimate may begin to be good, in words; None: nothing."""
        return self.doubt or self._alternatives.missing(TO_BE_GOOD)

    @property
    def doubt(self) -> str | None:
        """The same where signs and places of the signals are known already."""
        is_doubtful = self._contradictions.doubtful
        return "more bends: some signals contradict each other" if is_doubtful else None

    @property
    def have_agreed(self) -> bool:
        """Whether all signals were seen to agree, as surely as *fine* asks for."""
        return self._contradictions.agreed and self._alternatives.are_seen(TO_BE_FINE)

    def share(self, is_fine: bool) -> float:
        """How much of what shows that they agree has been seen, 0 to 1; is_fine: all of it."""
        if not is_fine:
            return self._alternatives.share(TO_BE_GOOD)
        signs = self._alternatives
        return min(signs.share(TO_BE_FINE), signs.mirror_share, self._contradictions.share)

    @property
    def is_mirror_excluded(self) -> bool:
        """Whether anything has shown that this is the drive and not its mirror image."""
        return self._alternatives.is_mirror_excluded

    @property
    def not_checked(self) -> tuple[str, ...]:
        """What no signal of this vehicle can show, and nobody has stated, in words."""
        return self._alternatives.not_checked
