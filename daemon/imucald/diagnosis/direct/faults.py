"""Faults that are visible in samples and time stamps alone: values piled up on a rail, stuck
signals, lost or doubled frames, wrong cycle.

Each is direct evidence. The samples that a fault makes invalid are kept out of the fit.
`motion.rails` and `motion.sensor_judges` look for the same faults while driving, with the past
samples only; here the whole recording is known. Three cases must be distinguished by all values of
a signal. A third of a recording may lie on a rail. An axis of a vector of constant length is most
often near its largest value. A dead zone may repeat itself.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.stats import binom

from imucald.core.arrays import Array, true_runs
from imucald.core.samples import INERTIAL, QUANTITIES, Samples, Series
from imucald.core.text import counted
from imucald.diagnosis.direct.lost_readings import Lost
from imucald.diagnosis.direct.sample_changes import stays_until_off
from imucald.diagnosis.direct.stamps import clock_of
from imucald.diagnosis.direct.stuck import Fault, stuck
from imucald.diagnosis.direct.visits import visited_too_often
from imucald.diagnosis.signals import Channel, Mask, Spans, duplicates
from imucald.model.model import VehicleModel
from imucald.motion.rail_evidence import PILE

LEAST_ROWS = 100
WATCHED = ("accel", "gyro", "speed", "steering", "yaw_rate", "lateral_accel", "longitudinal_accel")
PILE_SHARE = 2e-4
"""A rail has at least this share of the samples."""
PILE_LEVELS = (3, 10)
"""Numbers of levels below the extreme one with which it is compared."""
CHANCE = 0.01
"""Chance of a false rail in one drive, divided among all ends and levels."""
FEW_STAYS = 2
"""Fewest stays on the rail besides the longest one."""
QUESTIONS = 6 * len(INERTIAL) * (len(PILE_LEVELS) + 1)
"""Number of tests: both ends of three axes of each signal."""
INVALID_S = 0.3
LOST_TOLERANCE, LOST_FEWEST = 0.003, 8
"""Share and number of frames that a bus and a logger may lose without a fault."""
PAUSE_S = 10.0
"""A longer gap [s] begins a new segment, everywhere in this program."""
DOUBLED_TOLERANCE, DOUBLED_FEWEST = 0.001, 5
CLOCK_PPM, CLOCK_UNKNOWN_PPM = 200.0, 10_000.0
"""The first limit is that of two crystals of +-100 ppm over temperature and age. Beyond the second
limit (1 %) the model file states another rate, which is no fault."""


def find_faults(
    samples: Samples, model: VehicleModel, lost: Mapping[str, Lost] | None = None
) -> list[Fault]:
    """Find all faults of samples and stamps that the model file does not state.

    lost: invalid readings by signal (`lost_readings`), which are not the end of a range.
    """
    moving, none = _moving(samples), lost or {}
    found: list[Fault] = []
    for name in WATCHED:
        series = samples.get(name)
        if series is None or len(series.t) < LEAST_ROWS:
            continue
        read = none[name].kept(series) if name in none else series
        piled = list(_piled(name, read, model)) if name in INERTIAL else []
        own = (series.t, series.values) if name == "speed" else moving
        held = list(stuck(name, series, samples, own, piled))
        if held and stays_until_off(name, Channel.of(series)):
            held = []
        found += [*piled, *held]
        found += _timed(name, series, model)
    return found


def invalid_spans(
    faults: Sequence[Fault], samples: Samples, lost: Mapping[str, Lost], held: bool = False
) -> dict[str, Spans]:
    """Intervals of time by signal that must not be used. held: at a rail, only the samples on the
    rail itself."""
    made: dict[str, Spans] = {n: spans_of(samples[n].t, gone.rows) for n, gone in lost.items()}
    for fault in faults:
        own = fault.held if held and fault.held else fault.spans
        made[fault.signal] = (*made.get(fault.signal, ()), *own)
    return made


def _moving(samples: Samples) -> tuple[Array, Array]:
    """Return times and speeds. The speed is 0 while its signal is stuck, because nothing then shows
    that the vehicle moves."""
    speed = samples["speed"]
    values = np.where(np.isfinite(speed.values), speed.values, 0.0)
    if len(speed.t) >= LEAST_ROWS:
        for fault in stuck("speed", speed, samples, (speed.t, values)):
            for low, high in fault.spans:
                values = np.where((speed.t >= low) & (speed.t <= high), 0.0, values)
    return speed.t, values


# pile-up -----------------------------------------------------------------------------------------


def _piled(name: str, series: Series, model: VehicleModel) -> Iterator[Fault]:
    """Find a value at the end of a signal's range that occurs far more often than its
    neighbours."""
    table = series.values.reshape(len(series.t), -1)
    still = np.zeros(len(table), dtype=bool)
    still[1:] = (np.diff(table, axis=0) == 0.0).all(axis=1)
    hit = np.zeros(len(table), dtype=bool)
    rails = []
    for axis in range(table.shape[1]):
        x = table[:, axis]
        if np.ptp(x) == 0.0:
            continue
        for sign in (1.0, -1.0):
            rail = _rail(sign * x, still if table.shape[1] > 1 else np.zeros_like(still))
            if rail is not None:
                hit |= sign * x >= rail - 1e-9 * max(1.0, abs(rail))
                rails.append(sign * rail)
    if not rails:
        return
    share = float(hit.mean())
    # a signal that never crosses 0 has no symmetric range that a model file could state
    size = float(min((abs(r) for r in rails if r != 0.0), default=0.0))
    shown = ", ".join(f"{r:.4g}" for r in rails)
    unit = QUANTITIES[name].unit
    yield Fault(
        "saturation", name, {f"{name}.full_scale": (size, 0.0, unit)} if size else {},
        f"{100 * share:.2g} % of the samples have the value {shown} {unit}, far more than "
        "its neighbours.",
        {f"{name}.full_scale": size} if size and name in ("accel", "gyro") else {},
        spans_of(series.t, hit), 0.5 * float(hit.sum()), _runs_of(series.t, hit),
    )  # fmt: skip


def _rail(x: Array, still: Mask) -> float | None:
    """The largest value, if it occurs more often than the levels below it or lasts longer."""
    top = float(x.max())
    near = 1e-9 * max(1.0, abs(top))
    at = (x >= top - near) & ~still
    if at.sum() < PILE_SHARE * len(x) or _is_thickest_there(x[~still], top, near):
        return None
    return top if _is_crowded(x[~still], top, near) or _is_held(x, at) else None


def _is_thickest_there(x: Array, top: float, near: float) -> bool:
    """True if values do not become rarer from the median to the largest. A rail cuts off a tail. A
    naturally limited signal, such as an axis of a vector of constant length, is most frequent at
    its limit."""
    middle = float(np.median(x))
    between = x[(x > middle + near) & (x < top - near)] - 0.5 * (middle + top)
    if middle >= top - near:
        return True
    above, below = int((between > near).sum()), int((between < -near).sum())
    chance = binom.sf(above - 1, above + below, PILE / (PILE + 1.0))
    return bool(chance < CHANCE / QUESTIONS)


def _is_crowded(x: Array, top: float, near: float) -> bool:
    """True if a value occurs more often than the levels below it. Without clipping, the end of a
    range is rarer."""
    at = x >= top - near
    below = x[~at]
    values = np.unique(x[x > np.quantile(x, 0.9)])
    step = float(np.median(np.diff(values))) if len(values) > 2 else 0.0
    if step == 0.0 or not len(below):
        return False
    width = max(step, float(top - below.max()))
    for levels in PILE_LEVELS:
        beside = int((below > top - (levels + 0.5) * width).sum())
        if visited_too_often(at, beside, levels, CHANCE / QUESTIONS):
            return True
    return False


def _is_held(x: Array, at: Mask) -> bool:
    """True if a signal stays longer at its highest values than at its other turning points. Of n
    samples in k stays there, n - k are repeats; their number is binomial with the share of repeats
    elsewhere. The longest stay does not count, because a single stop must not decide."""
    first = np.flatnonzero(np.concatenate([[True], np.diff(x) != 0.0]))
    level, length = x[first], np.diff(np.append(first, len(x)))
    turns = np.zeros(len(level), dtype=bool)
    turns[1:-1] = (level[1:-1] > level[:-2]) & (level[1:-1] > level[2:])
    own = np.sort(length[at[first]])[:-1]
    others = np.sort(length[turns & ~at[first]])
    if len(own) < FEW_STAYS or len(others) < 10 * FEW_STAYS:
        return False
    # Values also stay constant while the vehicle stands.
    others = others[: int(0.99 * len(others)) + 1]
    share = PILE * float(1.0 - len(others) / others.sum()) + 1.0 / float(others.sum())
    repeats = int(own.sum() - len(own))
    return bool(share < 1.0 and binom.sf(repeats - 1, own.sum(), share) < CHANCE / QUESTIONS)


def _runs_of(t: Array, hit: Mask) -> Spans:
    """Intervals of time that contain these rows and no others."""
    return tuple((float(t[first]), float(t[after - 1])) for first, after in true_runs(hit))


def spans_of(t: Array, hit: Mask) -> Spans:
    """Intervals of time about rows; close intervals are joined."""
    at = t[hit]
    if not len(at):
        return ()
    cuts = np.flatnonzero(np.diff(at) > 2.0 * INVALID_S)
    first = np.concatenate([[0], cuts + 1])
    last = np.concatenate([cuts, [len(at) - 1]])
    return tuple((float(at[a] - INVALID_S / 3), float(at[b] + INVALID_S / 3))
                 for a, b in zip(first, last, strict=True))  # fmt: skip


# stamps ------------------------------------------------------------------------------------------


def _timed(name: str, series: Series, model: VehicleModel) -> Iterator[Fault]:
    """Find lost frames, doubled frames, and a cycle that differs from the stated one."""
    message = getattr(model, name)
    period = float(np.median(np.diff(series.t)))
    again = duplicates(series, period)  # not frames with a shared stamp but other values
    doubled = int(again.sum())
    if doubled >= DOUBLED_FEWEST and doubled > DOUBLED_TOLERANCE * len(again):
        share = doubled / len(again)
        text = f"{counted(doubled, 'frame comes', 'frames come')} twice with the same value."
        yield Fault(
            "duplicated_frames", name, {f"_{name}.doubled": (share, 0.0, "1")},
            text, {}, (), 2.0 * doubled,
        )  # fmt: skip
    t = series.t[~again]
    clock = clock_of(t)
    if clock is None:
        return
    # A pause of the sender or the logger is no loss of frames.
    steps = np.where(np.diff(t) > PAUSE_S, 1.0, clock.steps)
    sent = int(steps.sum()) + 1
    lost = sent - len(t)
    stated = float(message.loss)
    chance = 5.0 * np.sqrt(max(stated, 1e-4) * sent)
    loses = lost >= LOST_FEWEST and lost - stated * sent > max(LOST_TOLERANCE * sent, chance)
    if loses and not _has_other_rate(steps):
        share = lost / sent
        yield Fault(
            "dropouts", name, {f"{name}.loss": (share, float(np.sqrt(share / sent)), "1")},
            f"{lost} of {sent} frames are missing ({100 * share:.2g} %).",
            {f"{name}.loss": share}, (), float(lost),
        )  # fmt: skip
    ppm, se = 1e6 * (clock.cycle_s * message.rate_hz - 1.0), 1e6 * clock.se
    off = ppm - message.clock_drift_ppm
    if (
        clock.is_steady
        and name in ("accel", "gyro", "speed", "steering", "yaw_rate")
        and (CLOCK_PPM + 5.0 * se < abs(off) < CLOCK_UNKNOWN_PPM)
    ):
        key = f"{name}.clock_drift_ppm"
        cycle = f"{1000 * clock.cycle_s:.5g} ms"
        has_holes = lost > LOST_TOLERANCE * sent
        yield Fault(
            "clock_drift", name, {key: (ppm, se, "ppm")},
            f"The cycle is {cycle}, which differs by {off:+.0f} ppm from the model file.",
            {} if has_holes else {key: ppm}, (), abs(off) / CLOCK_PPM * 10.0,
            against=("frames are missing, so they were counted by their time stamps",) * has_holes,
        )  # fmt: skip


def _has_other_rate(steps: Array) -> bool:
    """True if wide steps follow each other, as when a sender changes its rate without losing
    frames. After most random or burst losses a step of one cycle follows. steps: (N,) cycles."""
    wide = steps > 1.0
    return bool(wide[:-1].sum() > 0 and wide[1:][wide[:-1]].mean() > 0.5)
