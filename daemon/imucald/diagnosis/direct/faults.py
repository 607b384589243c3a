"""Faults that are visible in samples and time stamps alone: values at the end of a range, stuck
signals, lost or doubled frames, a wrong cycle time.

Each fault is direct evidence. The samples that a fault makes invalid are not used in the fit. Ends
of a range and repeated values of sensors are found with the same tests as in live operation
(`motion.recorded_health`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imucald.can.lost_frames import cycle_of
from imucald.core.arrays import Array, true_runs
from imucald.core.samples import INERTIAL, QUANTITIES, Samples, Series
from imucald.core.text import counted
from imucald.diagnosis.direct.levels import levels_of, step_of
from imucald.diagnosis.direct.single_values import LEAST_ROWS, Lost
from imucald.diagnosis.direct.stuck import STUCK, Fault, is_shown_often, stuck, stuck_fault
from imucald.diagnosis.direct.successive import stays_until_off
from imucald.diagnosis.signals import CHANCE, SIGNALS, Channel, Mask, Spans, duplicates
from imucald.model.model import VehicleModel
from imucald.motion.recorded_health import recorded_health

WANDER_S = 0.01
"""Largest drift of time stamps away from a steady cycle [s]."""
ADDED_UP = 0.5
"""Limit of the variance ratio: variance of a sum of many steps divided by the sum of their
variances (Lo and MacKinlay 1988). The ratio is 1 if each step begins when the previous step ends (a
new request after each answer). The ratio is near 0 if a clock triggers the frames."""
LOCKS, NEIGHBOURS = 4, 50
"""`NEIGHBOURS` is the number of neighbouring time stamps with a common phase. Over these time
stamps, an error of 1 % in the cycle time moves the phase by at most half a cycle. `LOCKS` is the
number of iterations."""
PARTS = 8
"""Number of parts of a drive. The scatter of the slopes in these parts gives the accuracy of the
slope in the whole drive."""
INVALID_S = 0.3
LOST_TOLERANCE, LOST_FEWEST = 0.003, 8
"""Share and number of frames that a bus and a logger may lose without a fault."""
PAUSE_S = 10.0
"""Gap after which a new segment begins [s], everywhere in this program."""
DOUBLED_TOLERANCE, DOUBLED_FEWEST = 0.001, 5
CLOCK_PPM, CLOCK_UNKNOWN_PPM = 200.0, 10_000.0
"""Two limits of a clock error [ppm]. The first limit is the largest difference between two crystals
of +-100 ppm over temperature and age. Beyond the second limit (1 %), the model file states another
rate, which is not a fault."""


@dataclass(frozen=True)
class Clock:
    """Cycle time of frames."""

    cycle_s: float
    se: float
    """Relative standard deviation of the cycle time."""
    steps: Array
    """Number of cycles between successive frames (N - 1,). With coarse time stamps, the number may
    be 0 and then 2. Only a lost frame changes the sum."""
    is_steady: bool
    """True if the time stamps follow the cycle over the whole drive. Lost frames are also visible
    if the clock of the logger wanders."""
    adds_up: bool
    """True if delays add up from frame to frame. No clock then triggers the frames, and a late
    frame cannot be distinguished from a lost frame."""


def clock_of(t: Array) -> Clock | None:
    """Estimate the cycle time from time stamps t (N,) [s], with a straight line over the frame
    numbers. None without a clear cycle.

    If frames are lost, the median of the steps is not the cycle time, because it is then another
    quantile of the jitter."""
    steps = np.diff(t)
    if len(steps) < 50:
        return None
    found = cycle_of(steps[steps < PAUSE_S])
    if found is None:
        return None
    at, cycle = t - t[0], found.seconds
    for _ in range(LOCKS):
        count = _counted(at, cycle)
        left, slope = _line(count, at)
        if abs(slope / cycle - 1.0) > 0.02:
            return None
        cycle = slope
    rows = np.arange(len(at), dtype=float)
    by_rows, slope = _line(rows, at)
    if np.std(by_rows) <= np.std(left):
        count, cycle, left = rows, slope, by_rows
    adds_up = _adds_up(steps, cycle)
    is_steady = bool(np.std(left) <= WANDER_S + 0.3 * cycle) and not adds_up
    # Errors that wander from stamp to stamp add up, so slopes of parts are compared, not samples.
    parts = zip(np.array_split(count, PARTS), np.array_split(at, PARTS), strict=True)
    slopes = [np.polyfit(n, t, 1)[0] for n, t in parts]
    se = float(np.std(slopes, ddof=1) / np.sqrt(PARTS))
    return Clock(cycle, se / cycle, np.diff(count), is_steady, adds_up)


def _line(count: Array, at: Array) -> tuple[Array, float]:
    """Return the delays (N,) of time stamps [s] relative to a straight line over their counts (N,),
    and its slope [s]."""
    centred = count - count.mean()
    slope = float(centred @ (at - at.mean()) / (centred @ centred))
    return np.asarray(at - at.mean() - slope * centred), slope


def late_steps(steps: Array, cycle: float) -> Array:
    """Return the delays (N,) of steps relative to whole cycles [s], at least one cycle."""
    return np.asarray(steps - cycle * np.maximum(np.round(steps / cycle), 1.0))


def _adds_up(steps: Array, cycle: float) -> bool:
    """True if delays add up from frame to frame. No clock then triggers the frames, and the mean
    step is not the cycle time of a clock. steps: (N,) [s]."""
    late = late_steps(steps, cycle)
    late = late[np.abs(late) < 0.4 * cycle]  # beyond half a cycle, a frame is early
    late = late - late.mean()
    total = np.concatenate([[0.0], np.cumsum(late)])
    many = min(NEIGHBOURS, len(late) // 2)
    power = float(np.mean((total[many:] - total[:-many]) ** 2))
    return bool(power > WANDER_S**2 and power > ADDED_UP * many * float(np.mean(late**2)))


def _counted(at: Array, cycle: float) -> Array:
    """Return the number of whole cycles since the first frame (N,). at: (N,) time stamps [s]; the
    first is 0.

    Each time stamp is counted from the phase of its neighbours (circular mean), which moves slowly.
    If each step were rounded separately, two late frames could lose a cycle permanently.
    """
    share = at / cycle
    first = np.arange(0, len(at), NEIGHBOURS)
    turns = np.add.reduceat(np.exp(2j * np.pi * share), first)
    middle = np.add.reduceat(at, first) / np.diff(np.append(first, len(at)))
    phase = np.unwrap(np.angle(turns)) / (2.0 * np.pi)
    return np.asarray(np.round(share - np.interp(at, middle, phase)))


def find_faults(
    samples: Samples, model: VehicleModel, lost: Mapping[str, Lost] | None = None
) -> list[Fault]:
    """Return all faults of samples and time stamps that the model file does not state.

    lost: invalid readings by signal (`lost_readings`). Readings at the end of a range are not
    invalid.
    """
    moving, none = _moving(samples), lost or {}
    found: list[Fault] = []
    for name in SIGNALS:
        series = samples.get(name)
        if name == "wheel_speeds" or series is None or len(series.t) < LEAST_ROWS:
            continue
        if name in INERTIAL:
            read = none[name].kept(series) if name in none else series
            shown = list(_of_sensor(name, read, moving))
        else:
            own = (series.t, series.values) if name == "speed" else moving
            shown = list(stuck(name, series, samples, own))
        if any(f.cause == STUCK for f in shown) and stays_until_off(
            name, Channel.from_series(series)
        ):
            shown = [f for f in shown if f.cause != STUCK]
        found += shown
        found += _timed(name, series, model)
    return found


def invalid_spans(
    faults: Sequence[Fault], samples: Samples, lost: Mapping[str, Lost]
) -> dict[str, Spans]:
    """Return, by signal, the intervals of time that must not be used."""
    made: dict[str, Spans] = {n: spans_of(samples[n].t, gone.rows) for n, gone in lost.items()}
    for fault in faults:
        made[fault.signal] = (*made.get(fault.signal, ()), *fault.spans)
    return made


def _moving(samples: Samples) -> tuple[Array, Array]:
    """Return times and speeds. The speed is set to 0 while its signal is stuck, because no signal
    then shows that the vehicle moves."""
    speed = samples["speed"]
    values = np.where(np.isfinite(speed.values), speed.values, 0.0)
    if len(speed.t) >= LEAST_ROWS:
        for fault in stuck("speed", speed, samples, (speed.t, values)):
            for low, high in fault.spans:
                values = np.where((speed.t >= low) & (speed.t <= high), 0.0, values)
    return speed.t, values


def _of_sensor(name: str, series: Series, moving: tuple[Array, Array]) -> Iterator[Fault]:
    """Yield the faults of a sensor's values: samples at the end of the range, and repeated
    values."""
    found = recorded_health(name, series.t, series.values, moving, CHANCE / len(INERTIAL))
    hit = found.on_rail
    if hit.any():
        share = float(hit.mean())
        shown = ", ".join(f"{_axis_of(series.values, end)}{end:.4g}" for end in found.ends)
        unit, size = QUANTITIES[name].unit, _common_range(series.values, found.ends)
        text = (
            f"{100 * share:.2g} % of the samples have the value {shown} {unit}, more than "
            "the tail of its values allows."
        )
        if not size:
            text += (
                " The model file has one range for all axes and signs, so it cannot hold "
                f"{'these values' if len(found.ends) > 1 else 'this value'}."
            )
        values = {f"_{name}.clipped": (share, 0.0, "1")}
        if size:
            values[f"{name}.full_scale"] = size, 0.0, unit
        yield Fault(
            "saturation", name, values, text,
            {f"{name}.full_scale": size} if size and name in ("accel", "gyro") else {},
            spans_of(series.t, hit), 0.5 * float(hit.sum()),
        )  # fmt: skip
    t = series.t
    held = [(float(t[a]), float(t[b - 1])) for a, b in true_runs(found.stuck & ~hit)]
    if spans := [span for span in held if not is_shown_often(series, span)]:
        yield stuck_fault(name, spans)


def _axis_of(values: Array, end: float) -> str:
    """Return the name of the axis whose largest or smallest value is this end, with a blank; empty
    for a signal (N,) without axes. values: (N,) or (N, 3)."""
    if values.ndim == 1:
        return ""
    is_end = (values.max(axis=0) == end) | (values.min(axis=0) == end)
    return f"{'xyz'[int(np.argmax(is_end))]} "


def _common_range(values: Array, ends: Sequence[float]) -> float:
    """Return the size of the range that a model file can state: no value (N,) or (N, axes) of any
    axis lies beyond it. 0 if the ends that were found are no such range.

    A converter has one code more on one side, so values may lie one step beyond.
    """
    size = min(abs(end) for end in ends)
    step = step_of(levels_of(np.abs(values)))
    return size if np.abs(values).max() < size + 1.5 * step + 1e-9 * size else 0.0


def spans_of(t: Array, hit: Mask) -> Spans:
    """Return intervals of time around these rows, with a margin. Close intervals are joined."""
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
    """Yield the faults of a signal's frames: lost frames, doubled frames, and a cycle time that
    differs from the stated one."""
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
    if clock is None or clock.adds_up:
        return
    # A pause of the sender or the logger is no loss of frames.
    steps = np.where(np.diff(t) > PAUSE_S, 1.0, clock.steps)
    sent = int(steps.sum()) + 1
    lost = sent - len(t)
    stated = float(message.loss)
    chance = 5.0 * np.sqrt(max(stated, 1e-4) * sent)
    loses = lost >= LOST_FEWEST and lost - stated * sent > max(LOST_TOLERANCE * sent, chance)
    # If long steps follow each other, the sender has changed its rate and loses no frames. After
    # most losses, a step of one cycle follows.
    wide = steps > 1.0
    has_other_rate = wide[:-1].any() and wide[1:][wide[:-1]].mean() > 0.5
    if loses and not has_other_rate:
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
