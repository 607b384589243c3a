"""Windows of a drive. The latest windows are stored one by one, and earlier windows are stored as
sums by road segment.

A fit gives less weight to windows with much noise. The weight of an old window stays constant. Four
old windows are therefore added to one Gram matrix, and later fits need only this matrix.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array, inverse
from imucald.drive import windows as wd
from imucald.drive.windows import OVERLAP
from imucald.mount.joint.response import (
    SEGMENTS,
    Packing,
    Responses,
    grown,
    left_of,
    respond,
    segments_of,
    trust_in,
)

Complex = NDArray[np.complex128]

RECENT = 64
"""Number of windows that are stored one by one: 7 minutes of driving."""
ROUND = SEGMENTS[-1]
"""Number of windows that are summed at one time. This number contains whole road segments of both
lengths.
"""
NOTHING = 1e-9
"""Size below which information is only rounding error. A coefficient with so little information did
not appear in any motion of the drive.
"""
MAIN: Final = slice(wd.FIRST_X, wd.FIRST_X + len(wd.MAIN))
TURNED: Final = slice(len(wd.NAMES) - len(wd.TURNED), len(wd.NAMES))


class Fits(NamedTuple):
    """Settings of F least squares fits with the same number of columns. The first column is fitted
    on the other columns.

    columns: (F, 1 + p) indices of the columns. usual: (F, BANDS) expected noise. spread: (F, p)
    prior deviations of the coefficients. keep: number of coefficients to return.
    """

    columns: tuple[tuple[int, ...], ...]
    usual: Array
    spread: Array
    keep: int


class FitSums:
    """The windows of several fits. The first `_old` rows are road segments, and the other rows are
    windows.
    """

    def __init__(self, fits: Fits) -> None:
        self._fits = fits
        self._packing = Packing(len(fits.columns[0]))
        self._store = np.zeros((len(fits.columns), ROUND, wd.BANDS, self._packing.size))
        self._counts = np.zeros((len(fits.columns), 0))  # sums of weights in the old rows
        self._trust = np.zeros((len(fits.columns), 0))  # by the last fit; the old rows hold theirs
        self._old = 0
        self._last: Responses | None = None
        self.has_fitted = False  # these windows, or most of them

    def restart(self) -> None:
        """Forget all windows, but keep the estimated noise."""
        self._counts, self._trust, self._old = self._counts[:, :0], self._trust[:, :0], 0
        self.has_fitted = False

    @property
    def _rows(self) -> Array:
        """The rows in use (F, n, BANDS, size)."""
        return self._store[:, : self._counts.shape[1]]

    @property
    def noise(self) -> Array:
        """Noise (F, BANDS) of the last fits. In unused bands, and before any fit, the result is the
        expected noise.
        """
        usual = self._fits.usual
        if self._last is None:
            return usual
        return np.where(np.isfinite(self._last.noise), self._last.noise, usual)

    @property
    def trust(self) -> Array:
        """Weights (F, m) of the last m windows in the last fit."""
        return self._trust[:, self._old :]

    def add_windows(self, products: Array) -> None:
        """Add the products (n, BANDS, columns, columns) of n windows."""
        new = np.ones((len(self._store), len(products)))
        at, stop = self._counts.shape[1], self._counts.shape[1] + len(products)
        if stop > self._store.shape[1]:  # room for more than these: copying takes time
            room = np.zeros((len(new), stop - at + ROUND, *self._store.shape[2:]))
            self._store = np.concatenate([self._rows, room], axis=1)
        for i, columns in enumerate(self._fits.columns):
            self._store[i, at:stop] = self._packing.packed(products, columns)
        self._counts = np.concatenate([self._counts, new], axis=1)
        if (last := self._last) is not None:
            rows = self._store[:, at:stop]
            new = trust_in(left_of(rows, last.power, self._packing), last.noise)
        self._trust = np.concatenate([self._trust, new], axis=1)
        while last is not None and self._rows.shape[1] - self._old >= RECENT + ROUND:
            self._put_together()

    def _put_together(self) -> None:
        at, stop = self._old, self._old + ROUND
        rows, length = self._rows[:, at:stop], SEGMENTS[0]
        trust = self._trust[:, at:stop]
        by_segment = (len(rows), -1, length)
        sums = (trust[:, :, None, None] * rows).reshape(*by_segment, *rows.shape[2:]).sum(axis=2)
        self._old += sums.shape[1]
        rows[:, : sums.shape[1]] = sums
        self._counts[:, at : self._old] = trust.reshape(by_segment).sum(axis=2)
        self._trust[:, at : self._old] = 1.0
        self._leave_out(self._old, stop)

    def _leave_out(self, first: int, stop: int) -> None:
        """Delete the rows from `first` to `stop`."""
        kept = self._rows[:, stop:].copy()
        self._counts = np.delete(self._counts, slice(first, stop), axis=1)
        self._trust = np.delete(self._trust, slice(first, stop), axis=1)
        self._rows[:, first:] = kept

    def drop(self, windows: int) -> None:
        """Delete the first windows. windows: number of windows to delete. Windows in road segments
        are deleted only in multiples of `ROUND`.
        """
        segments = min(windows // ROUND * (ROUND // SEGMENTS[0]), self._old)
        rows = segments
        if segments == self._old:
            rows += windows - segments * SEGMENTS[0]
        self._leave_out(0, rows)
        self._old -= segments
        self.has_fitted = self.has_fitted and self._rows.shape[1] > 0

    def by_segment(self, to_last: bool = False, is_weighted: bool = True) -> Array:
        """Return the information (F, S, columns, columns) of each road segment.

        Weights and noise are results of the last fit. Windows after the last fit are included too.
        to_last: the last segment ends with the last window. is_weighted: False: each window has the
        same weight.
        """
        last = self._last
        assert last is not None
        trust = self._trust
        if not is_weighted:
            trust = np.where(np.arange(trust.shape[1]) < self._old, SEGMENTS[0] / self._counts, 1.0)
        weight = (2.0 / OVERLAP) * trust[:, :, None] / last.noise[:, None]
        rows = (weight[:, :, None] @ self._rows)[:, :, 0]
        segment = segments_of(self._old, rows.shape[1], to_last)
        starts = np.flatnonzero(np.diff(segment, prepend=-1))
        return self._packing.matrices(np.add.reduceat(rows, starts, axis=1))

    def scores(self, G: Array) -> tuple[Array, Array]:
        """Return the residual scores (F, S, keep) of the coefficients in each road segment, and the
        information (F, S, keep) about the coefficients. G: result of `by_segment`.
        """
        assert self._last is not None
        kept = slice(1, 1 + self._fits.keep)
        scores = (G[:, :, kept] @ self._last.vector[:, None, :, None])[..., 0]
        return scores, np.diagonal(G[:, :, kept, kept], axis1=2, axis2=3)

    def changes(self, G: Array, spans: NDArray[np.int_]) -> tuple[Array, Array]:
        """Return the changes (F, B, keep) of the coefficients, and the variances of these changes.

        spans: (B,) numbers of last road segments. A change is the difference between these segments
        and all earlier segments. Each change is fitted together with all constant coefficients. G:
        result of `by_segment` without weights: weights from a fit without the change would hide the
        change. If the last segments have more residual power than the earlier segments, even with
        the change, the variances grow by the same factor.
        """
        keep, total = self._fits.keep, G.sum(axis=1)
        p = total.shape[-1] - 1
        C = inverse(total[:, 1:, 1:] + np.eye(p) / np.square(self._fits.spread)[:, None])
        beta = C @ total[:, 1:, :1]
        vector = np.concatenate([np.ones((len(G), 1, 1)), -beta], axis=1)
        after = G[:, ::-1][:, : spans[-1]].cumsum(axis=1)[:, spans - 1]
        w = after[:, :, 1:, 1 : 1 + keep]
        moved = C[:, None] @ w
        known = w[:, :, :keep] - w.swapaxes(2, 3) @ moved
        covariance = inverse(known + NOTHING * (1.0 + total[:, None, 1:2, 1:2]) * np.eye(keep))
        score = after[:, :, 1 : 1 + keep] @ vector[:, None]
        size = covariance @ score
        off = beta[:, None] - moved @ size  # of all that came before
        row = vector.swapaxes(1, 2)
        power = (row[:, None] @ after @ vector[:, None])[..., 0, 0]  # of the last segments
        before = (row @ total @ vector)[..., 0] - power
        power = power - (score * size).sum(axis=(2, 3))  # with the change
        segments = G.shape[1] - spans
        louder = power / spans * segments / np.maximum(before, NOTHING)
        grow = _grown_before(G, C[:, :keep], off[..., 0], segments)
        grow = grow * np.maximum(louder, 1.0)[..., None]
        return size[..., 0], np.abs(np.diagonal(covariance, axis1=2, axis2=3)) * grow

    def respond(self, bands: NDArray[np.bool_]) -> Responses:
        """Return the fits on all windows. bands: flags of the used bands."""
        _, usual, spread, keep = self._fits
        args = self._rows, self._old, self._packing, usual, spread, keep, bands
        last = (self.noise, self._trust) if self.has_fitted else ()
        self._last = found = respond(*args, *last)
        self._trust, self.has_fitted = found.trust, True
        return found


def _grown_before(G: Array, C: Array, off: Array, began: NDArray[np.int_]) -> Array:
    """Return, for each fit, time and coefficient (F, B, keep), the factor by which the variance
    between road segments exceeds its expected value.

    The factor is computed from the road segments before each possible time of a change. G: (F, S,
    columns, columns) information of each road segment. C: (F, keep, p) rows of the covariance of
    the coefficients.
    off: (F, B, p) coefficients before each time. began: (B,) number of segments before each time.
    """
    seen = C[:, None] @ G[:, :, 1:]
    scores = seen[..., :1] - seen[..., 1:] @ off[:, None].swapaxes(2, 3)  # (F, S, keep, B)
    expected = (seen[..., 1:] * C[:, None]).sum(axis=3)
    grow = np.ones((len(G), len(began), C.shape[1]))
    for length in SEGMENTS:
        joined = length // SEGMENTS[0]
        starts = np.arange(0, G.shape[1], joined)
        square = np.square(np.add.reduceat(scores, starts, axis=1)).cumsum(axis=1)
        usual = np.add.reduceat(expected, starts, axis=1).cumsum(axis=1)
        whole = began // joined  # segments before each
        k = np.flatnonzero(whole > 0)
        of_span = square[:, whole[k] - 1, :, k].swapaxes(0, 1)
        ratio = of_span / np.maximum(usual[:, whole[k] - 1], NOTHING)
        grow[:, k] = np.maximum(grow[:, k], grown(ratio, whole[k, None].astype(float)))
    return grow


class WindowSums:
    """All windows, stored for each fit, and the sums that the fits share."""

    def __init__(self, force: Fits, turning: Fits) -> None:
        self.force, self.turning = self._fits = FitSums(force), FitSums(turning)
        self.restart()

    def __len__(self) -> int:
        return len(self._power)

    def has_fitted(self, with_turning: bool) -> bool:
        """True if a fit used all or most of these windows. with_turning: the fit of the rate must
        have used the windows too.
        """
        return self.force.has_fitted and (self.turning.has_fitted or not with_turning)

    def restart(self) -> None:
        """Forget all windows."""
        for fit in self._fits:
            fit.restart()
        self._blocks = np.zeros(0, dtype=int)
        self._cross = np.zeros((0, len(wd.BINS)), dtype=complex)
        self._power = np.zeros(0)
        self._trust = np.zeros(0)
        self._knots = np.zeros(0)
        self._shared = np.zeros((0, 2, 4))

    def add_spectra(self, spectra: Complex, blocks: NDArray[np.int_], known_rate: Array) -> None:
        """Add the spectra (n, bins, columns) of n windows. blocks: (n,) number of the last block
        of each window. known_rate: (n,) number of known speeds per tick in each window.
        """
        products = wd.products(spectra)
        for fit in self._fits:
            fit.add_windows(products)
        driven = spectra[:, :, wd.FIRST_X]
        main = products[:, :, MAIN].sum(axis=1)
        self._blocks = np.concatenate([self._blocks, blocks])
        self._cross = np.concatenate([self._cross, np.conj(driven) * spectra[:, :, 0]])
        self._power = np.concatenate([self._power, (np.abs(driven) ** 2).sum(axis=1)])
        self._trust = np.concatenate([self._trust, np.ones(len(blocks))])
        self._knots = np.concatenate([self._knots, known_rate * wd.WINDOW])
        shared = np.concatenate([main[:, :, MAIN], main[:, :, TURNED]], axis=2)
        self._shared = np.concatenate([self._shared, shared])

    def forget(self, blocks: int) -> None:
        """Delete the windows that end in the first blocks. blocks: number of these first blocks.
        The remaining blocks are counted from zero again.
        """
        gone = int(np.searchsorted(self._blocks, blocks))
        for fit in self._fits:
            fit.drop(gone)
        self._blocks = self._blocks[gone:] - blocks
        self._cross, self._power = self._cross[gone:], self._power[gone:]
        self._shared, self._trust = self._shared[gone:], self._trust[gone:]
        self._knots = self._knots[gone:]

    def began(self, segments: NDArray[np.int_]) -> NDArray[np.int_]:
        """Return the first block (S,) of a group of road segments that ends with the last window.
        segments: (S,) number of road segments of each group.
        """
        first = self._blocks[len(self._blocks) - SEGMENTS[0] * segments]
        return np.asarray(first - (wd.WINDOW // wd.BLOCK - 1))

    def ends(self, to_last: bool = False) -> NDArray[np.int_]:
        """Return the last block (S,) of each road segment. to_last: the last segment ends with the
        last window.
        """
        length, n = SEGMENTS[0], len(self._blocks)
        first = (n - 1) % length if to_last else length - 1
        return self._blocks[np.minimum(np.arange(first, n + first, length), n - 1)]

    def weigh_spectra(self) -> Complex:
        """Give each window its weight in the last fit of the forward force. A window in a road
        segment keeps its earlier weight.

        Return the weighted sum of the products of dv/dt with the forward force, for each frequency
        bin (bins,).
        """
        trust = self.force.trust[0]
        self._trust[len(self._trust) - len(trust) :] = trust
        return np.asarray(self._trust @ self._cross, dtype=complex)

    @property
    def bands_with_speed(self) -> int:
        """Number of the lowest frequency bands in which the known speeds determine dv/dt.

        Means between K known speeds in a window have K independent values. The Fourier bins above
        the first K / 2 therefore repeat the lower bins (Nyquist). K is the mean over all times,
        weighted by the power of dv/dt.
        """
        known = float(self._power @ self._knots) / max(float(self._power.sum()), 1e-12)
        return int(np.count_nonzero(np.array(wd.EDGES[1:]) - 1 <= 0.5 * known))

    @property
    def leak(self) -> Array:
        """Response (2, 2) of the computed gravity along x and y to dv/dt and v r (speed times yaw
        rate), for a gyroscope that is rotated about z by one radian.
        """
        total = self._shared.sum(axis=0)
        return np.asarray(np.linalg.lstsq(total[:, :2], total[:, 2:], rcond=None)[0].T)
