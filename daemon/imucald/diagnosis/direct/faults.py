"""Faults that show in samples and time stamps alone: pile-up, stuck, lost, doubled, wrong cycle.

Each is direct evidence. The samples that it makes invalid are kept from the fit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.stats import binom

from imucald.core.arrays import Array
from imucald.core.samples import INERTIAL, QUANTITIES, Samples, Series
from imucald.core.text import counted
from imucald.diagnosis.direct.lost_readings import Lost
from imucald.diagnosis.direct.sample_changes import stays_until_off
from imucald.diagnosis.direct.stuck import Fault, stuck
from imucald.diagnosis.direct.visits import PILE_RATIO, visited_too_often
from imucald.diagnosis.signals import Channel, Mask, Spans, duplicates
from imucald.model.model import VehicleModel

LEAST_ROWS = 100
WATCHED = ("accel", "gyro", "speed", "steering", "yaw_rate", "lateral_accel", "longitudinal_accel")
PILE_SHARE = 2e-4
"""A rail is met in so many of the samples."""
PILE_LEVELS = (3, 10)
"""Levels below the extreme one that it is held against."""
CHANCE = 0.01
"""Of a drive: that a rail is reported without a reason; shared out over ends and levels."""
FEW_STAYS = 2
"""Besides the longest."""
QUESTIONS = 6 * len(INERTIAL) * (len(PILE_LEVELS) + 1)
"""Both ends of three axes of each signal."""
INVALID_S = 0.3
LOST_TOLERANCE, LOST_FEWEST = 0.003, 8
"""Frames that a bus and a logger may lose without a fault."""
PAUSE_S = 10.0
"""A hole that is longer begins a new segment everywhere in this program."""
DOUBLED_TOLERANCE, DOUBLED_FEWEST = 0.001, 5
NEAR, NEAR_SHARE, JITTER_SHARE, WANDER_S = 0.85, 0.4, 0.2, 0.01
"""A cycle is known where most stamps are near it, scatter little, and do not walk away from it: who
is asked for each value (OBD-II) has none."""
ADDED_UP = 0.5
"""Variance of the sum of many steps over the sum of their variances: 1 where each begins when the
one before it ends (who is asked again on the answer), near 0 where a clock sends (variance ratio;
Lo and MacKinlay 1988)."""
LOCKS, NEIGHBOURS = 4, 50
"""Stamps that share a phase: a cycle known to 1 % moves it by half a cycle at most."""
CLOCK_PPM, CLOCK_UNKNOWN_PPM = 200.0, 10_000.0
"""Two crystals of +-100 ppm over temperature and age. Further off than 1 % the model file states
another rate: that is no fault."""


def find_faults(
    samples: Samples, model: VehicleModel, lost: Mapping[str, Lost] | None = None
) -> list[Fault]:
    """Everything that is wrong with samples and stamps beyond what the model file says.

    lost: readings by signal that are none (`lost_readings`), on which no range ends.
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
    """Intervals of time by signal that must not be used. held: of a rail its own samples alone."""
    made: dict[str, Spans] = {n: spans_of(samples[n].t, gone.rows) for n, gone in lost.items()}
    for fault in faults:
        own = fault.held if held and fault.held else fault.spans
        made[fault.signal] = (*made.get(fault.signal, ()), *own)
    return made


def _moving(samples: Samples) -> tuple[Array, Array]:
    """Speed; 0 where it is stuck itself, since nothing says then that the vehicle moves."""
    speed = samples["speed"]
    values = np.where(np.isfinite(speed.values), speed.values, 0.0)
    if len(speed.t) >= LEAST_ROWS:
        for fault in stuck("speed", speed, samples, (speed.t, values)):
            for low, high in fault.spans:
                values = np.where((speed.t >= low) & (speed.t <= high), 0.0, values)
    return speed.t, values


# pile-up -----------------------------------------------------------------------------------------


def _piled(name: str, series: Series, model: VehicleModel) -> Iterator[Fault]:
    """A value at the end of a signal's range that is held far oftener than those next to it."""
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
    # what never goes beyond 0 has no symmetric range that a model file could state
    size = float(min((abs(r) for r in rails if r != 0.0), default=0.0))
    shown = ", ".join(f"{r:.4g}" for r in rails)
    unit = QUANTITIES[name].unit
    yield Fault(
        "saturation", name, {f"{name}.full_scale": (size, 0.0, unit)} if size else {},
        f"Values pile up at {shown} {unit}: {100 * share:.2g} % of the samples.",
        {f"{name}.full_scale": size} if size and name in ("accel", "gyro") else {},
        spans_of(series.t, hit), 0.5 * float(hit.sum()), _runs_of(series.t, hit),
    )  # fmt: skip


def _rail(x: Array, still: Mask) -> float | None:
    """The largest value, if it is met oftener than those below it, or held for longer."""
    top = float(x.max())
    near = 1e-9 * max(1.0, abs(top))
    at = (x >= top - near) & ~still
    if at.sum() < PILE_SHARE * len(x) or _is_thickest_there(x[~still], top, near):
        return None
    return top if _is_crowded(x[~still], top, near) or _is_held(x, at) else None


def _is_thickest_there(x: Array, top: float, near: float) -> bool:
    """Whether values do not get rarer from the median on towards the largest. A rail cuts a tail;
    what cannot be larger by its nature, as an axis of a vector of one length, ends where it is met
    most."""
    middle = float(np.median(x))
    between = x[(x > middle + near) & (x < top - near)] - 0.5 * (middle + top)
    if middle >= top - near:
        return True
    above, below = int((between > near).sum()), int((between < -near).sum())
    chance = binom.sf(above - 1, above + below, PILE_RATIO / (PILE_RATIO + 1.0))
    return bool(chance < CHANCE / QUESTIONS)


def _is_crowded(x: Array, top: float, near: float) -> bool:
    """Whether a value is met oftener than the levels below it: the end of a range is not, where
    nothing is clipped."""
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
    """Whether a signal stays at its highest for longer than at its other turning points: of n
    samples on k such levels n - k are repeats, binomial with the share of repeats elsewhere. The
    longest stay does not count: one stop must not decide."""
    first = np.flatnonzero(np.concatenate([[True], np.diff(x) != 0.0]))
    level, length = x[first], np.diff(np.append(first, len(x)))
    turns = np.zeros(len(level), dtype=bool)
    turns[1:-1] = (level[1:-1] > level[:-2]) & (level[1:-1] > level[2:])
    own = np.sort(length[at[first]])[:-1]
    others = np.sort(length[turns & ~at[first]])
    if len(own) < FEW_STAYS or len(others) < 10 * FEW_STAYS:
        return False
    # A standing vehicle's values stay as well.
    others = others[: int(0.99 * len(others)) + 1]
    share = PILE_RATIO * float(1.0 - len(others) / others.sum()) + 1.0 / float(others.sum())
    repeats = int(own.sum() - len(own))
    return bool(share < 1.0 and binom.sf(repeats - 1, own.sum(), share) < CHANCE / QUESTIONS)


def _runs_of(t: Array, hit: Mask) -> Spans:
    """Intervals of time that hold the rows, and no other."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], hit.astype(np.int8), [0]])))
    return tuple(zip(t[edges[::2]].tolist(), t[edges[1::2] - 1].tolist(), strict=True))


def spans_of(t: Array, hit: Mask) -> Spans:
    """Intervals of time about rows, those close to each other joined."""
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
    """Lost frames, doubled frames, and a cycle that is not the stated one."""
    message = getattr(model, name)
    period = float(np.median(np.diff(series.t)))
    again = duplicates(series, period)  # not what shares a stamp, and says something else
    doubled = int(again.sum())
    if doubled >= DOUBLED_FEWEST and doubled > DOUBLED_TOLERANCE * len(again):
        share = doubled / len(again)
        text = f"{counted(doubled, 'frame comes', 'frames come')} twice with the same value."
        yield Fault(
            "duplicated_frames", name, {f"_{name}.doubled": (share, 0.0, "1")},
            text, {}, (), 2.0 * doubled,
        )  # fmt: skip
    t = series.t[~again]
    clock = _cycle(t)
    if clock is None:
        return
    cycle, se, steps, is_steady = clock
    # A pause of the sender or the logger is no loss.
    steps = np.where(np.diff(t) > PAUSE_S, 1.0, steps)
    sent = int(steps.sum()) + 1
    lost = sent - len(t)
    stated = float(message.loss)
    chance = 5.0 * np.sqrt(max(stated, 1e-4) * sent)
    if (
        lost >= LOST_FEWEST
        and lost - stated * sent > max(LOST_TOLERANCE * sent, chance)
        and not _has_other_rate(steps)
    ):
        share = lost / sent
        yield Fault(
            "dropouts", name, {f"{name}.loss": (share, float(np.sqrt(share / sent)), "1")},
            f"{lost} of {sent} frames are missing ({100 * share:.2g} %).",
            {f"{name}.loss": share}, (), float(lost),
        )  # fmt: skip
    ppm = 1e6 * (cycle * message.rate_hz - 1.0)
    off = ppm - message.clock_drift_ppm
    if (
        is_steady
        and name in ("accel", "gyro", "speed", "steering", "yaw_rate")
        and (CLOCK_PPM + 5.0 * 1e6 * se < abs(off) < CLOCK_UNKNOWN_PPM)
    ):
        yield Fault(
            "clock_drift", name, {f"{name}.clock_drift_ppm": (ppm, 1e6 * se, "ppm")},
            f"The cycle is {1000 * cycle:.5g} ms, {off:+.0f} ppm off what the model file states.",
            {f"{name}.clock_drift_ppm": ppm}, (), abs(off) / CLOCK_PPM * 10.0,
        )  # fmt: skip


def _has_other_rate(steps: Array) -> bool:
    """Whether wide steps follow each other: a sender that changes its rate loses nothing. Of losses
    at random or in bursts most are followed by a step of one cycle. steps: (N,) cycles."""
    wide = steps > 1.0
    return bool(wide[:-1].sum() > 0 and wide[1:][wide[:-1]].mean() > 0.5)


def _cycle(t: Array) -> tuple[float, float, Array, bool] | None:
    """Cycle time [s], its relative deviation, cycles between frames, whether stamps keep to it over
    the drive (a logger's clock that wanders still shows what is lost); None without a clear one."""
    steps = np.diff(t)
    if len(steps) < 50:
        return None
    cycle = float(np.median(steps))
    near = np.abs(steps - cycle) < NEAR_SHARE * cycle
    if near.mean() < NEAR or np.std(steps[near]) > JITTER_SHARE * cycle:
        return None
    at = t - t[0]
    for _ in range(LOCKS):
        count = _counted(at, cycle)
        centred = count - count.mean()
        slope = float(centred @ (at - at.mean()) / (centred @ centred))
        if abs(slope / cycle - 1.0) > 0.02:
            return None
        cycle = slope
    left = at - at.mean() - cycle * centred
    is_steady = bool(np.std(left) <= WANDER_S + 0.3 * cycle) and not _adds_up(steps, cycle)
    # Stamps wander slowly: halves of the drive are compared, not samples.
    half = len(count) // 2
    ends = [np.polyfit(count[s], at[s], 1)[0] for s in (slice(0, half), slice(half, None))]
    se = max(abs(ends[1] - ends[0]) / 2.0, float(np.std(left) / np.sqrt(centred @ centred)))
    return cycle, se / cycle, np.round(steps / cycle), is_steady


def _adds_up(steps: Array, cycle: float) -> bool:
    """Whether delay adds up from frame to frame: then nothing sends in a cycle, and the mean of
    the steps is no clock's. steps: (N,) [s]."""
    late = steps - cycle * np.maximum(np.round(steps / cycle), 1.0)
    late = late[np.abs(late) < NEAR_SHARE * cycle]
    late = late - late.mean()
    total = np.concatenate([[0.0], np.cumsum(late)])
    many = min(NEIGHBOURS, len(late) // 2)
    power = float(np.mean((total[many:] - total[:-many]) ** 2))
    return bool(power > WANDER_S**2 and power > ADDED_UP * many * float(np.mean(late**2)))


def _counted(at: Array, cycle: float) -> Array:
    """(N,) whole cycles since the first frame. at: (N,) stamps [s], one comes at 0.

    Each stamp is counted from the phase of its neighbours (circular mean), which moves slowly.
    Steps that are rounded one by one lose a cycle for good wherever two late frames lie just so.
    """
    share = at / cycle
    first = np.arange(0, len(at), NEIGHBOURS)
    turns = np.add.reduceat(np.exp(2j * np.pi * share), first)
    middle = np.add.reduceat(at, first) / np.diff(np.append(first, len(at)))
    phase = np.unwrap(np.angle(turns)) / (2.0 * np.pi)
    return np.asarray(np.round(share - np.interp(at, middle, phase)))
