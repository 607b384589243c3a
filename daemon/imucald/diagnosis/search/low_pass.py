"""Decide whether a late signal has a delay or a low-pass filter, by comparing the likelihoods of
delay and filter.

A delay x has the phase w x and the gain 1. Filters of first and second order (Butterworth) have the
same delay T well below their cut-off frequency; their responses differ from it by (w T)^2/2 and (w
T)^3/6. A found delay is therefore compared with filters of about the same delay. The model with the
delay gets a further column: the difference between filter and delay, with a factor of 0 (delay) or
about 1 (filter). All delays are free in both cases, so only the shape of the response decides. An
alternative is ruled out if its log-likelihood is lower by two standard errors and by the nats that
name a cause, and if the difference in shape exceeds the error of the equations. A delay of the
speed is never ruled out: the speed unit counts pulses, averages and holds values, which has the
shape of a filter (`css_canmod_164`, delayed artificially by 0.2 s).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from imucald.core.arrays import Array
from imucald.diagnosis.causes import BY_NAME, CAUSES
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.added import level_of, rows_with, whitened
from imucald.diagnosis.fit.blocks import late_signals
from imucald.diagnosis.fit.score import REACH, Problem, held_out, sum_and_se, without_best
from imucald.diagnosis.search.state import State
from imucald.diagnosis.search.trials import ALIKE_SE, Trial
from imucald.drive.equations import Complex
from imucald.drive.single_track import frequencies
from imucald.mount.mount_words import SD_95

LONGER = tuple(2.0 ** (k / 3.0) for k in range(-1, 4))
"""Tested time constants, relative to the found delay. Near its cut-off frequency, a filter's delay
is smaller than its time constant."""
SHARE = 2.0**-0.5, 2.0**0.5
"""Range of the factor on a filter's column. The effect grows with the cube (or the square) of the
time constant, so this range covers all time constants between two tested values."""


def delay_or_low_pass(state: State) -> None:
    """Add a low-pass filter as an alternative to each named delay, or replace the delay by the
    filter."""
    for cause in CAUSES:
        for trial in [t for t in state.named if t.hypothesis.name == cause.form_of]:
            late = _late(state, trial)
            if late:
                _compare(state, trial, cause.name, late)


def low_passes(state: State) -> dict[str, float]:
    """Return, by key of a delay, the part of the delay [s] that is a low-pass filter according to
    the named causes."""
    keys = [
        k for t in state.named if BY_NAME[t.hypothesis.name].form_of for k in t.hypothesis.moved
    ]
    return {k: state.changes[k] for k in keys if state.changes.get(k, 0.0) > 0.0}


def _late(state: State, trial: Trial) -> dict[str, float]:
    """Return the delays of signals [s] that result from a trial."""
    own = {k: state.changes[k] for k in trial.hypothesis.moved if state.changes.get(k)}
    drive = state.drives[0]
    return {
        signal: abs(x)
        for key, x in own.items()
        for signal in late_signals(key, x)
        if signal != "wheel_speeds" and drive.has(signal)
    }


@dataclass(frozen=True)
class _Filter:
    """Comparison of one filter with a delay."""

    more: Array
    """Nats (B,) by which the filter explains each block better, from fits that did not use the fold
    of the block."""
    is_apart: bool
    """True if the difference between filter and delay exceeds the error of the equations in a
    delay."""


def _compare(state: State, trial: Trial, name: str, late: Mapping[str, float]) -> None:
    filters = _filters(state, state.evaluated(), late)
    best = max(filters, key=lambda x: float(x.more.sum()))
    more, (ahead, se) = best.more, sum_and_se(best.more)
    least = max(ALIKE_SE * se, trial.needed)
    if ahead < -least and all(x.is_apart for x in filters):
        return
    other = replace(
        trial, hypothesis=replace(trial.hypothesis, name=name), gain=trial.gain + more,
        shown=without_best(trial.gain + more),
    )  # fmt: skip
    delay = trial.hypothesis.name
    if ahead > least and best.is_apart and "speed" not in late:
        state.named[[t is trial for t in state.named].index(True)] = other
        state.rivals[name] = state.rivals.pop(delay, [])
    else:
        state.rivals[delay] = [*state.rivals.get(delay, []), other]


def _filters(state: State, problem: Problem, late: Mapping[str, float]) -> list[_Filter]:
    """Compare each filter with the delay."""
    table = problem.table
    x = np.tile(problem.fit(), (sum(f.blocks for f in state.forwards), 1))
    parts = rows_with(state.forwards, state.model, table, lambda f: _filtered(f, late))
    if "speed" in late:
        for _, columns in parts.get("speed", ()):
            columns[:] = 0.0  # wheel speeds and speed come from one unit
    rows = [a for n, a in whitened(parts, x).items() if n in table.by_equation]
    gram = np.asarray(sum(np.swapaxes(a, 1, 2) @ a for a in rows))[table.number]
    own = list(range(1 + len(table.keys)))
    low, high = problem.low.copy(), problem.high.copy()
    index = [j for j, key in enumerate(table.keys) if key.endswith("delay_s")]
    low[index], high[index] = REACH * table.plausible[index].T
    wide = np.append(low, SHARE[0]), np.append(high, SHARE[1])

    def loss(some: list[int], low: Array, high: Array) -> Array:
        """Return the held-out losses (B,) with these columns."""
        return held_out(Problem(replace(table, gram=gram[:, some][:, :, some]), low, high))

    delayed, total = loss(own, low, high), gram.sum(axis=0)
    delays = [1 + j for j in index if table.keys[j].partition(".")[0] in late]
    inner = total[np.ix_(delays, delays)]
    errs = SD_95 * float(table.model_error[index].max())
    made = []
    for e in range(len(own), gram.shape[1]):
        c = total[delays, e]
        added = total[e, e] - c @ np.linalg.lstsq(inner, c, rcond=None)[0]
        is_apart = bool(added > errs**2 * inner.sum())
        made.append(_Filter(delayed - loss([*own, e], *wide), is_apart))
    return made


def _filtered(f: Forward, late: Mapping[str, float]) -> Iterator[tuple[dict[str, Array], float]]:
    """Yield, for each filter, its effect on signals that are read with the equal delay instead."""
    level = {signal: level_of(f, signal) for signal in late}
    s = frequencies(len(f.t))
    for order in (1, 2):
        for longer in LONGER:
            yield {n: _more(y, s, late[n], longer * late[n], order) for n, y in level.items()}, 1.0


def _more(y: Array, s: Complex, delay_s: float, seconds: float, order: int) -> Array:
    """Return the difference between a filter with time constant `seconds` and the plain delay
    `delay_s` for a signal y, (N,) or (N, 3). The signal is mirrored at its end, so that it has no
    jump from the end to the start."""
    a = s * seconds
    response = np.exp(s * delay_s) / (1.0 + a + (0.5 * a * a if order == 2 else 0.0)) - 1.0
    spectrum = np.fft.rfft(np.concatenate([y, y[::-1]]), axis=0)
    return np.asarray(np.fft.irfft((spectrum.T * response).T, 2 * len(y), axis=0)[: len(y)])
