"""Improvement of the prediction by the written model file alone, without a further fit.

`rms_after` is the residual of these drives with the written model file. The improvement is measured
on data outside the fit: the found parameters are fitted without one fold, and predict this fold.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from imucald.core.arrays import Array
from imucald.diagnosis.equations.forward import UNITS, Forward
from imucald.diagnosis.fit.blocks import TILTED, Table
from imucald.diagnosis.fit.score import Problem, fitted_by_fold, losses, sum_and_se
from imucald.diagnosis.result import Gain, SignalGain

Z95 = 1.959964


def gain_of(
    before: Table,
    after: Problem,
    whole: Table,
    free: Sequence[str],
    forwards: Sequence[Forward],
    held_out: Array | None = None,
) -> tuple[Gain, dict[str, SignalGain]]:
    """Compare the stated model file with the written model file.

    before, after: tables with the stated and with the written model file. whole: `after`, also with
    the equations that no fit uses. held_out: (B,) nats of causes that are not in `free`, from fits
    that did not use the block; None without such causes."""
    table = after.table
    # Only the found parameters differ from the written file.
    x = fitted_by_fold(after) * np.isin(table.keys, free)
    signals, worse = {}, []
    left = _left(forwards)
    for name in table.plain:
        if name not in before.plain or before.rms(name) == 0.0:
            continue
        one = SignalGain(
            before.rms(name), table.rms(name), _floor(whole, name), UNITS[name],
            before.rms(name, band=0), table.rms(name, band=0), left.get(name, ""),
            table.rms(name, x),
        )  # fmt: skip
        signals[name] = one
        if _is_worse(before, table, name, x):
            worse.append(name)
    was_fitted = bool(free) or held_out is not None
    if not free and held_out is not None:
        return summed(held_out, worse), signals
    if not free or before.blocks != table.blocks:
        return Gain(0.0, (0.0, 0.0), tuple(worse if was_fitted else ()), was_fitted), signals
    d = _weighted_losses(before, table) - losses(table.gram, x)
    return summed(d, worse), signals


def summed(gain: Array, worse: Sequence[str] = ()) -> Gain:
    """Return the sum of the nats of all blocks (B,), with the confidence interval from the scatter
    of the blocks."""
    total, se = sum_and_se(gain)
    return Gain(total, (total - Z95 * se, total + Z95 * se), tuple(worse))


def _weighted_losses(before: Table, after: Table) -> Array:
    """Return the losses of the stated model with the weights of the written model, scaled by
    equation."""
    made = np.zeros(before.blocks)
    for name, gram in after.by_equation.items():
        power = after.plain[name][:, :, 0, 0].sum(axis=1)
        stated = before.plain[name][:, :, 0, 0].sum(axis=1)
        weight = np.divide(gram[:, 0, 0], power, out=np.zeros_like(power), where=power > 0.0)
        made += 0.5 * weight * stated
    return made


def _is_worse(before: Table, after: Table, name: str, x: Array) -> bool:
    """True if the residual of an equation is larger with the written file: by two standard errors
    of the difference over blocks, and by more than 1 %."""
    new = 2.0 * losses(after.plain[name].sum(axis=1), x)
    old = before.plain[name][:, :, 0, 0].sum(axis=1)
    if len(new) != len(old):
        return False
    excess, se = sum_and_se(new - old)
    return bool(excess > 2.0 * se and excess > 0.02 * old.sum())


def _floor(table: Table, name: str) -> float:
    """Return the rms residual after a fit of all parameters. The result is at most the present rms
    residual."""
    total = table.gram.sum(axis=0)
    wide = np.abs(table.plausible).max(axis=1)
    x = np.linalg.solve(total[1:, 1:] + np.diag(1.0 / wide**2), total[1:, 0])
    return min(table.rms(name, x), table.rms(name))


def _left(forwards: Sequence[Forward]) -> Mapping[str, str]:
    """Return, by equation and in words, offset and drift of the residual that exceed the scatter of
    the blocks."""
    texts = {}
    f = max(forwards, key=lambda f: f.blocks)
    masks = f.usable()
    for name, residual in f.residuals({}).of.items():
        if name in TILTED:
            continue
        good = masks[name].mean(axis=1) > 0.5
        if good.sum() < 8:
            continue
        means = np.array([residual[b][masks[name][b]].mean() for b in np.flatnonzero(good)])
        t = np.flatnonzero(good) - np.flatnonzero(good).mean()
        scatter = float(np.std(np.diff(means)) / np.sqrt(2.0))
        slope = float(t @ means / (t @ t))
        parts = []
        # Slow changes of the road last over several blocks, so four blocks count as one. The limit
        # is three standard deviations.
        if abs(means.mean()) > 6.0 * scatter / np.sqrt(len(means)):
            parts.append(f"offset {means.mean():+.2g} {UNITS[name]}")
        if abs(slope) * np.sqrt(t @ t) > 6.0 * scatter:
            parts.append(f"drift {slope * len(means):+.2g} {UNITS[name]} over the drive")
        texts[name] = ", ".join(parts)
    return texts
