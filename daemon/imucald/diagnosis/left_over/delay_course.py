"""Test whether the speed's delay follows the time stamps, or steps, during a drive.

A model file states one delay, or one that grows linearly. A cyclic sender gives cyclic stamps. If
stamps leave the cycle, either the sender left it or the stamping clock is wrong. The forward force
separates the two cases: its integral is a speed without these stamps, and compared with it a wrong
stamp shows as a delay of the same size. Speeds are compared as speeds. The column of a delay is the
force, so it contains none of the noise of the comparison (see `forward`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucald.core.arrays import Array
from imucald.core.samples import GRAVITY
from imucald.diagnosis.cause_keys import Changes
from imucald.diagnosis.equations import kinematics
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.equations.motion import VehicleMotion
from imucald.diagnosis.equations.single_track import SLOW_MPS
from imucald.diagnosis.fit.chance import Question, chance_of_both
from imucald.diagnosis.fit.sandwich import scatters
from imucald.diagnosis.fit.score import Problem
from imucald.diagnosis.left_over.stability import EITHER_SIDE, LEAST_SIDE, amount
from imucald.diagnosis.result import WANDERS, Structure
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import STEP_S, Mask
from imucald.mount.mount_words import SD_95

DELAY = "speed.delay_s"
PAUSE_S = 10.0
"""After a longer gap a sender starts again at any phase of its cycle."""
QUICK_S = 30.0
"""Stamps of requested frames drift away slowly; changes faster than this are tested separately."""
MEMORY = 0.5
"""Correlation from one sample's error to the next: between white noise of steps and integrated
noise. Standard deviations come from the scatter between segments and do not depend on it."""
LEAST_SAMPLES, LEAST_BLOCKS, LEAST_COUNT = 10, 6, 3.0
"""Fewest samples in a segment, fewest segments, and fewest segments that carry the information."""
FURTHEST_S, EDGE_S = 1.0, 0.5
"""Largest delay beyond that of the model that is followed, and the length at both ends of a segment
that is then not used."""
STEPS = 3
MANY_S = 1000.0
ENDS = (0.05, 0.95)


@dataclass(frozen=True)
class Pieces:
    """One drive with a model file, ready for the comparison at any delay."""

    at: Array
    """(N,) times of the speed's samples by their stamps and the model."""
    shown: Array
    """(N,) [m/s]"""
    usable: Mask
    growth: Array
    """(N,) time from the drive's middle [1000 s]."""
    stamps: Array
    """(N, 2) delay of the stamps against a constant cycle [s]: in total, and its fast part."""
    edges: Array
    """(B, n + 1) edges of the grid's steps [s]."""
    sums: Array
    """(3, B, n + 1) integrated forward force: without a tilt, and the effect of each tilt
    component."""


@dataclass(frozen=True)
class Course:
    """Evidence of the segments on delays near a given delay. Each segment is whitened, and its
    unknown speed and tilt are projected out."""

    y: list[Array]
    """(n,) measured speed minus integrated force, over its own standard deviation."""
    even: list[Array]
    """(n, 3) derivatives by a delay, by its linear growth, and by its speed-dependent part."""
    asked: list[Array]
    """(n,) derivative by a delay that follows a pattern."""
    start_s: list[float]
    drive: list[int]


@dataclass(frozen=True)
class Followed:
    """The amount by which a delay follows a pattern."""

    value: float
    sigma: float
    """Size of the amount in standard deviations."""
    p: float
    even: Array
    """(3,) the linear parts fitted with it."""


def off_cycle(t: Array) -> Array:
    """(N,) delay of stamps against a constant cycle [s]. t: (N,) stamps [s], ascending.

    Steps are counted in whole cycles, so a lost frame does not delay the next one.
    """
    steps = np.diff(t)
    if len(steps) < LEAST_SAMPLES:
        return np.zeros(len(t))
    cycle = float(np.median(steps))
    late = steps - cycle * np.maximum(np.round(steps / cycle), 1.0)
    late[steps > PAUSE_S] = 0.0
    total = np.concatenate([[0.0], np.cumsum(late)])
    return _beside_a_line(total, t)


def _beside_a_line(x: Array, t: Array) -> Array:
    line = np.column_stack([np.ones(len(t)), t - t.mean()])
    return np.asarray(x - line @ np.linalg.lstsq(line, x, rcond=None)[0])


def _quick(x: Array, t: Array) -> Array:
    """x (N,) minus its running mean over `QUICK_S`."""
    n = max(1, round(QUICK_S / float(np.median(np.diff(t)))))
    ones = np.ones(n)
    return np.asarray(x - np.convolve(x, ones, "same") / np.convolve(np.ones(len(x)), ones, "same"))


# what segments say -------------------------------------------------------------------------------


def pieces_of(f: Forward, changes: Changes) -> Pieces:
    """Prepare a drive with a model file. changes: of the model, at the best fit."""
    m, drive = VehicleMotion(f, changes, False), f.drive
    shown = drive.knots.values / (1.0 + f.model.speed.scale + changes.get("speed.scale", 0.0))
    usable = drive.channels["speed"].present(drive.knots.t) & (np.abs(shown) > SLOW_MPS)
    for name in ("accel", "gyro"):
        usable &= drive.channels[name].present(m.knots)
    growth = (m.knots - f.middle_s) / MANY_S
    stamps = drive.channels["speed"].t
    late = off_cycle(stamps)
    by_stamps = [np.interp(drive.knots.t, stamps, x) for x in (late, _quick(late, stamps))]
    first = f.t.reshape(f.blocks, f.rows)[:, :1]
    edges = first + STEP_S * (np.arange(f.rows + 1) - 0.5)
    sums = _summed(f, m)
    return Pieces(m.knots, shown, usable, growth, np.column_stack(by_stamps), edges, sums)


def _summed(f: Forward, m: VehicleMotion) -> Array:
    p, q, r = m.rate or [np.zeros(len(f.t))] * 3
    by_blocks, turned = kinematics.turned(r, f.rows)
    along = kinematics.along(m.force[0], m.r, m.v_y, kinematics.carried(p, q, by_blocks))
    parts = [along, GRAVITY * turned.real, GRAVITY * turned.imag]
    areas = [np.cumsum(x.reshape(f.blocks, f.rows), axis=1) * STEP_S for x in parts]
    return np.stack([np.pad(x, ((0, 0), (1, 0))) for x in areas])


def course_of(
    drives: Sequence[Pieces], pattern: Sequence[Array], value: float, even: Array
) -> Course:
    """Course about the delay given by `even` (3,) plus `value` times a pattern, (N,) [s] for each
    drive."""
    made = Course([], [], [], [], [])
    for i, (d, x) in enumerate(zip(drives, pattern, strict=True)):
        parts = np.column_stack([np.ones(len(d.at)), d.growth, d.shown])
        late = np.clip(parts @ even + value * x, -FURTHEST_S, FURTHEST_S)
        true = d.at - late
        for b, edges in enumerate(d.edges):
            inside = (true >= edges[0] + EDGE_S) & (true <= edges[-1] - EDGE_S)
            k = np.flatnonzero(inside & d.usable)
            if len(k) < LEAST_SAMPLES:
                continue
            rows = _of_segment(true[k], d.shown[k], parts[k], x[k], edges, d.sums[:, b])
            if rows is not None:
                made.y.append(rows[:, 0])
                made.even.append(rows[:, 1:4])
                made.asked.append(rows[:, 4])
                made.start_s.append(float(edges[0]))
                made.drive.append(i)
    return made


def _of_segment(
    at: Array, shown: Array, parts: Array, x: Array, edges: Array, sums: Array
) -> Array | None:
    """(n - 1, 5) whitened columns: the comparison, three linear delays, the delay by the pattern
    x."""
    read = np.column_stack([np.interp(at, edges, s) for s in sums])
    free = np.column_stack([np.ones(len(at)), read[:, 1:]])
    y = shown - read[:, 0]
    tilt = np.linalg.lstsq(free, y, rcond=None)[0]
    speed = sums[0] + tilt[1:] @ sums[1:]
    delay = _between(at, np.full(len(at), STEP_S), edges, speed) / STEP_S
    rows = np.column_stack([y, delay[:, None] * parts, _between(at, x, edges, speed)])
    rows, free = (z[1:] - MEMORY * z[:-1] for z in (rows, free))
    rows = rows - free @ np.linalg.lstsq(free, rows, rcond=None)[0]
    known = rows[:, [1, 4]]
    left = rows[:, 0] - known @ np.linalg.lstsq(known, rows[:, 0], rcond=None)[0]
    dof = len(rows) - free.shape[1] - 2
    noise = float(np.sqrt(left @ left / dof)) if dof > 0 else 0.0
    return np.asarray(rows / noise) if noise > 0.0 else None


def _between(at: Array, late: Array, edges: Array, speed: Array) -> Array:
    """(n,) effect of a delay `late` [s] about each time on a speed. The force is integrated over
    the whole delay, since it changes meanwhile."""
    half = 0.5 * np.clip(late, -2.0 * EDGE_S, 2.0 * EDGE_S)
    return np.asarray(np.interp(at - half, edges, speed) - np.interp(at + half, edges, speed))


# questions ---------------------------------------------------------------------------------------


def delay_course(problem: Problem, state: State) -> list[Question]:
    """Test whether the delay of the speed follows its stamps, or changes at some moment.

    At most three questions, which share an error rate of their own: stamps that leave their cycle
    by more than a delay's tolerance need an explanation in any case.
    """
    if not all(f.has_gravity for f in state.forwards) or DELAY not in problem.table.keys:
        return []  # the road's slope stays in the force and would be integrated
    changes = problem.fitted_changes()
    drives = [pieces_of(f, changes) for f in state.forwards]
    j = problem.table.keys.index(DELAY)
    may = float(problem.table.tolerance[j] + SD_95 * problem.table.model_error[j])
    return [*_by_stamps(drives, EITHER_SIDE * may), *stepping(drives, EITHER_SIDE * may)]


def _by_stamps(drives: Sequence[Pieces], may: float) -> list[Question]:
    """One question about the total delay and one about its fast part; none if the stamps stay
    within a delay's tolerance."""
    made = []
    for i, how in enumerate(("", " quickly")):
        pattern = [d.stamps[:, i] for d in drives]
        seen = np.concatenate([x[d.usable] for d, x in zip(drives, pattern, strict=True)])
        spread = float(np.subtract(*np.quantile(seen, ENDS[::-1]))) if len(seen) else 0.0
        found = settled(drives, pattern) if spread > may else None
        if found is None:
            continue
        text = (
            f"its time stamps deviate{how} from an even cycle by {amount(DELAY, spread)} (5th "
            "to 95th percentile), and its delay compared with the accelerometer follows "
            f"them: {found.value:.2g} s per second, {found.sigma:.1f} σ"
        )
        made.append(_question(found, abs(found.value) * spread / may, text))
    return made


def stepping(drives: Sequence[Pieces], may: float) -> list[Question]:
    """The most likely of all steps (sup-Wald; Andrews 1993), its chance corrected for the number of
    moments."""
    course = course_of(drives, [np.zeros(len(d.at)) for d in drives], 0.0, np.zeros(3))
    moments = range(LEAST_SIDE, len(course.y) - LEAST_SIDE + 1)
    best: tuple[int, Followed] | None = None
    for k in moments:
        after = [e[:, 0] * float(b >= k) for b, e in enumerate(course.even)]
        found = followed(course, after, 0.0)
        if found is not None and (best is None or found.p < best[1].p):
            best = k, found
    if best is None:
        return []
    k, found = best
    drive, start = course.drive[k], course.start_s[k]
    text = (
        f"its delay changes by {amount(DELAY, found.value)} at {start:.0f} s"
        f"{f' of drive {drive + 1}' if max(course.drive) > 0 else ''}, {found.sigma:.1f} σ "
        f"({abs(found.value) / may:.1f} times the limit of a correct file)"
    )
    shared = replace(found, p=min(1.0, found.p * len(moments)))
    return [_question(shared, abs(found.value) / may, text)]


def _question(found: Followed, size: float, text: str) -> Question:
    """size: over the allowed size; the value minus one standard deviation counts."""
    is_large = size * (1.0 - 1.0 / max(found.sigma, 1.0)) > 1.0
    return Question(found.p, is_large, Structure("speed", WANDERS, size, text, DELAY))


def settled(drives: Sequence[Pieces], pattern: Sequence[Array]) -> Followed | None:
    """Find how much the delay follows a pattern, with repeated linearisation at the new delay: a
    column is a derivative, and half a second later the force is different. None if too little is
    known."""
    found = Followed(0.0, 0.0, 1.0, np.zeros(3))
    for _ in range(STEPS):
        course = course_of(drives, pattern, found.value, found.even)
        if len(course.y) < LEAST_BLOCKS:
            return None
        again = followed(course, course.asked, found.value)
        if again is None:
            return None
        found = replace(again, even=found.even + again.even)
    return found


def followed(course: Course, column: list[Array], before: float) -> Followed | None:
    """Estimate a column's value together with a linear delay. before: its value so far, which is
    added.

    The chance of the value comes from the scatter between segments (sandwich) and from the noise of
    all rows. The degrees of freedom are the effective number of segments with information on it
    (Carter, Schnepel and Steigerwald 2017).
    """
    if not course.y:
        return None
    E, y, x = (np.concatenate(each) for each in (course.even, course.y, column))
    size = np.maximum(np.linalg.norm(E, axis=0), 1e-12)
    Q, R = np.linalg.qr(E / size)
    both = np.column_stack([y, x])
    both = both - Q @ (Q.T @ both)
    first = np.cumsum([0, *(len(each) for each in course.y[:-1])])
    u = np.add.reduceat(both[:, 0] * both[:, 1], first)
    h = np.add.reduceat(both[:, 1] ** 2, first)
    information = float(h.sum())
    count = information**2 / max(float(h @ h), 1e-300)
    if information <= 0.0 or count < LEAST_COUNT:
        return None
    step = float(u.sum()) / information
    left = (u - h * step).reshape(-1, 1)
    scatter = max(float(s[0, 0]) for s in scatters(left, 1))
    value = before + step
    by_blocks = abs(value) * information / float(np.sqrt(max(scatter, 1e-300)))
    by_rows = abs(value) * float(np.sqrt(information))
    p = chance_of_both(by_blocks, count - 1.0, by_rows)
    even = np.linalg.lstsq(R, Q.T @ (y - step * x), rcond=None)[0] / size
    return Followed(value, min(by_blocks, by_rows), p, even)
