"""All steps of a diagnosis, from samples to verdict: find the errors, name their causes, extend the
model file, measure the gain.

samples -> faults (samples and stamps) -> rest (stops) -> search (shift, causes, rivals)
        -> left-over structure -> the written file -> its gain
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from imucald.core.errors import EstimateError
from imucald.core.samples import Samples
from imucald.core.text import counted
from imucald.diagnosis import outcome
from imucald.diagnosis.cause_keys import TRIADS, mount_of, usual_tolerance, with_low_passes
from imucald.diagnosis.causes import GYRO_BIAS, family
from imucald.diagnosis.direct.faults import find_faults, invalid_spans
from imucald.diagnosis.direct.levels import with_levels
from imucald.diagnosis.direct.single_values import Lost, all_lost, as_structure
from imucald.diagnosis.direct.stops import Rest, rest_of
from imucald.diagnosis.direct.stuck import Fault
from imucald.diagnosis.direct.successive import CHANGES, changes_of, follows, traits_of
from imucald.diagnosis.doubts import doubt, unexplained
from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.chance import reported
from imucald.diagnosis.fit.intervals import estimate, quantile
from imucald.diagnosis.fit.score import Hypothesis, Problem
from imucald.diagnosis.gain import gain_of, summed
from imucald.diagnosis.left_over.louder import LEAST_BLOCKS, LEAVES
from imucald.diagnosis.left_over.remains import Remains
from imucald.diagnosis.left_over.table import AGAINST, ODD, RawValues, left_over
from imucald.diagnosis.pictures import pictures_of
from imucald.diagnosis.result import (
    UNBELIEVED,
    Certainty,
    Diagnosis,
    FoundCause,
    Gain,
    Kind,
    Structure,
)
from imucald.diagnosis.search.low_pass import low_passes
from imucald.diagnosis.search.search import search
from imucald.diagnosis.search.state import State, estimate_unstated, final_estimates
from imucald.diagnosis.signals import DriveSignals, drive_of, require
from imucald.model.model import VehicleModel

Progress = Callable[[float, str], None]
LIMIT_S_PER_H = 40.0
"""Limit of the search's processor time per hour of driving [s]. At this limit, the search ends with
its present result. The steps after the search take up to 15 s more per hour of driving."""
LEAST_LIMIT_S = 30.0
"""Smallest default limit of the search's processor time [s]. A search in ten minutes of driving
takes about 10 s. With a limit near this time, the result would depend on the machine's load."""
NOT_AS_STATED = (
    Kind.LOUDER, Kind.COARSER, Kind.VALUES_MISSING, Kind.CHANGES_OTHERWISE, Kind.JUMPS_ALONE,
    Kind.FOLLOWS_OTHERWISE,
)  # fmt: skip
"""Kinds of left-over structure with which the model file's statements about its own drives are not
updated."""
READ_FROM_VALUES = ("saturation", "stuck_signal", "duplicated_frames")
"""Faults that are found from the sequence of a signal's values."""
MOVES = (Kind.WANDERS, Kind.GOES_WITH_ANOTHER)
"""Kinds of structure in which a zero error changes during the drive."""
BETWEEN = (Kind.FOLLOWS_OTHERWISE, Kind.VALUES_MISSING, Kind.CHANGES_MISSING, Kind.JUMPS_ALONE)
"""Kinds of structure in raw values that arise between sensor and log."""


def diagnose(
    drives: Sequence[Samples],
    model: VehicleModel,
    progress: Progress | None = None,
    limit_s: float | None = None,
) -> Diagnosis:
    """Find the errors of the simulation with this model in measured drives of one vehicle.

    drives: SI samples, sensor axes (see `imucald.core.samples`). Each drive needs several minutes
    of `accel` and `speed`. limit_s: processor time after which the search stops and its present
    result is reported [s]. None: `LIMIT_S_PER_H` for each hour of driving, but at least
    `LEAST_LIMIT_S`.
    Raises EstimateError if no diagnosis is possible.
    """
    report = progress or _silent
    began = time.process_time()
    faults, odd, parts, rest, state = _begun(drives, model, report)
    driven_s = float(sum(d.duration_s for d in parts))
    if limit_s is None:
        limit_s = max(LIMIT_S_PER_H * driven_s / 3600.0, LEAST_LIMIT_S)
    late = _Late(began + limit_s)
    before, forwards_before = state.evaluated().table, state.forwards
    steps = [0.15]

    def tick(text: str) -> None:
        steps[0] = min(steps[0] + 0.12, 0.75)
        report(steps[0], text)

    wrong = reported(AGAINST, forwards_before, partial(report, 0.15))
    tick("testing causes on data that their fit did not see")
    if wrong:
        state.leave_out(unexplained(wrong), ())
    search(state, tick, late, GYRO_BIAS if rest else ())
    left = (*odd, *(wrong or left_over(state, partial(report, 0.8))))
    doubt(state, left, faults)
    problem = state.evaluated()
    causes = _certain_causes(state, rest if _shows_zero(left) else None, faults, model)
    report(0.88, "testing the written model file")
    written = _written(state, problem)
    changes = written != state.stated or state.stated != model
    problem = state.evaluated()
    if not any(s.kind in (*UNBELIEVED, *NOT_AS_STATED) for s in left):
        written = LEAVES.written(written, Remains(problem, state).by_band)
        written = CHANGES.written(with_levels(written, parts), changes_of(parts, state.model))
        written = follows(parts, written).written(written, traits_of(parts))
    whole = state.whole or problem.table
    clearest = max((t.gain for t in state.named), key=np.sum, default=None)
    gain, signals = gain_of(before, problem, whole, state.free, state.forwards, clearest)
    if state.shift is not None:
        gain = summed(state.shift.gain, gain.worse)
    likely = [outcome.cause_of_trial(state, t, {}, "likely") for t in state.likely]
    likely += _fault_causes(faults, model, "likely")
    sets = outcome.look_alikes(state)
    in_axes = partial(outcome.with_sensor_axes, stated=model, written=written)
    report(0.95, "pictures")
    return Diagnosis(
        verdict=outcome.verdict_of(causes, sets, left),
        causes=tuple(sorted(map(in_axes, causes), key=lambda c: -c.evidence["held_out_nats"])),
        look_alikes=sets,
        to_separate=outcome.manoeuvres(sets),
        signals={
            name: replace(s, verdict=outcome.of_signal(name, causes, sets, left))
            for name, s in signals.items()
        },
        gain=gain,
        duration_s=driven_s,
        likely=tuple(map(in_axes, _merged(likely))),
        candidates=outcome.other_candidates(state),
        structure=left,
        notes=tuple(_notes(parts, problem.table, late, state.unstated)),
        pictures=pictures_of(forwards_before, state.forwards),
        model_before=model,
        model_after=written,
        recommended=_is_recommended(causes, gain, left, changes),
        complete=not late.was,
        channels=frozenset(name for drive in parts for name in drive.channels),
    )


def rms_beside(drives: Sequence[Samples], model: VehicleModel) -> dict[str, float]:
    """Return the rms residual of each signal with this model file [unit of the signal], as in
    `SignalGain.rms_before`. No cause is searched. Raises EstimateError if no diagnosis is possible.
    """
    table = _begun(drives, model, _silent)[-1].evaluated().table
    return {name: rms for name in table.plain if (rms := table.rms(name))}


def _begun(
    drives: Sequence[Samples], model: VehicleModel, report: Progress
) -> tuple[list[list[Fault]], list[Structure], list[DriveSignals], Rest | None, State]:
    """Do all steps before the search.

    Returns the faults of each drive, other structure in raw values, the signals of each drive, the
    evidence of stops, and the initial state of the search.
    """
    if not drives:
        raise EstimateError("diagnosis needs at least one drive")
    for samples in drives:
        require(samples)
    report(0.02, "samples and time stamps")
    lost = [all_lost(samples) for samples in drives]
    faults = [find_faults(s, model, gone) for s, gone in zip(drives, lost, strict=True)]
    parts = _signals(drives, faults, lost)
    gone = {name: as_structure(name, x) for each in lost for name, x in each.items()}
    odd = [*gone.values(), *reported(ODD, RawValues(parts, model), partial(report, 0.05))]
    stand = [[f for f in part if not _is_owed(f, odd)] for part in faults]
    if stand != faults:
        faults, parts = stand, _signals(drives, stand, lost)
    changes = {k: x for part in faults for fault in part for k, x in fault.changes.items()}
    model_now = model.with_changes(changes) if changes else model
    report(0.08, "stops")
    rest = rest_of(parts, model_now, len(GYRO_BIAS))
    state = _started(parts, model_now, rest)
    report(0.12, "forward model and residuals")
    estimate_unstated(state)
    _refuse_short(state.evaluated().table, faults)
    return faults, odd, parts, rest, state


def _signals(
    drives: Sequence[Samples], faults: Sequence[Sequence[Fault]], lost: Sequence[dict[str, Lost]]
) -> list[DriveSignals]:
    """Return the signals of each drive, without the samples that faults and lost readings make
    invalid."""
    bad = [invalid_spans(*each) for each in zip(faults, drives, lost, strict=True)]
    return [drive_of(s, b) for s, b in zip(drives, bad, strict=True)]


def _is_owed(fault: Fault, odd: Sequence[Structure]) -> bool:
    """True if another structure in the same signal may explain a fault. Values at the end of a
    range, constant values and repeated frames are found from the sequence of samples. Such a fault
    is not certain if something between sensor and log has changed the sequence."""
    if fault.cause not in READ_FROM_VALUES:
        return False
    beside = TRIADS if fault.signal in TRIADS else (fault.signal,)
    return any(s.kind in BETWEEN and s.signal.startswith(beside) for s in odd)


def _is_recommended(
    causes: Sequence[FoundCause], gain: Gain, left: Sequence[Structure], changes: bool
) -> bool:
    """True if the fit is trustworthy and the written model file is better.

    The model file is better if it predicts data outside its fit better, or if it states facts that
    were read directly from the data."""
    if not (causes and changes) or any(s.kind in UNBELIEVED for s in left):
        return False
    return not gain.worse and (gain.held_out_log_likelihood > 0.0 or not gain.was_fitted)


def _silent(share: float, text: str) -> None:
    """Progress function for callers that need no progress."""


@dataclass
class _Late:
    """Callable that returns whether the time limit has passed. The object stores whether it has
    ever returned True."""

    until: float
    was: bool = False

    def __call__(self) -> bool:
        self.was |= time.process_time() > self.until
        return self.was


def _started(parts: Sequence[DriveSignals], model: VehicleModel, rest: Rest | None) -> State:
    """Return the initial state of the search. The gyroscope's zero error at stops limits every
    fit."""
    state = State(parts, model, model, rest.bounds(model) if rest is not None else {})
    if rest is not None and _is_off(rest, model):
        half = rest.quantile * rest.se
        state.at_rest = {k: float(x) for k, x in zip(GYRO_BIAS, rest.rate, strict=True)}
        state.bounds = {k: (-float(h), float(h)) for k, h in zip(GYRO_BIAS, half, strict=True)}
        state.apply({})
    return state


def _is_off(rest: Rest, model: VehicleModel) -> bool:
    return bool(np.any(np.abs(rest.rate) - rest.quantile * rest.se > rest.allowed(model)))


def _shows_zero(left: Sequence[Structure]) -> bool:
    """True if the gyroscope's mean at stops is its zero error in the whole drive. False if the
    sensor may show this mean for all small rates, or if the zero error changes during the drive."""
    gyro = [s for s in left if s.signal.startswith("gyro") or s.parameter.startswith("gyro.bias")]
    return not any(s.kind in (Kind.VALUE_HELD, *MOVES) for s in gyro)


def _refuse_short(table: Table, faults: Sequence[Sequence[Fault]]) -> None:
    """Raise EstimateError if too little data is left. If faults have removed the data, the text
    names these faults, because longer drives would not help."""
    if table.blocks >= LEAST_BLOCKS:
        return
    taken = [fault.text for part in faults for fault in part if fault.spans]
    remedy = f"correct the reasons why segments were lost, or give longer drives. {' '.join(taken)}"
    raise EstimateError(
        f"only {counted(table.blocks, 'segment')} of driving can be used: "
        f"{remedy if taken else 'give longer drives'}"
    )


def _certain_causes(
    state: State, rest: Rest | None, faults: Sequence[Sequence[Fault]], model: VehicleModel
) -> list[FoundCause]:
    """Return all causes that are certain: from direct evidence, from a shift of the mount, and from
    the fit."""
    estimates = final_estimates(state)
    causes = [outcome.cause_of_trial(state, t, estimates) for t in state.named]
    if rest is not None and state.at_rest:
        # The zero error at stops without the effect of a found g-sensitivity at one g.
        net = mount_of(model) @ (np.array(state.model.gyro.bias) - np.array(state.stated.gyro.bias))
        rest = replace(rest, rate=net)
        if _is_off(rest, model):
            causes.append(outcome.cause_of_rest(rest, model))
    if state.shift is not None and state.table is not None:
        causes.append(outcome.cause_of_shift(state.shift, state.table))
    return _merged([*causes, *_fault_causes(faults, model, "certain")])


def _fault_causes(
    faults: Sequence[Sequence[Fault]], model: VehicleModel, certainty: Certainty
) -> list[FoundCause]:
    every = [outcome.cause_of_fault(fault, model) for part in faults for fault in part]
    return [cause for cause in every if cause.certainty == certainty]


def _merged(causes: Sequence[FoundCause]) -> list[FoundCause]:
    """Return one entry for each cause, even if several signals or variants show the cause."""
    made: dict[str, FoundCause] = {}
    for one in causes:
        known = made.get(one.name)
        if known is None:
            made[one.name] = one
            continue
        made[one.name] = replace(
            max(known, one, key=lambda c: c.evidence["held_out_nats"]),
            parameters={**known.parameters, **one.parameters},
            signals=tuple(dict.fromkeys((*known.signals, *one.signals))),
            text=known.text if known.text == one.text else f"{known.text} {one.text}",
            against=tuple(dict.fromkeys((*known.against, *one.against))),
        )
    return list(made.values())


def _written(state: State, problem: Problem) -> VehicleModel:
    """Return the extended model file, with the accuracy (`known_to`) of the fitted numbers."""
    known: dict[str, float] = {}
    table, q = problem.table, quantile(problem.table.blocks, 1)
    for key in (*state.free, *state.unstated):
        if key in table.keys:
            e = estimate(problem, Hypothesis("", (key,)), 1)
            # One drive has one temperature, load and weather: half the tolerance at least.
            known[key] = max(float(q * e.se[0]), 0.5 * usual_tolerance(state.stated, key))
    written = with_low_passes(state.model, state.stated, low_passes(state))
    return written.with_changes({"known_to": {**written.known_to, **known}}) if known else written


def _notes(
    parts: Sequence[DriveSignals], table: Table, late: _Late, unstated: Sequence[str]
) -> list[str]:
    notes = []
    if unstated:
        names = ", ".join(dict.fromkeys(map(family, unstated)))
        notes.append(f"Estimated from these drives, because nothing states them: {names}.")
    if not parts[0].has("gyro"):
        notes.append(
            "There is no gyroscope, so slopes of the road cannot be removed. Only faults, "
            "delays and the signals of the vehicle were examined. No scale and no bias is "
            "named."
        )
    if not (parts[0].has("steering") and (parts[0].has("yaw_rate") or parts[0].has("gyro"))):
        notes.append("Steering angle or yaw rate is missing: handling was not examined.")
    if not parts[0].has("temperature"):
        notes.append("There is no temperature signal: drift with temperature was not examined.")
    if parts[0].has("gyro") and not any(p.stops for p in parts):
        notes.append("Speed and gyroscope show no common stop. The zero of the gyroscope comes "
                     "from driving alone, which is ten times less exact.")  # fmt: skip
    minutes = float(table.moving.sum()) * (table.seconds / 60.0)
    if minutes < 10.0:
        notes.append(
            f"There are only {minutes:.1f} min of driving, which do not show small errors."
        )
    top = ", ".join(f"{name} {hz:.2g}" for name, hz in table.top_hz.items() if name in table.plain)
    notes.append(f"Compared up to [Hz]: {top}.")
    if late.was:
        notes.append(
            "The time limit ended the search: there may be more causes. Give a larger "
            "--time-limit to complete the search."
        )
    return notes
