"""Faults that are visible in samples and time stamps alone: values at the end of a range, stuck
signals, lost or doubled frames, a wrong cycle time.

Each fault is direct evidence. The samples that a fault makes invalid are not used in the fit. Ends
of a range and repeated values of sensors are found with the same tests as in live operation
(`motion.recorded_health`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from imucald.core.arrays import Array, true_runs
from imucald.core.samples import INERTIAL, QUANTITIES, Samples, Series
from imucald.core.text import counted
from imucald.diagnosis.direct.lost_readings import Lost
from imucald.diagnosis.direct.sample_changes import stays_until_off
from imucald.diagnosis.direct.stamps import clock_of
from imucald.diagnosis.direct.stuck import STUCK, Fault, is_shown_often, stuck, stuck_fault
from imucald.diagnosis.signals import Channel, Mask, Spans, duplicates
from imucald.model.model import VehicleModel
from imucald.motion.recorded_health import recorded_health

LEAST_ROWS = 100
WATCHED = ("accel", "gyro", "speed", "steering", "yaw_rate", "lateral_accel", "longitudinal_accel")
CHANCE = 0.01
"""Chance of a falsely found end of a range or stuck value in one drive. This chance is divided
among the sensors."""
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


def find_faults(
    samples: Samples, model: VehicleModel, lost: Mapping[str, Lost] | None = None
) -> list[Fault]:
    """Return all faults of samples and time stamps that the model file does not state.

    lost: invalid readings by signal (`lost_readings`). Readings at the end of a range are not
    invalid.
    """
    moving, none = _moving(samples), lost or {}
    found: list[Fault] = []
    for name in WATCHED:
        series = samples.get(name)
        if series is None or len(series.t) < LEAST_ROWS:
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
    faults: Sequence[Fault], samples: Samples, lost: Mapping[str, Lost], held: bool = False
) -> dict[str, Spans]:
    """Return, by signal, the intervals of time that must not be used. held: at the end of a range,
    return only the samples with the end value."""
    made: dict[str, Spans] = {n: spans_of(samples[n].t, gone.rows) for n, gone in lost.items()}
    for fault in faults:
        own = fault.held if held and fault.held else fault.spans
        made[fault.signal] = (*made.get(fault.signal, ()), *own)
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
        # a signal that never crosses 0 has no symmetric range that a model file could state
        size = min((abs(end) for end in found.ends if end), default=0.0)
        shown = ", ".join(f"{end:.4g}" for end in found.ends)
        unit = QUANTITIES[name].unit
        yield Fault(
            "saturation", name, {f"{name}.full_scale": (size, 0.0, unit)} if size else {},
            f"{100 * share:.2g} % of the samples have the value {shown} {unit}, more than "
            "the tail of its values allows.",
            {f"{name}.full_scale": size} if size and name in ("accel", "gyro") else {},
            spans_of(series.t, hit), 0.5 * float(hit.sum()), _runs_of(series.t, hit),
        )  # fmt: skip
    held = _runs_of(series.t, found.stuck & ~hit)
    if spans := [span for span in held if not is_shown_often(series, span)]:
        yield stuck_fault(name, spans)


def _runs_of(t: Array, hit: Mask) -> Spans:
    """Return the intervals of time that contain exactly these rows."""
    return tuple((float(t[first]), float(t[after - 1])) for first, after in true_runs(hit))


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
    """True if long steps follow each other. The sender has then changed its rate, and no frames are
    lost. After most random losses or burst losses, a step of one cycle follows. steps: (N,)
    [cycles]."""
    wide = steps > 1.0
    return bool(wide[:-1].sum() > 0 and wide[1:][wide[:-1]].mean() > 0.5)
