"""Withdraw named causes that other findings may explain. A withdrawn cause only counts as not ruled
out."""

from __future__ import annotations

from collections.abc import Sequence

from imucald.diagnosis.causes import family
from imucald.diagnosis.direct.stuck import Fault
from imucald.diagnosis.fit.blocks import EQUATIONS, SENSED, TILTED
from imucald.diagnosis.outcome import signals_of
from imucald.diagnosis.result import Kind, Structure
from imucald.diagnosis.search.search import leave_out, unsettle
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import Trial

BESIDE = (Kind.NOT_PLAUSIBLE, Kind.WANDERS, Kind.LOUDER, Kind.COARSER, Kind.CHANGES_OTHERWISE)
"""Kinds of structure that change no fitted value. If a drive has only such structure, the causes
that a fit has named stay named."""
NO_STEP = (Kind.GOES_WITH_ANOTHER, Kind.FOLLOWS_OTHERWISE, Kind.TOO_MUCH)
"""Kinds of structure that a rotated sensor does not cause. A rotation by 10 deg makes zero errors
and gains seem to wander, because the fit follows a rotation only to first order and to the nearest
segment."""


def doubt(state: State, left: Sequence[Structure], faults: Sequence[Sequence[Fault]]) -> None:
    """Withdraw each named cause that left-over structure or a fault may explain."""
    every = [fault for part in faults for fault in part]
    changing = {family(s.parameter) for s in left if s.parameter}
    shifted = {fault.signal for fault in every if fault.cause == "saturation"}
    # A cause is missing there, and fitted gains and zeros absorb its effect. A delay still shows in
    # the timing.
    impossible = [s for s in left if s.kind == Kind.NOT_PLAUSIBLE]
    shifted |= {name for s in impossible for name in EQUATIONS[s.signal].takes}
    clocks_differ = any(fault.cause == "clock_drift" for fault in every)
    missing = max((t.shown for t in state.implausible), default=0.0)

    def rests_on(trial: Trial, structures: Sequence[Structure]) -> bool:
        seen = set(signals_of(state.table, trial.hypothesis.keys))
        return bool(structures) and (not seen or bool(seen & unexplained(structures)))

    def is_doubtful(trial: Trial) -> bool:
        if (
            missing > 0.0
            and trial.shown < (missing**0.5 + trial.needed**0.5) ** 2
            and rests_on(trial, impossible)
        ):
            # The implausible structure explains a known number of nats. All of these may belong to
            # this cause, so the rest must be enough to name it. Nats are squares of deviations, so
            # they add up.
            return True
        keys = trial.hypothesis.keys
        if changing & {family(key) for key in keys}:
            # A single number does not describe a value that changes from segment to segment.
            return True
        if trial.hypothesis.pattern is not None:
            return False
        if all("delay" in key for key in keys):
            # Clocks that drift apart change the delay from minute to minute.
            return clocks_differ
        # If the largest values are lost, the remaining ones are a biased sample, and a slope fitted
        # to them is wrong (truncated regression; Hausman and Wise 1977).
        sensors = {s for name in signals_of(state.table, keys) for s in EQUATIONS[name].takes}
        return bool(sensors & shifted)

    if state.shift is not None and any(s.kind in NO_STEP for s in left):
        state.withdraw_shift()
    likely, state.likely = state.likely, []
    for trial in likely:
        # Any left-over structure means that a cause is missing; a weak statement may be due to that
        # cause.
        weak = rests_on(trial, left) or is_doubtful(trial)
        (state.doubtful if weak else state.likely).append(trial)
    if moving := [s for s in left if s.kind not in BESIDE]:
        # A cause is missing, and the fit distributes its effect over the known causes. Only causes
        # that the other equations show by themselves stand.
        asked = [t for t in state.named if t.hypothesis.pattern is None or not rests_on(t, moving)]
        leave_out(state, unexplained(moving), asked)
    unsettle(state, is_doubtful)


def unexplained(left: Sequence[Structure]) -> set[str]:
    """Return the equations that use a signal which may cause the left-over structure. Every signal
    of an equation with left-over structure may be the cause. Most equations use the speed, so the
    speed counts only in comparisons with another speed."""
    signals: set[str] = set()
    for s in left:
        if s.signal in EQUATIONS:
            takes = EQUATIONS[s.signal].takes
            signals |= {x for x in takes if x != "speed" or s.signal == "speed"}
        else:
            signals |= {x for x in SENSED if s.signal.startswith(x)}
    made = {
        name
        for name, equation in EQUATIONS.items()
        if signals & set(equation.takes) or (equation.uses_speed and "speed" in signals)
    }
    # The forward and sideways force equations share the estimate of gravity.
    return made | (set(TILTED) if made & set(TILTED) else set())
