"""One case judged: the fault put in, frames made and taken, what was sent beside the truth."""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.integrity import force
from benchmarks.integrity.bases import MEASURED, SIMULATED, Base, simulated
from benchmarks.integrity.bus import configuration, frames
from benchmarks.integrity.cases import CLIPPED, FOUND, QUIET, SATURATED, Case, put
from benchmarks.integrity.faults import Faulty
from benchmarks.integrity.judge import (
    Seconds,
    Verdict,
    coverage,
    judged,
    lost_again,
    points,
    until_told,
)
from benchmarks.integrity.sent import FINE, Sent, Triad, sent
from benchmarks.mount_accuracy.drives import FULL
from imucald.can.columns import FrameColumns
from imucald.config import LoadedConfig
from imucald.config_check.checker import Check
from imucald.core.rotations import Matrix3, rotation_from_vector, vector_from_rotation
from imucald.simulation import random_model

Array = NDArray[np.float64]

WRONG = {"accel": 0.5, "gyro": math.radians(2.0)}
"""A value that is off by more is wrong [m/s^2, rad/s]: gravity's share of 3 deg, and the rate of a
bend of 500 m at 60 km/h."""
SEEN_S = 5
"""A fault counts as told where frames were good so shortly before it, or at any time after it."""
CHECKED_S = 600.0
LEVELS = ("error", "warning", "note", "ok")


def case_outcome(case: Case) -> tuple[Case, dict[str, Any] | None]:
    """A case and its outcome. Here, as a spawned process cannot find what `__main__` defines."""
    return case, outcome(case)


def outcome(case: Case) -> dict[str, Any] | None:
    """Judge a case; None where its log is not there."""
    began = time.process_time()
    base = _base(case)
    if base is None:
        return None
    where = put(case, base)
    faulty = case.fault.edit(base, where)
    channels = frozenset(base.samples) - faulty.left_out
    is_simulated = base.seed is not None
    writes = configuration(channels, is_simulated, base.side)
    reads = configuration(channels, is_simulated, base.side, faulty.gyro_factor)
    model = random_model(base.seed) if base.seed is not None else None
    bus = frames(faulty.samples, base.duration_s, writes, model, base.seed or 0)
    found = sent(bus, reads, base.seconds)
    seconds = rows(base, faulty, found)
    told = _told(faulty, found) if faulty.judged else None
    verdict = judged(seconds, faulty.onset, case.fault.allowed, told)
    hits, within, n = coverage(seconds, faulty.onset)
    result = {
        "key": case.key,
        "row": case.row,
        "base": case.base,
        "onset": round(faulty.onset, 2),
        "seen": where.is_seen,
        "variant": where.variant,
        "seconds": base.seconds,
        "driving": int(seconds.moving.sum()),
        **_plain(verdict),
        "hits": hits,
        "within": within,
        "known": n,
        "exposed": bool((seconds.good[max(0, int(faulty.onset) - SEEN_S) :] > 0.0).any()),
        "crash": found.crash,
        "shown": case.fault.is_shown(channels),
        "points": points(seconds, faulty.onset),
        "force": _force(base, faulty, found, seconds),
        **_first_good(seconds, found),
        "level": _checked(bus, reads, base) if case.fault.checked else None,
        "cpu_s": round(time.process_time() - began, 2),
    }
    if base.mounts:
        own = judged(seconds, base.mounts[0][0], FOUND)
        result["own_fault"] = _plain(own)
    elif base.name in SATURATED:
        result["own_fault"] = _plain(
            judged(seconds, 0.0, CLIPPED, until_told(found.accel.t, found.accel.good, 0.0))
        )
    return result


def _base(case: Case) -> Base | None:
    if not case.base.isdigit():
        return MEASURED(case.base)
    if case.row == QUIET.name:
        return simulated(int(case.base), case.minutes, keep=False)
    return SIMULATED(int(case.base), case.minutes)


def rows(base: Base, faulty: Faulty, found: Sent) -> Seconds:
    """What was sent beside what is true, second by second."""
    n = base.seconds
    error = np.full((n, 3), np.nan)
    beyond = np.full(n, np.nan)
    lean = _beyond_expected(base, faulty)
    for k in np.flatnonzero(np.isfinite(found.rotation).all(axis=(1, 2))).tolist():
        true = true_mount(base, faulty, k + 0.5)
        error[k] = np.degrees(vector_from_rotation(true @ found.rotation[k].T))
        beyond[k] = math.degrees(vector_from_rotation(lean @ true @ found.rotation[k].T)[0])
    error[:, ~np.array(base.axes)] = np.nan
    if not base.axes[0]:
        beyond[:] = np.nan
    accel = found.accel
    wrong = np.zeros(n)
    for channel in faulty.judged:
        triad = accel if channel == "accel" else found.gyro
        if triad is not None:
            bad = triad.good & _wrong_values(base, faulty, channel, triad.t)
            wrong = np.maximum(wrong, _share(triad.t, bad, n))
    return Seconds(
        moving=base.moving(),
        good=_share(accel.t, accel.good, n),
        is_fine=_share(accel.t, accel.quality == FINE, n) > 0.0,
        error=error,
        beyond_crown=beyond,
        std=found.std,
        reference_std=np.array(base.reference_std),
        wrong=wrong,
    )


def _beyond_expected(base: Base, faulty: Faulty) -> Matrix3:
    """The mean lean of the roads beyond what the configuration says of them."""
    lean = -base.lean - 2.0 * FULL.crown if faulty.is_turned_round else base.lean
    return rotation_from_vector([lean, 0.0, 0.0])


def _force(base: Base, faulty: Faulty, found: Sent, seconds: Seconds) -> dict[str, Any] | None:
    """Cross-talk and zero that are left in what was sent; None where the truth is not known."""
    if base.response is None:
        return None
    response = base.response.then(faulty.response)
    left = np.full((base.seconds, len(force.ENTRIES)), np.nan)
    for k, applied in enumerate(found.correction):
        if applied is not None:
            true = true_mount(base, faulty, k + 0.5)
            on_roads = _beyond_expected(base, faulty) @ true
            left[k] = force.left_over(applied, response, true, on_roads)
    if found.gyro is None:
        left[:, -2:] = np.nan
    is_stated = np.isfinite(found.sent_std)
    std = np.where(is_stated, found.sent_std, force.stated_of_angles(seconds.std))
    return force.outcome(left, std, seconds.good)


def true_mount(base: Base, faulty: Faulty, t: float) -> Matrix3:
    """R_vehicle_from_sensor at a time [s]."""
    reached = [R for start, R in base.mounts if start <= t]
    R = reached[-1] if reached else base.R_vehicle_from_sensor
    return R if faulty.turn is None else faulty.turn(t) @ R


def _wrong_values(base: Base, faulty: Faulty, channel: str, t: Array) -> NDArray[np.bool_]:
    """Whether the value behind each corrected frame is off by more than may be."""
    sound, edited = base.samples[channel], faulty.samples[channel]
    factor = faulty.gyro_factor if channel == "gyro" else 1.0
    off = np.linalg.norm(factor * edited.values - sound.values, axis=1) > WRONG[channel]
    row = np.clip(np.searchsorted(sound.t, t, side="right") - 1, 0, len(off) - 1)
    return np.asarray(off[row])


def _share(t: Array, flags: NDArray[np.bool_], n: int) -> Array:
    """Share of the frames of each second for which a flag holds (n,); 0 where there is none."""
    k = np.clip(np.floor(t).astype(np.int64), 0, n - 1)
    all_of, some = np.bincount(k, minlength=n), np.bincount(k, flags, n)
    return np.asarray(some / np.maximum(all_of, 1))


def _told(faulty: Faulty, found: Sent) -> tuple[float, float] | None:
    """The longest time over which a faulty sensor's frames were first sent as good."""
    triads = {"accel": found.accel, "gyro": found.gyro}
    spans = [
        until_told(triad.t, triad.good, faulty.onset)
        for channel in faulty.judged
        if (triad := triads[channel]) is not None
    ]
    first = faulty.runs_from
    later = [(max(begun, first), max(ended, first)) for begun, ended in spans]
    return max(later, key=lambda span: span[1] - span[0], default=None)


def _plain(verdict: Verdict) -> dict[str, Any]:
    def number(x: float) -> float | None:
        return None if math.isinf(x) else round(x, 2)

    return {
        "judged": verdict.judged,
        "good": round(verdict.good, 2),
        "fine": verdict.fine,
        "misleading": round(verdict.misleading, 2),
        "beyond": round(verdict.beyond, 2),
        "at_end": verdict.at_end,
        "alert_clock": number(verdict.alert.clock),
        "alert_driving": number(verdict.alert.driving),
    }


def _first_good(seconds: Seconds, found: Sent) -> dict[str, Any]:
    """Seconds of driving until usable and until fine; how often good was lost again."""
    driven = np.cumsum(seconds.moving)

    def after(flags: NDArray[np.bool_]) -> int | None:
        return int(driven[np.argmax(flags)]) if flags.any() else None

    lost = np.zeros(2, dtype=int)
    for triad in (found.accel, found.gyro):
        if isinstance(triad, Triad):
            lost = np.maximum(lost, lost_again(triad.t, triad.quality))
    return {
        "usable_after": after(seconds.good > 0.0),
        "fine_after": after(seconds.is_fine),
        "suspects": int(lost[0]),
        "not_available": int(lost[1]),
    }


def _checked(bus: FrameColumns, loaded: LoadedConfig, base: Base) -> str:
    """The worst that `check` says of the first minutes of driving, and what lies before them."""
    check = Check(loaded)
    until = CHECKED_S + int(np.argmax(base.moving()))
    check.feed(bus.take(slice(0, int(np.searchsorted(bus.t, until)))))
    found = {finding.level for finding in check.findings()}
    return next(level for level in LEVELS if level in found or level == "ok")
