"""Columns of errors that are added to a signal, in addition to the catalogue's columns.

The catalogue's columns are derivatives with respect to parameters. Other errors, such as a gain
that depends on the speed or a low-pass filter, are arrays that are added to a signal. The column of
such an error is the resulting change of each equation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from imucald.core.arrays import Array
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.blocks import (
    Rows,
    Table,
    cosine,
    joined,
    rows_of,
    weighted,
    weights_of,
)
from imucald.model.model import VehicleModel

AddedRows = Sequence[tuple[Rows, Array]]
"""For one equation, a list over the drives: the rows, and the columns (B, K, E) of the added
errors."""
Added = Callable[[Forward], Iterable[tuple[Mapping[str, Array], float]]]
"""Function that returns pairs for a drive: the added error by signal, and its factor relative to
the unit of the column."""


def level_of(f: Forward, signal: str) -> Array:
    """Return the signal from which columns are made (`Forward.settle`): (N,), or (N, 3) along the
    vehicle's axes."""
    if signal == "accel" and f.reference is not None:
        # The effect on one g upright counts as a zero error.
        return np.asarray(f.reference.force * np.array([1.0, 1.0, 0.0]))
    if signal == "gyro" and f.reference is not None and f.reference.rate is not None:
        return f.reference.rate
    if signal == "speed":
        return np.asarray(np.interp(f.t, f.knots, f.drive.knots.values))
    return f.scalar(signal, {})


def rows_with(
    forwards: Sequence[Forward], model: VehicleModel, table: Table, added: Added
) -> dict[str, list[tuple[Rows, Array]]]:
    """Return rows and added columns by equation. table: table of these drives with this model file.
    The signals that the drives have read are deleted afterwards."""
    parts: dict[str, list[tuple[Rows, Array]]] = {}
    at = 0
    for f in forwards:
        known = {name: X[at : at + f.blocks] for name, X in table.columns.items()}
        at += f.blocks
        rows = rows_of(f, model, table.keys, table.top_hz, known)
        columns = _columns(f, rows, list(added(f)))
        f.forget()
        for name, r in rows.items():
            parts.setdefault(name, []).append((r, columns[name]))
    return parts


def _columns(
    f: Forward, rows: Mapping[str, Rows], added: Sequence[tuple[Mapping[str, Array], float]]
) -> dict[str, Array]:
    masks, base = f.usable(), f.residuals({}).of
    made = {n: np.zeros((*r.y.shape, len(added))) for n, r in rows.items()}
    for e, (own, step) in enumerate(added):
        moved = f.residuals({}, added=own).of
        for n, r in rows.items():
            if moved[n] is not base[n]:
                made[n][:, :, e] = cosine((moved[n] - base[n]) / step, masks[n], r.y.shape[1])
    return made


def whitened(parts: Mapping[str, AddedRows], x: Array) -> dict[str, Array]:
    """Return, by equation, the residual, the catalogue's columns and the added columns for all
    blocks (B, K, 1 + P + E). All columns are divided by the noise, and the effect of each block's
    tilt is removed. x: (B, P) parameter differences that fit each block."""
    rows = {n: joined([r for r, _ in own]) for n, own in parts.items()}
    columns = {n: np.concatenate([c for _, c in own]) for n, own in parts.items()}
    return weighted(rows, weights_of(rows, x), columns)
