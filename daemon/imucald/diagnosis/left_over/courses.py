"""Find zero errors, gains and delays that change from segment to segment of a drive.

Each segment alone gives an estimate of a parameter. If the estimates differ by more than their
errors and the tolerances of a correct model file, there is an effect that no parameter describes.
Each row of `COURSES` tests one pattern of differences: a linear map of the segments' scores, and
the size of its result. The chance of each result is computed from permutations of the same
segments.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.stats import chi2, norm
from scipy.stats import t as student

from imucald.core.arrays import Array
from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.chance import Answer
from imucald.diagnosis.fit.score import one_in_fifteen
from imucald.diagnosis.left_over.remains import LEAST_SEGMENTS, Remains
from imucald.diagnosis.outcome import SEEN_SHARE, first_signal
from imucald.diagnosis.search.trials import hypotheses
from imucald.mount.mount_words import SD_95

ASKED = ("bias", "scale", "offset")
"""Parts of the tested keys, which exist for every sensor. Delays other than the delay of the speed
are not tested, nor are the lever arm and the springs. These parameters absorb errors of the tyre
equations, which depend on the speed in every drive."""
DELAY = "speed.delay_s"
"""Delay that is tested for a step. A linear growth of the delay (two clocks) is a cause of the
catalogue."""
LAGS = (1, 2, 3)
"""Numbers of neighbouring segments, half a minute to a minute and a half: longer than a manoeuvre.
The duration of an effect is not known, so each number is tested."""
LEAST_SIDE = 3
"""Smallest number of segments before and after a tested moment."""
ORDERS, KEPT, MOST_LEVELS = 1000, 100, 8
"""Number of permutations of the segments at each level, number of permutations that must reach the
next level, and largest number of levels. Chances down to 1e-8 can then be computed."""
EVENLY, EITHER_SIDE = 3.0**-0.5, 2.0
"""Change that a correct model file may cause, in tolerances: the standard deviation of values
within a tolerance, and the distance between the ends of a tolerance."""


@dataclass(frozen=True)
class Scores:
    """A parameter's evidence by segment (B,): information h, and scores s relative to the fit. The
    sum of the scores is zero. known: (B, k) patterns over the segments that the fit already
    contains."""

    h: Array
    s: Array
    known: Array
    table: Table


@dataclass(frozen=True)
class Course:
    """One pattern of change, for one parameter.

    image: linear map (B, F) of the scores. size_of: function from results (N, F) to sizes (N,); the
    largest size is the least probable. value: amount of the change, in the unit of the parameter.
    rare: function that returns the chance that noise causes an amount beyond a limit.
    """

    image: Array
    size_of: Callable[[Array], Array]
    value: float
    rare: Callable[[float], float]
    text: str


def by_course(left: Remains) -> Iterator[Answer]:
    """Yield one answer for each parameter and row of `COURSES`."""
    table, z, drift = left.table, left.z, left.drift
    if table.blocks < LEAST_SEGMENTS:
        return
    for j, key in enumerate(table.keys):
        h = table.gram[:, j + 1, j + 1]
        if not (h.any() and (key == DELAY or any(part in ASKED for part in key.split(".")))):
            continue
        s = np.einsum("bi,bi->b", table.gram[:, j + 1], z)
        known = [np.ones(len(h))]
        if key == DELAY:
            known.append(table.start_s + table.seconds * table.blocks * table.drive)
        if drift is not None and drift.pattern is not None and key in drift.keys:
            known.append(drift.pattern)
        scores = Scores(h, s - h * (s.sum() / h.sum()), np.column_stack(known), table)
        may = float(table.tolerance[j] + SD_95 * table.model_error[j])
        for find, sides in COURSES if key != DELAY else COURSES[-1:]:
            found = find(scores)
            if found is None:
                continue
            text = f"{key} {found.text.format(amount(key, found.value))}"
            p, rare = _share_of_orders(scores.s, found.image, found.size_of), found.rare
            yield _answer(table, key, p, found.value, sides * may, text, rare(sides * may))


def _answer(
    table: Table, key: str, p: float, size: float, least: float, text: str, rare: float = 1.0
) -> Answer:
    text = f"{text} ({size / least:.1f} times the limit of a correct file)"
    return Answer(first_signal(table, [key]), size, least, p, text, key, rare=min(rare, 1.0))


def _near(x: Scores, lag: int) -> Course:
    """Test whether neighbouring segments have a common difference from the whole drive.

    For scores s_b with information h_b, the expectation of s_b s_(b+l) is h_b h_(b+l) sigma^2.
    sigma is the standard deviation of the parameter's wander.
    """
    together = partial(_shared, lag=lag)
    info = max(float(together(x.h)), 1e-300)
    # For random permutations the sum scatters about zero by this much.
    scatter = max(np.sqrt(lag / len(x.s)) * float(x.s @ x.s), 1e-300)
    return Course(
        np.eye(len(x.s)), together, float(np.sqrt(max(float(together(x.s)), 0.0) / info)),
        lambda limit: float(student.sf(limit**2 * info / scatter, len(x.s) - 1)),
        "changes by {} from piece to piece of the drive",
    )  # fmt: skip


def _step(x: Scores) -> Course | None:
    """Test whether the parameter has another value from some moment on. The known patterns are
    fitted too."""
    B = len(x.s)
    after = np.arange(B)[:, None] >= np.arange(LEAST_SIDE, B - LEAST_SIDE + 1)
    weighted = (x.known * x.h[:, None]).T
    fitted = np.linalg.lstsq(weighted @ x.known, weighted @ after, rcond=None)[0]
    by: Array = after - x.known @ fitted
    info = x.h @ by**2
    there = np.flatnonzero(info > 1e-6 * (x.h @ after))
    if not len(there):
        return None
    image, info = by[:, there] / np.sqrt(info[there]), info[there]
    z = np.abs(x.s @ image)
    best = int(z.argmax())
    segment, table = LEAST_SIDE + int(there[best]), x.table
    moment = f"{table.start_s[segment]:.0f} s"
    if table.drive.any():
        moment += f" of drive {int(table.drive[segment]) + 1}"
    noise = np.sqrt(max(float(x.s @ x.s) / B, 1e-300)) * np.linalg.norm(image, axis=0)
    return Course(
        image, lambda z: np.asarray(np.abs(z).max(axis=1)), float(z[best] / np.sqrt(info[best])),
        lambda limit: float(2.0 * norm.sf(limit * np.sqrt(info) / noise).sum()),
        f"differs by {{}} from {moment} on",
    )  # fmt: skip


COURSES: tuple[tuple[Callable[[Scores], Course | None], float], ...] = (
    *((partial(_near, lag=lag), EVENLY) for lag in LAGS), (_step, EITHER_SIDE),
)  # fmt: skip
"""Each pattern with the number of tolerances that a correct model file may cause."""


def _shared(s: Array, lag: int) -> Array:
    """Return the sum of the products of neighbours up to a lag: (..., B) to (...)."""
    return np.asarray(
        sum(np.einsum("...b,...b->...", s[..., n:], s[..., :-n]) for n in range(1, lag + 1))
    )


def _share_of_orders(s: Array, image: Array, size_of: Callable[[Array], Array]) -> float:
    """Return the share of all permutations of s (B,) whose size is at least the size of the actual
    order. image: (B, F) linear map of s. size_of: function from the result (N, F) to sizes (N,).

    The method is subset simulation (Au and Beck 2001). Levels are set so that a tenth of the
    permutations at one level reach the next level. New permutations are made from these by
    exchanging two places. An exchange that would fall below the level is rejected. A share of 1e-6
    therefore needs six times as many draws as a share of a tenth, and not 1e5 times as many.
    """
    rng, rows, share = np.random.default_rng(0), np.arange(ORDERS), 1.0
    x = s[np.argsort(rng.random((ORDERS, len(s))), axis=1)]
    z = x @ image
    got, size = size_of((s @ image)[None])[0], size_of(z)
    for _ in range(MOST_LEVELS):
        level = np.sort(size)[-KEPT]
        if level >= got:
            break
        reach = np.flatnonzero(size >= level)
        share *= len(reach) / ORDERS
        drawn = rng.choice(reach, ORDERS)
        x, z, size = x[drawn], z[drawn], size[drawn]
        for _ in range(len(s)):
            i, k = rng.integers(len(s), size=(2, ORDERS))
            by = x[rows, k] - x[rows, i]
            other = z + by[:, None] * (image[i] - image[k])
            new = size_of(other)
            stays = new < level
            z, size = np.where(stays[:, None], z, other), np.where(stays, size, new)
            by[stays] = 0.0
            x[rows, i] += by
            x[rows, k] -= by
    return share * float((1 + np.sum(size >= got)) / (ORDERS + 1))


def gains_apart(left: Remains) -> Iterator[Answer]:
    """Yield answers about gains whose values in single segments differ by more than their own
    errors, in any order (random effects). Zero errors are not tested, because the zero error of a
    single segment absorbs the effect of its road."""
    table, z = left.table, left.z
    for h in hypotheses(table, left.state.model, []):
        if h.pattern is not None or any(key.split(".")[1] != "scale" for key in h.keys):
            continue
        for k, (key, error) in enumerate(zip(h.keys, left.problem.model_error(h), strict=True)):
            x, variance = _own_values(table, h.along[k], z)
            if len(x) < LEAST_SEGMENTS:
                continue
            limit = EVENLY * (table.tolerance[table.keys.index(key)] + SD_95 * error)
            size, p = _scatter(x, variance, limit)
            text = f"{key} changes from segment to segment by {amount(key, size)}"
            yield _answer(table, key, p, size, limit, text)


def _own_values(table: Table, along: Mapping[str, float], z: Array) -> tuple[Array, Array]:
    """Return the difference of each segment from the fit along a direction, and its variance. The
    variance comes from the segment's own noise in each equation that shows the direction."""
    d, energy = table.direction(along), table.energy(along)
    total = sum(float(e.sum()) for e in energy.values())
    score, information, spread = np.zeros((3, table.blocks))
    for name, gram in table.by_equation.items():
        h = energy[name]
        if h.sum() <= SEEN_SHARE * total:
            continue
        s = np.einsum("i,bij,bj->b", d, gram, z)
        power = np.einsum("bi,bij,bj->b", z, gram, z)
        power = power - np.divide(s**2, h, out=np.zeros_like(h), where=h > 0.0)
        count = int(2.0 * table.seconds * table.top_hz[name])
        score, information = score + s, information + h
        # Two tilts and the value itself are fitted to each segment, which reduces its noise.
        spread = spread + h * np.maximum(power, 0.0) / max(count - 3, 1)
    there = (information > 0.0) & (spread > 0.0)
    x = score[there] / information[there]
    return x, spread[there] / information[there] ** 2


def _scatter(x: Array, variance: Array, may: float) -> tuple[float, float]:
    """Return the standard deviation between segments beyond their errors (DerSimonian and Laird
    1986), and the chance of their scatter (Cochran 1954) if the true values scatter by `may`. One
    segment in fifteen is left out, so that it cannot decide alone."""
    far = (x - np.median(x)) ** 2 / (variance + may**2)
    kept = np.argsort(far)[: len(x) - one_in_fifteen(len(x))]
    x, variance = x[kept], variance[kept]
    w = 1.0 / variance
    excess = float(w @ (x - w @ x / w.sum()) ** 2) - (len(x) - 1)
    size = float(np.sqrt(max(excess, 0.0) / (w.sum() - w @ w / w.sum())))
    w = 1.0 / (variance + may**2)
    power = float(w @ (x - w @ x / w.sum()) ** 2)
    return size, float(chi2.sf(power, len(x) - 1))


def amount(key: str, x: float) -> str:
    """Return a number of the model file as a text in a familiar unit."""
    unit = PARAMETERS[key].unit
    if unit.startswith("rad"):
        x, unit = float(np.degrees(x)), f"deg{unit.removeprefix('rad')}"
    elif unit in ("", "1"):
        x, unit = 100.0 * x, "%"
    return f"{x:.2g} {unit}"
