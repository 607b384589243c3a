"""Residuals and columns of all drives as one table, with Gram matrices for each block.

Each equation of a block is cosine-transformed, up to the highest frequency of its slowest signal,
and divided by its own noise at each frequency. Then the tilt z0 is projected out (Frisch and
Waugh). For each block b, only the Gram matrix G_b = [y X]'[y X] is stored. All fits, folds and
intervals are computed from these matrices.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.fft import dct

from imucald.core.arrays import Array, Index
from imucald.diagnosis.cause_keys import model_error, plausible, tolerance
from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.box import box_fit
from imucald.diagnosis.signals import STEP_S, DriveSignals, Mask
from imucald.model.model import VehicleModel

BLOCK_S, SHORT_BLOCK_S = 30.0, 20.0
FEW_S = 600.0
"""Total duration of all drives below which the drives are divided into short blocks [s], because
intervals need several blocks."""
CARRIED = 0.4
"""Ratio of the highest frequency of a motion that a signal shows to the sample rate of the
signal."""
LEAST_SHARE = 0.6
"""Share of a block's rows that must be present."""
MOVING_MPS, MOVING_SHARE = 1.5, 0.15
"""Conditions for a block: in at least the share `MOVING_SHARE` of its time, the vehicle must be
faster than `MOVING_MPS`. A slower block contains no more information than a stop."""
SLOW_BAND_HZ = 0.2
SMOOTH = 7
"""Number of spectral coefficients over which the noise spectrum is averaged."""
PASSES = 3
MEDIAN_SQUARE = 0.455
"""Median of the square of a normal variable with variance 1."""


@dataclass(frozen=True)
class Equation:
    """What the fit and the tests have to know of an equation."""

    takes: tuple[str, ...]
    """Signals whose sample rate limits the frequency band. The first signal is measured."""
    zero: str = ""
    """Zero error whose tolerance is the smallest amplitude of an oscillation that is reported."""
    uses_speed: bool = False
    """True if the speed is used too, but does not limit the frequency band."""
    is_tilted: bool = False
    """True if the equation contains the tilt of a block."""
    top_hz: float = 1.0
    """Upper frequency limit [Hz]. It is low if the fast part comes from the road: in the upward
    force, and in the wheel speeds against the speed."""
    shaken_from_hz: float = np.inf
    """Lowest frequency [Hz] of the road's unevenness in the residual. Well below its resonances (1
    Hz and more; Rajamani, ch. 10), the body follows the road. The only lateral effect of the road
    is then the tilt of the body, and the gyroscope measures this tilt."""


EQUATIONS: Mapping[str, Equation] = {
    "accel_x": Equation(("accel", "gyro", "speed"), "accel.bias.x", is_tilted=True),
    "accel_y": Equation(("accel", "gyro", "yaw_rate"), "accel.bias.y", uses_speed=True,
                        is_tilted=True, shaken_from_hz=0.4),
    "accel_z": Equation(("accel", "gyro"), "accel.bias.z", top_hz=0.1, shaken_from_hz=0.0),
    "gyro_x": Equation(("gyro", "accel"), "gyro.bias.x", shaken_from_hz=0.0),
    "gyro_y": Equation(("gyro", "accel"), "gyro.bias.y", shaken_from_hz=0.0),
    "gyro_z": Equation(("gyro", "yaw_rate"), "gyro.bias.z"),
    "yaw_rate": Equation(("steering", "yaw_rate", "gyro"), "yaw_rate.offset", uses_speed=True),
    "lateral_accel": Equation(("lateral_accel", "accel"), "lateral_accel.offset",
                              shaken_from_hz=0.4),
    "longitudinal_accel": Equation(("longitudinal_accel", "accel"), "longitudinal_accel.offset"),
    "speed": Equation(("speed", "wheel_speeds"), top_hz=0.1),
}  # fmt: skip
TILTED = tuple(name for name, equation in EQUATIONS.items() if equation.is_tilted)
SENSED = tuple(dict.fromkeys(s for equation in EQUATIONS.values() for s in equation.takes))


def late_signals(key: str, x: float) -> list[str]:
    """Return the signals that may be low-pass filtered if a delay x [s] was found. If the delay is
    negative, the signal itself has no low-pass filter, but the signals compared with it may have
    one."""
    own = key.partition(".")[0]
    return [own] if x > 0.0 else [signal for signal in SENSED if signal != own]


@dataclass(frozen=True)
class Table:
    """The blocks of all drives, evaluated with one model file.

    keys: (P,) parameters. gram: (B, P+1, P+1) Gram matrices; the residual is the first column.
    by_equation: Gram matrices of each single equation. Times are stream times of the drive.
    """

    keys: tuple[str, ...]
    gram: Array
    by_equation: Mapping[str, Array]
    start_s: Array
    drive: Index
    moving: Array
    """Share (B,) of each block in motion."""
    tolerance: Array
    """Half widths (P,) of the tolerances."""
    model_error: Array
    """Standard deviations (P,) of the errors of the equations."""
    plausible: Array
    """Plausible ranges (P, 2)."""
    top_hz: Mapping[str, float]
    seconds: float
    """Length of a block [s]."""
    plain: Mapping[str, Array]
    """Gram matrices (B, 2, P+1, P+1) by equation in its own unit, below and above
    `SLOW_BAND_HZ`."""
    levels: Array
    """Mean tilt (B, 2) of each block, forward and left: (force minus the part that motion explains)
    divided by g."""
    number: Index
    """Index (B,) of each block among all blocks of the drives. The numbering of all blocks does not
    depend on the model."""
    columns: Mapping[str, Array] = field(default_factory=dict)
    """Transformed columns (all blocks, K, P) by equation, from which the Gram matrices are made."""

    def rms(self, equation: str, x: Array | None = None, band: int | None = None) -> float:
        """Return the rms residual of an equation [its unit] with parameters x: (P,), or (B, P) for
        each block."""
        gram = self.plain[equation]
        z = np.zeros((len(gram), gram.shape[2]))
        z[:, 0] = 1.0
        if x is not None:
            z[:, 1:] = -x
        power = np.einsum("bi,bkij,bj->bk", z, gram, z)
        there = gram[:, :, 0, 0].any(axis=1)
        chosen = power[there] if band is None else power[there][:, band : band + 1]
        return float(np.sqrt(np.maximum(chosen.sum() / max(int(there.sum()), 1), 0.0)))

    def without(self, equations: Collection[str]) -> Table:
        """Return the same table for fits that do not use some equations. The residuals of these
        equations are kept."""
        if not equations:
            return self
        others = {n: gram for n, gram in self.by_equation.items() if n not in equations}
        gram = np.asarray(sum(others.values(), np.zeros_like(self.gram)))
        return replace(self, gram=gram, by_equation=others)

    @property
    def shown(self) -> set[str]:
        """Parameters that change at least one residual."""
        size = np.diagonal(self.gram, axis1=1, axis2=2).sum(axis=0)[1:]
        return {key for key, x in zip(self.keys, size, strict=True) if x > 0.0}

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return len(self.gram)

    def index(self, keys: Iterable[str]) -> list[int]:
        """Indices of keys."""
        return [self.keys.index(key) for key in keys]

    def direction(self, along: Mapping[str, float]) -> Array:
        """Return factors (P+1,) of the columns that change together. along: by parameter."""
        made = np.zeros(1 + len(self.keys))
        made[1 + np.array(self.index(along), dtype=int)] = list(along.values())
        return made

    def energy(self, along: Mapping[str, float]) -> dict[str, Array]:
        """Return, by equation, the sum of squares (B,) of columns that change together."""
        d = self.direction(along)
        return {n: gram @ d @ d for n, gram in self.by_equation.items()}


@dataclass
class Rows:
    """One equation of one drive, transformed: y (B, K), X (B, K, P), tilt (B, K, 2) or None.

    good: (B,) flags of the blocks in which enough rows are present.
    """

    y: Array
    X: Array
    tilt: Array | None
    good: Mask
    seconds: float
    """Length of a block."""


def table_of(drives: Sequence[DriveSignals], model: VehicleModel) -> tuple[Table, list[Forward]]:
    """Evaluate all drives with a model file. Returns the table and the evaluated drives."""
    total = sum(drive.duration_s for drive in drives)
    length = round((BLOCK_S if total > FEW_S else SHORT_BLOCK_S) / STEP_S)
    forwards = [Forward(drive, model, length) for drive in drives]
    keys = tuple(k for k, row in PARAMETERS.items() if all(drives[0].has(n) for n in row.needs))
    top = {name: min(_top_hz(drive, name) for drive in drives) for name in EQUATIONS}
    by_drive = [rows_of(f, model, keys, top) for f in forwards]
    parts = {name: joined([own[name] for own in by_drive]) for name in by_drive[0]}
    drive = np.concatenate([np.full(f.blocks, i) for i, f in enumerate(forwards)])
    start = np.concatenate([f.t[:: f.rows][: f.blocks] for f in forwards])
    speeds = [f.in_blocks(f.amount_of_speed()) for f in forwards]
    moving = np.concatenate([(v > MOVING_MPS).mean(axis=1) for v in speeds])
    for rows in parts.values():
        rows.good &= moving >= MOVING_SHARE
    levels = np.concatenate([f.levels() for f in forwards])
    for f in forwards:
        f.forget()
    bounds = np.array([plausible(model, key) for key in keys]).reshape(-1, 2)
    free = np.zeros(len(keys))
    # Each equation is divided by its noise, from the residuals of a fit of all parameters.
    for i in range(PASSES):
        weights = weights_of(parts, free)
        gram = {n: np.swapaxes(a, 1, 2) @ a for n, a in weighted(parts, weights).items()}
        whole = np.asarray(sum(gram.values()))
        if i + 1 < PASSES:
            total = whole.sum(axis=0)
            # A fit with implausible values is not accepted, even if it reduces the noise.
            free = box_fit(total[1:, 1:], total[1:, 0], bounds[:, 0], bounds[:, 1])
    keep = np.any([(w > 0.0).any(axis=1) for w in weights.values()], axis=0)
    table = Table(
        keys, whole[keep], {n: g[keep] for n, g in gram.items()},
        start[keep], drive[keep], moving[keep],
        np.array([tolerance(model, key) for key in keys]),
        np.array([model_error(model, key) for key in keys]), bounds, top,
        length * STEP_S, {n: g[keep] for n, g in _plain(parts).items()},
        levels[keep], np.flatnonzero(keep), {n: rows.X for n, rows in parts.items()},
    )  # fmt: skip
    return table, forwards


def _top_hz(drive: DriveSignals, equation: str) -> float:
    row = EQUATIONS[equation]
    periods = [drive.channels[n].period_s for n in row.takes if drive.has(n)]
    return min([row.top_hz, *(CARRIED / p for p in periods)])


def rows_of(
    f: Forward, model: VehicleModel, keys: Sequence[str], top: Mapping[str, float],
    known: Mapping[str, Array] | None = None,
) -> dict[str, Rows]:  # fmt: skip
    """Return the transformed residual and columns of each equation. known: columns (B, K, P) that
    were computed before, or None."""
    base = f.residuals({})
    masks = f.usable()
    block_tilt = f.tilts(base, masks)
    f.settle(block_tilt, f.inertial_share(base, masks, top["accel_x"], block_tilt))
    made = {}
    for name, x in base.of.items():
        mask = masks[name]
        count = max(1, int(2.0 * f.rows * STEP_S * top[name]))
        tilt = None
        if name in base.tilt:
            tilt = np.stack([cosine(z, mask, count) for z in base.tilt[name]], axis=2)
        good = mask.mean(axis=1) >= LEAST_SHARE
        X = np.zeros((f.blocks, count, len(keys))) if known is None else known[name]
        made[name] = Rows(cosine(x, mask, count), X, tilt, good, f.rows * STEP_S)
    if known is not None:
        return made
    settled = f.residuals({}, by_inertia=True)
    for j, key in enumerate(keys):
        step = tolerance(model, key) or PARAMETERS[key].tolerance
        moved = f.residuals({key: step}, by_inertia=True)
        for name, rows in made.items():
            if moved.of[name] is settled.of[name]:
                continue
            change = (settled.of[name] - moved.of[name]) / step
            if np.any(change):
                rows.X[:, :, j] = cosine(change, masks[name], rows.y.shape[1])
    return made


def cosine(x: Array, mask: Mask, count: int) -> Array:
    """Return the first coefficients of a block's cosine transform. Missing rows count as 0."""
    made: Array = dct(np.where(mask, x, 0.0), type=2, axis=1, norm="ortho")[:, :count]
    return made


def joined(parts: Sequence[Rows]) -> Rows:
    """Join the rows of several drives."""
    tilt = None
    if parts[0].tilt is not None:
        tilt = np.concatenate([p.tilt for p in parts if p.tilt is not None])
    return Rows(
        np.concatenate([p.y for p in parts]), np.concatenate([p.X for p in parts]), tilt,
        np.concatenate([p.good for p in parts]), parts[0].seconds,
    )  # fmt: skip


# weights -----------------------------------------------------------------------------------------


def tilts_of(
    parts: Mapping[str, Rows], weights: Mapping[str, Array] | None = None
) -> dict[str, Array]:
    """Return the tilt columns (B, K, Z) of the equations that contain the tilt of a block, times
    weights (B, K)."""
    tilts = {n: parts[n].tilt for n in TILTED if n in parts}
    return {
        n: z if weights is None else z * weights[n][:, :, None]
        for n, z in tilts.items()
        if z is not None
    }


def levelled(rows: Mapping[str, Array], tilts: Mapping[str, Array]) -> dict[str, Array]:
    """Return rows (B, K, P) by equation with the tilt projected out. Equations with a tilt (B, K,
    Z) come first."""
    if not tilts:
        return dict(rows)
    A, Z = (np.concatenate([of[n] for n in tilts], axis=1) for of in (rows, tilts))
    inner = np.swapaxes(Z, 1, 2) @ Z + 1e-9 * np.eye(Z.shape[2])
    level = A - Z @ np.linalg.solve(inner, np.swapaxes(Z, 1, 2) @ A)
    ends = np.cumsum([z.shape[1] for z in tilts.values()])[:-1]
    made = dict(zip(tilts, np.split(level, ends, axis=1), strict=True))
    return made | {n: a for n, a in rows.items() if n not in made}


def weights_of(parts: Mapping[str, Rows], x: Array) -> dict[str, Array]:
    """Return the weights (B, K) of each equation with these parameters: (P,), or (B, P) of each
    block."""
    left = {n: r.y[:, :, None] - r.X @ x[..., None] for n, r in parts.items()}
    left = levelled(left, tilts_of(parts))
    return {n: noise_weights(y[:, :, 0], parts[n].good) for n, y in left.items()}


def noise_weights(left: Array, good: Mask) -> Array:
    """Return the inverse of the noise as weights. The noise spectrum is the median over blocks.
    Noisy blocks get less weight."""
    if not good.any():
        return np.zeros_like(left)
    smooth = np.median(left[good] ** 2, axis=0) / MEDIAN_SQUARE
    if len(smooth) > SMOOTH:
        smooth = np.pad(smooth, SMOOTH // 2, mode="edge")
        smooth = np.convolve(smooth, np.ones(SMOOTH) / SMOOTH, "valid")
    smooth = np.maximum(smooth, 1e-12 + 1e-6 * smooth.max())
    white = left / np.sqrt(smooth)
    loud = np.maximum(np.sqrt(np.mean(white**2, axis=1)), 1.0)
    made: Array = good[:, None] / (np.sqrt(smooth) * loud[:, None])
    return made


def weighted(
    parts: Mapping[str, Rows],
    weights: Mapping[str, Array],
    added: Mapping[str, Array] | None = None,
) -> dict[str, Array]:
    """Return residual, columns and added columns (B, K, E) times weights (B, K, 1 + P + E), with
    the tilt projected out."""
    rows = {
        n: np.concatenate([r.y[:, :, None], r.X, *([added[n]] if added else [])], axis=2)
        * weights[n][:, :, None]
        for n, r in parts.items()
    }
    return levelled(rows, tilts_of(parts, weights))


def _plain(parts: Mapping[str, Rows]) -> dict[str, Array]:
    """Return Gram matrices in the equations' own units (squares per sample), in two frequency
    bands."""
    made: dict[str, Array] = {}
    good = {n: r.good[:, None].astype(np.float64) for n, r in parts.items()}
    for n, a in weighted(parts, good).items():
        # Coefficient k of a block of T seconds lies at k / 2T.
        cut = max(1, round(2.0 * SLOW_BAND_HZ * parts[n].seconds))
        halves = [np.swapaxes(b, 1, 2) @ b for b in (a[:, :cut], a[:, cut:])]
        made[n] = np.stack(halves, axis=1) / (parts[n].seconds / STEP_S)
    return made
