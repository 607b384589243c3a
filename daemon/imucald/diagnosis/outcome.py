"""Turn the search result into the output for people and tools."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from imucald.core.angles import DEG_PER_RAD
from imucald.core.text import counted
from imucald.diagnosis.cause_keys import (
    TRIADS,
    low_pass,
    mount_of,
    tolerance,
    value,
)
from imucald.diagnosis.causes import BY_NAME, GYRO_BIAS, PARAMETERS, family
from imucald.diagnosis.direct.stops import Rest
from imucald.diagnosis.direct.stuck import Fault
from imucald.diagnosis.fit.blocks import EQUATIONS, Table
from imucald.diagnosis.fit.chance import Answer
from imucald.diagnosis.result import (
    OTHERWISE,
    UNBELIEVED,
    Candidate,
    Certainty,
    Estimated,
    FoundCause,
    Kind,
    Outcome,
    Structure,
    Verdict,
)
from imucald.diagnosis.search.shift import KEYS, FittedShift
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import LEVELLED, SINGLE_NATS, Trial, questions
from imucald.model.model import VehicleModel
from imucald.model.sensors import BUTTERWORTH_S_HZ
from imucald.mount.mount_words import SD_95

MISSING = (Kind.NOT_PLAUSIBLE, *UNBELIEVED)
"""Kinds of structure that contradict the model: a cause is missing, with or without direct
evidence."""
SEEN_SHARE = 0.02
"""Smallest share of a cause's information in a signal that shows the cause."""


def cause_of_trial(
    state: State,
    trial: Trial,
    estimates: Mapping[str, tuple[float, float]],
    certainty: Certainty = "certain",
) -> FoundCause:
    """Return a cause that the fit named, or a cause that is likely."""
    h, parameters = trial.hypothesis, {}
    moved = set(state.changes)
    alike = [(i, k) for i, d in enumerate(h.directions) for k, x in d.items() if x == 1.0]
    for i, key in alike or enumerate(h.keys):
        if certainty == "certain" and h.is_plain and moved & set(h.keys) and key not in moved:
            continue
        x = float(trial.estimate.value[i])
        change = state.changes.get(key, x) if h.pattern is None else x
        change, se = estimates.get(key, (change, float(trial.estimate.se[i])))
        parameters[key] = _estimated(state.stated, key, change, se, float(trial.tolerance[i]))
    sd = max(abs(p.value - p.stated) / max(p.std, 1e-30) for p in parameters.values())
    if BY_NAME[h.name].form_of:
        parameters = dict(_as_low_pass(state.stated, k, p) for k, p in parameters.items())
    return FoundCause(
        h.name, parameters, signals_of(state.table, h.keys),
        {"held_out_nats": trial.shown, "sigma": sd, "quantile": trial.estimate.quantile,
         "beyond_tolerance": trial.estimate.pull,
         "threshold": trial.estimate.quantile if certainty == "certain" else trial.single},
        BY_NAME[h.name].sentence,
        certainty,
        tuple(_against(state, trial)),
    )  # fmt: skip


def _estimated(model: VehicleModel, key: str, off: float, std: float, tau: float) -> Estimated:
    """Return a parameter that differs from the model file by `off`."""
    stated = value(model, key)
    return Estimated(stated + off, std, PARAMETERS[key].unit, stated, tau)


def _as_low_pass(model: VehicleModel, key: str, late: Estimated) -> tuple[str, Estimated]:
    """Convert a delay to the low-pass filter of the model file, if the file has one. The relative
    accuracy of the cut-off frequency is the relative accuracy of the delay."""
    filtered = low_pass(model, key, late.value - late.stated)
    if filtered is None or late.value <= late.stated:  # a filter cannot have a negative delay
        return key, late
    (name, x), stated = filtered, low_pass(model, key, 0.0)
    unit = "Hz" if name.endswith("hz") else "s"
    share = x * x / BUTTERWORTH_S_HZ if unit == "Hz" else 1.0  # |d cut-off / d seconds|
    return name, Estimated(
        x, share * late.std, unit, stated[1] if stated else math.nan, share * late.tolerance
    )


def with_sensor_axes(cause: FoundCause, stated: VehicleModel, written: VehicleModel) -> FoundCause:
    """Return the cause with its vectors also along the sensor's axes, by the key of the model file.
    The values are the values of the written file, or of the fit if the file was not changed."""
    made: dict[str, Estimated] = {}
    R = mount_of(stated)
    for stem in dict.fromkeys(family(key) for key in cause.parameters):
        section, _, name = stem.partition(".")
        if section not in TRIADS or f"{stem}.x" not in PARAMETERS:
            continue
        keys = [f"{stem}.{axis}" for axis in "xyz"]
        # A parameter that was not fitted gets the deviation of a uniform distribution over its
        # tolerance.
        tolerances = [tolerance(stated, key) for key in keys]
        own = [
            cause.parameters.get(k) or _estimated(stated, k, 0.0, tau / math.sqrt(3.0), tau)
            for k, tau in zip(keys, tolerances, strict=True)
        ]
        before, after = (np.array(getattr(getattr(m, section), name)) for m in (stated, written))
        fitted = R.T @ [p.value for p in own]
        std, tau = (np.sqrt((R.T**2) @ [x**2 for x in each])
                    for each in ([p.std for p in own], [p.tolerance for p in own]))  # fmt: skip
        value_now = fitted if np.array_equal(before, after) else after
        for i in range(3):
            made[f"{stem}.{i}"] = Estimated(
                float(value_now[i]), float(std[i]), own[i].unit, float(before[i]), float(tau[i])
            )
    return replace(cause, along_sensor=made)


def signals_of(table: Table | None, keys: Sequence[str]) -> tuple[str, ...]:
    """Return the equations that show the parameters, selected by their share of the information."""
    if table is None:
        return ()
    known = [k for k in keys if k in table.keys]
    sizes = table.tolerance[table.index(known)]
    own = [table.energy({k: float(x)}) for k, x in zip(known, sizes, strict=True)]
    shares = {name: sum(float(e[name].sum()) for e in own) for name in table.by_equation}
    total = sum(shares.values())
    return tuple(name for name, x in shares.items() if total > 0.0 and x > SEEN_SHARE * total)


def first_signal(table: Table | None, keys: Sequence[str]) -> str:
    """Return the first signal that shows the parameters; `accel_x` if no signal shows them."""
    return (signals_of(table, keys) or ("accel_x",))[0]


def _against(state: State, trial: Trial) -> list[str]:
    """Return the arguments against a cause: single blocks, a value that wanders, few segments.
    `look_alikes` has its rivals."""
    texts = []
    e, gain = trial.estimate, trial.gain
    worse = float((gain < 0.0).mean())
    if worse > 1.0 / 3.0:
        texts.append(f"it predicts worse in {100 * worse:.0f} % of the segments")
    for key, wander, spread in zip(trial.hypothesis.keys, e.wander, e.se, strict=True):
        if wander > spread:
            texts.append(
                f"{key} moves by {_with_unit(f'{wander:.2g}', key)} between quarters of the data"
            )
    is_plain = trial.hypothesis.pattern is None
    if is_plain and state.table is not None and state.table.blocks < 20:
        texts.append(f"the drives have only {counted(state.table.blocks, 'segment')}")
    return texts


def cause_of_fault(fault: Fault, model: VehicleModel) -> FoundCause:
    """Return the cause for a fault in samples or time stamps."""
    parameters = {}
    for key, (x, std, unit) in fault.values.items():
        section, _, name = key.partition(".")
        stated = getattr(getattr(model, section, None), name, None)
        known = float(stated) if isinstance(stated, int | float) else 0.0
        parameters[key] = Estimated(x, std, unit, known)
    # If several signals have the fault, they share one text.
    name = {"accel": "Accelerometer", "gyro": "Gyroscope"}.get(
        fault.signal, fault.signal.replace("_", " ").capitalize()
    )
    text = f"{name}: {fault.text[:1].lower()}{fault.text[1:]}"
    return FoundCause(
        fault.cause, parameters, (fault.signal,), {"held_out_nats": fault.score}, text,
        "likely" if fault.against else "certain", fault.against,
    )  # fmt: skip


def cause_of_rest(rest: Rest, model: VehicleModel) -> FoundCause:
    """Return the cause for a zero error of the gyroscope at stops."""
    parameters = {
        key: _estimated(model, key, float(x), float(se), PARAMETERS[key].tolerance)
        for key, x, se in zip(GYRO_BIAS, rest.rate, rest.se, strict=True)
    }
    few = ("the drives have only one or two stops",) if rest.stops < 3 else ()
    sigma = float(np.max(np.abs(rest.rate) / rest.se))
    beyond = float(np.max((np.abs(rest.rate) - rest.allowed(model)) / rest.se))
    return FoundCause(
        "gyro_bias", parameters, ("gyro_x", "gyro_y", "gyro_z"),
        {"held_out_nats": min(0.5 * sigma**2, 1e6), "sigma": sigma, "quantile": rest.quantile,
         "beyond_tolerance": beyond, "threshold": rest.quantile},
        f"The zero of the gyroscope is off, measured in {counted(rest.stops, 'stop')}.",
        "certain", few,
    )  # fmt: skip


def cause_of_shift(shift: FittedShift, table: Table) -> FoundCause:
    """Return the cause for a rotation of the sensor in the middle of a drive."""
    parameters = {
        f"mount.shifts.{angle}_deg": Estimated(
            float(x) * DEG_PER_RAD, float(se) * DEG_PER_RAD, "deg", 0.0, 0.3
        )
        for angle, x, se in zip(("roll", "pitch", "yaw"), shift.turn, shift.se, strict=True)
    }
    # The text has the interval, which does not lie evenly about this time.
    parameters["mount.shifts.t_s"] = Estimated(shift.start_s, math.nan, "s")
    is_step = shift.kind == "step"
    text = (
        f"The sensor was turned between {shift.low_s:.0f} and {shift.high_s:.0f} s."
        if is_step
        else "The sensor turns slowly during the whole drive."
    )
    text += " The angles are turns about the vehicle's axes."
    sigma = float(np.max(np.abs(shift.turn) / shift.se))
    return FoundCause(
        "mount_shift" if is_step else "mount_creep", parameters, signals_of(table, KEYS),
        {"held_out_nats": shift.shown, "sigma": sigma, "quantile": shift.quantile,
         "beyond_tolerance": shift.beyond_tolerance, "threshold": shift.threshold}, text,
        "certain", ("the parts before and after the turn would be two drives, so nothing else was "
                    "examined",),
    )  # fmt: skip


def other_candidates(state: State) -> tuple[Candidate, ...]:
    """Return every cause that was not named, and the size from which these drives would have shown
    the cause."""
    named = {t.hypothesis.name for t in (*state.named, *state.likely)}
    doubtful = {t.hypothesis.name: t for t in state.doubtful}
    made = []
    for name, t in (questions(state.last) | doubtful).items():
        if name in named:
            continue
        i = int(np.argmax(np.abs(t.estimate.value) / np.maximum(t.estimate.se, 1e-30)))
        x, se, tau = (float(a[i]) for a in (t.estimate.value, t.estimate.se, t.tolerance))
        key, q = t.hypothesis.keys[i], t.estimate.quantile
        outcome: Outcome
        if not t.is_plausible and t.named:
            outcome = "not plausible"
        elif abs(x) + q * se <= tau:
            outcome = "within tolerance"
        elif name in doubtful or (t.shown > SINGLE_NATS and t.is_suspect):
            outcome = "not ruled out"
        elif t.outside:
            outcome = "does not pay"
        else:
            outcome = "not decidable here"
        size = _with_unit(f"{_n(x)} +- {_n(SD_95 * se)}", key)
        text = f"{key} is off by {size}; threshold {_n(tau + q * se)}"
        if outcome == "not ruled out" and abs(x) > tau + q * se:
            text += OTHERWISE
        of_key = key, x, se, tau + q * se, PARAMETERS[key].unit
        made.append(Candidate(name, outcome, t.shown, text, _freed(state, name), *of_key))
    if state.doubtful_shift is not None and state.table is not None:
        shift = state.doubtful_shift
        cause = cause_of_shift(shift, state.table)
        turn = ", ".join(f"{_n(float(x) * DEG_PER_RAD)} +- {_n(SD_95 * float(se) * DEG_PER_RAD)}"
                         for x, se in zip(shift.turn, shift.se, strict=True))  # fmt: skip
        text = f"turned by ({turn}) deg about the vehicle's axes{OTHERWISE}"
        made.append(Candidate(cause.name, "not ruled out", shift.shown, text, cause.parameters))
    return tuple(made)


def _freed(state: State, name: str) -> dict[str, Estimated]:
    """Return estimates of the parameters of all forms of a cause. Each form is fitted separately,
    together with the causes found."""
    made: dict[str, Estimated] = {}
    for t in state.last:
        if t.hypothesis.name != name or t.hypothesis.pattern is not None:
            continue
        for key, *numbers in zip(
            t.hypothesis.keys, t.estimate.value, t.estimate.se, t.tolerance, strict=True
        ):
            made.setdefault(key, _estimated(state.stated, key, *map(float, numbers)))
    return made


def _with_unit(text: str, key: str) -> str:
    """Return the text of a parameter's number with its unit. A pure number has no unit."""
    unit = PARAMETERS[key].unit
    return text if unit in ("", "1") else f"{text} {unit}"


def _n(x: float) -> str:
    return f"{x:.2g}"


def implausible(state: State) -> Iterator[Answer]:
    """Yield explanations that fit the numbers but are physically implausible."""
    for t in state.implausible:
        i = int(np.argmax(np.abs(t.estimate.value) / np.abs(t.plausible).max(axis=1)))
        key = t.hypothesis.keys[i]
        x = float(t.estimate.value[i])
        low, high = t.plausible[i]
        signal = first_signal(state.table, [key])
        text = (
            f"{t.hypothesis.name.replace('_', ' ')} with {key} off by "
            f"{_with_unit(f'{x:.3g} +- {SD_95 * float(t.estimate.se[i]):.2g}', key)} "
            "explains the numbers, "
            f"but {'may be more than is' if t.is_plausible else 'is not'} physically plausible "
            f"({low:.3g} to {high:.3g} is): a cause is missing"
        )
        yield Answer(signal, float(t.estimate.quantile), 0.0, 0.0, text,
                     shown=float(t.estimate.quantile))  # fmt: skip


def look_alikes(state: State) -> tuple[tuple[str, ...], ...]:
    """Return sets of causes that these drives cannot distinguish."""
    sets = []
    for trial in state.named:
        others = [t.hypothesis.name for t in state.rivals.get(trial.hypothesis.name, [])]
        if trial.hypothesis.name == "accel_bias":
            # At one g, the effect of another gain element equals a zero error.
            others += [t.hypothesis.name for t in state.named if t.hypothesis.name in LEVELLED]
        others = [n for n in dict.fromkeys(others) if n != trial.hypothesis.name]
        if others:
            sets.append((trial.hypothesis.name, *others))
    return tuple(sets)


def manoeuvres(sets: Sequence[Sequence[str]]) -> str:
    """Return the manoeuvres that would distinguish the look-alikes."""
    parts = []
    for names in sets:
        ways = list(dict.fromkeys(BY_NAME[n].separate for n in names if n in BY_NAME))
        parts.append(f"{' or '.join(names)}: {'; '.join(ways)}")
    return ". ".join(parts)


def of_signal(
    name: str,
    causes: Sequence[FoundCause],
    sets: Sequence[Sequence[str]],
    structure: Sequence[Structure],
) -> Verdict:
    """Return the verdict of one equation, from its causes and its left-over structure."""
    own = [cause for cause in causes if any(_is_of(signal, name) for signal in cause.signals)]
    names = {cause.name for cause in own}
    return verdict_of(
        own,
        [names_alike for names_alike in sets if names & set(names_alike)],
        [s for s in structure if _is_of(s.signal, name)],
    )


def _is_of(signal: str, equation: str) -> bool:
    """True if an equation predicts this signal, or one of its axes."""
    takes = EQUATIONS[equation].takes
    measured = takes if equation == "speed" else takes[:1]
    return signal == equation or (signal not in EQUATIONS and signal.startswith(measured))


def verdict_of(
    causes: Sequence[FoundCause], sets: Sequence[Sequence[str]], structure: Sequence[Structure]
) -> Verdict:
    """Return one of the four verdicts of the whole diagnosis."""
    if any(s.kind in MISSING for s in structure):
        return "unknown"
    if causes:
        return "ambiguous" if sets else "found"
    return "unknown" if structure else "nothing"
