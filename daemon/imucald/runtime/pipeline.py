"""The pipeline converts time-stamped samples to corrections. The pipeline opens no files and reads
no clock.

Samples are collected in ticks. At the end of each tick, the estimator processes the tick and
returns the correction for the next tick. The live daemon adds samples one by one (`add_sample`);
replay adds whole columns (`run`). Both methods give the same corrections to the last bit.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from msgspec import Struct, field
from numpy.typing import NDArray

from imucald.core.rotations import times_columns
from imucald.core.samples import Samples, Series
from imucald.motion.column_ticks import TickAccumulator, ticks_from_samples
from imucald.motion.hops import HOP_TICKS
from imucald.motion.sample_health import SampleHealth
from imucald.motion.signal_health import Faults
from imucald.motion.ticks import (
    SPEED,
    TICK_RATE,
    TickRow,
    emptied,
    tick_index,
)
from imucald.mount.estimate import (
    Correction,
    JudgesSignals,
    KeepsTicks,
    MountEstimate,
    MountEstimator,
    MountState,
)

if TYPE_CHECKING:
    from imucald.model_compensation.tick_preprocessing import TickPreprocessing

FEW_TICKS = 3
"""Up to this number of ticks, each tick is processed alone."""

Quality = int
"""Quality in the output frames: 0 not available, 1 restored, 2 usable, 3 fine, 4 suspect."""

_QUALITY = {
    MountState.USABLE: 2,
    MountState.FINE: 3,
    MountState.SUSPECT: 4,
    MountState.RECALIBRATING: 4,
    MountState.RESTORED: 1,
}


class Snapshot(Struct, frozen=True):
    """The estimate at the end of tick k."""

    k: int
    estimate: MountEstimate
    usable: bool
    """True if a correction is applied from this tick on."""
    faults: Mapping[str, Faults] = field(default_factory=dict)
    """For each channel of a faulty sensor or signal, its faults."""

    @property
    def t(self) -> float:
        """Stream time of the end of the tick [s]."""
        return (self.k + 1) / TICK_RATE


class TickCorrections(Struct, frozen=True, dict=True):
    """The corrections applied during ticks `first`, `first` + 1, ..., and their qualities.

    The arrays are computed at the first use, because not every replay needs them. unfit: for each
    channel, a mask (n,) of the ticks in which its sensor is faulty. A channel without an entry has
    no fault.
    """

    first: int
    corrections: Sequence[Correction | None]
    qualities: Sequence[Quality]
    unfit: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)

    @cached_property
    def _spells(self) -> tuple[list[Correction | None], NDArray[np.int64]]:
        """The m successive corrections, and the first tick of each correction (m,)."""
        which = np.fromiter(map(id, self.corrections), np.uint64, len(self.corrections))
        first = np.append(0, np.flatnonzero(which[1:] != which[:-1]) + 1)
        return [self.corrections[i] for i in first.tolist()], first

    def _rows(self, channel: str) -> NDArray[np.float64]:
        """Return for each of the m corrections the matrix (row by row) and the offset for a
        channel's samples, (m, 12). The values are NaN without a correction.
        """
        of = [None if c is None else c.matrix_and_offset(channel) for c in self._spells[0]]
        return np.array([(math.nan,) * 12 if c is None else (*c[0], *c[1]) for c in of])

    def turned(
        self, channel: str, ticks: NDArray[np.int64], values: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Convert samples (N, 3) of a channel to vehicle axes. ticks: (N,) ticks of the samples,
        counted from `first`.
        """
        rows = self.rows_in(channel, ticks)
        return times_columns(rows, values) - rows[:, 9:]

    def rows_in(self, channel: str, ticks: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the matrix (row by row) and the offset for a channel's samples in each of the
        ticks (N,), counted from `first`: (N, 12), SI. The values are NaN without a correction.
        `Correction.matrix_and_offset` defines matrix and offset. The shape is (1, 12) if the
        correction is the same in all n ticks.
        """
        rows, (_, first) = self._rows(channel), self._spells
        if len(rows) == 1:
            return rows
        return rows.take(np.searchsorted(first, ticks, side="right") - 1, axis=0)

    @cached_property
    def quality(self) -> NDArray[np.uint8]:
        """Quality in each tick, (n,)."""
        return np.array(self.qualities, dtype=np.uint8)


class Pipeline:
    """Collects the samples of one sensor in ticks, passes the ticks to the estimator, and stores
    the corrections.

    status_ticks: number of ticks between two snapshots of the estimate. preprocessor: removes the
    effects that a model file states from ticks, before the estimator processes them. health: checks
    the uncorrected samples. The estimator receives no samples of a faulty sensor.
    """

    def __init__(
        self,
        estimator: MountEstimator,
        status_ticks: int = 10,
        preprocessor: TickPreprocessing | None = None,
        health: SampleHealth | None = None,
    ) -> None:
        self.estimator = estimator
        self.health = health or SampleHealth({})
        self._preprocessor = preprocessor
        self.correction: Correction | None = estimator.correction
        self.quality: Quality = 0
        self.first_usable: float | None = None
        """Stream times [s] at which the correction first became usable and first became fine; None
        if it did not."""
        self.first_fine: float | None = None
        self.k = 0
        """Number of the open tick: the tick to which new samples are added."""
        self.speed: tuple[int, float] | None = None
        """The last tick with a known speed, and the mean speed in this tick [m/s]."""
        self.closed: TickRow | None = None
        """Row of the last tick that was processed alone; None before the first such tick."""
        self.status_ticks = status_ticks
        self._ticks = TickAccumulator()
        self._judges, self._keeps = _judging(estimator), _keeping(estimator)
        self._signals_judged: Mapping[str, bool] = {}
        self._judge()

    # live ----------------------------------------------------------------------------------

    def add_sample(self, t: float, channel: str, values: Sequence[float]) -> None:
        """Add one sample to the open tick (see `advance`)."""
        self._ticks.add_sample(channel, t, values)

    def reject(self, channel: str) -> None:
        """Count a sample of the open tick that was rejected for its value."""
        self._ticks.reject(channel)

    def advance(self, k: int) -> list[Snapshot]:
        """End all ticks before tick k. Tick k becomes the open tick. Return the snapshots that are
        due."""
        snapshots: list[Snapshot] = []
        while self.k < k:
            self.health.close(self.k)
            self._close(self._ticks.close(self.k), snapshots, self.health.faults)
        return snapshots

    def gap(self, k: int) -> list[Snapshot]:
        """Process a jump of time: end all ticks before k. A new segment begins at tick k. Return
        the snapshots that are due."""
        snapshots = self.advance(k)
        self.estimator.gap()
        self.health.gap()
        if self._preprocessor is not None:
            self._preprocessor.gap()
        return snapshots

    def replace(self, estimator: MountEstimator, afresh: bool = False) -> MountEstimator:
        """Use another estimator from the open tick on. Return the former estimator.

        afresh: if True, the times at which the mount became usable and fine are forgotten.
        """
        former, self.estimator = self.estimator, estimator
        self._judges, self._keeps = _judging(estimator), _keeping(estimator)
        self.correction = estimator.correction
        if afresh:
            self.first_usable = self.first_fine = None
        self._judge()
        return former

    def go_on_from(self, former: Pipeline, same: Collection[str]) -> None:
        """Continue at the open tick of another pipeline, with the estimator of this pipeline.

        same: channels with unchanged sources; their health is kept.
        """
        self.k = former.k
        judged = self._judges is not None
        self.health.go_on_from(former.health, same, self.k / TICK_RATE, judged)
        if "speed" in same:
            self.speed = former.speed

    # columns -------------------------------------------------------------------------------

    def run(
        self,
        samples: Samples,
        rejected: Mapping[str, NDArray[np.float64]],
        t_last: float,
        with_snapshots: bool = True,
        watched: Samples | None = None,
    ) -> tuple[TickCorrections, list[Snapshot]]:
        """Add columns of samples up to stream time t_last [s]. The tick at t_last stays open.

        samples: all samples since the last call. rejected: times [s] of rejected samples, by
        channel. watched: the uncorrected samples, if they differ. Returns the corrections from the
        previously open tick to the now open tick, and the snapshots. With with_snapshots=False, no
        snapshots are made, which saves time.
        """
        first, last = self.k, tick_index(t_last)
        rows = [self.correction]
        quality = [self.quality]
        snapshots: list[Snapshot] = []
        taken = snapshots if with_snapshots else None
        faults = [self.health.faults]
        faults += self.health.columns(samples if watched is None else watched, first, last)
        hop = first // HOP_TICKS
        self._add_tick(samples, rejected, first)
        if last > first:
            self._close(self._ticks.close(first), taken, faults[(first + 1) // HOP_TICKS - hop])
            rows.append(self.correction)
            quality.append(self.quality)
            closed = ticks_from_samples(samples, first + 1, last, rejected)
            all_fit = not any(faults)
            while self.k < last:
                left = closed[self.k - first - 1 :]
                quiet = self._keep_quiet(left, taken) if all_fit else 0
                if not quiet:
                    row = left[0].tolist()
                    self._close(row, taken, faults[(self.k + 1) // HOP_TICKS - hop])
                rows += [self.correction] * (quiet or 1)
                quality += [self.quality] * (quiet or 1)
            self._add_tick(samples, rejected, last)
        return TickCorrections(first, rows, quality, _unfit_ticks(faults, first, last)), snapshots

    def _keep_quiet(self, rows: NDArray[np.float64], snapshots: list[Snapshot] | None) -> int:
        """Process together all ticks that the estimator only stores. Return the number of these
        ticks.

        rows: rows of the ticks from the open tick on. No sensor may be faulty in any of these
        ticks.
        """
        estimator, keeps = self.estimator, self._keeps
        if self._preprocessor is not None or keeps is None:
            return 0
        n = min(keeps.quiet_ticks(), len(rows))
        if n < FEW_TICKS:
            return 0
        keeps.keep_quiet(rows[:n])
        newest = n - 1
        if not rows[newest, SPEED.n]:
            newest = int(np.flatnonzero(rows[:n, SPEED.n])[-1:].max(initial=-1))
        if newest >= 0:
            self.speed = self.k + newest, float(rows[newest, SPEED.mean])
        first, self.k = self.k, self.k + n
        if snapshots is not None:
            every = self.status_ticks
            snapshots += [
                Snapshot(k - 1, estimator.estimate(), self.quality > 0, self.health.signals)
                for k in range((first // every + 1) * every, self.k + 1, every)
            ]
        return n

    def _add_tick(
        self, samples: Samples, rejected: Mapping[str, NDArray[np.float64]], k: int
    ) -> None:
        for channel, series in samples.items():
            part = _of_tick(series, k)
            values = part.values.tolist()
            for t, value in zip(part.t.tolist(), values, strict=True):
                self._ticks.add_sample(channel, t, value if isinstance(value, list) else (value,))
        for channel, times in rejected.items():
            for _ in range(int(np.count_nonzero(np.floor(times * TICK_RATE) == k))):
                self._ticks.reject(channel)

    # both ----------------------------------------------------------------------------------

    def snapshots_due(self, first: int) -> int:
        """Return the number of snapshots that became due since tick `first` was open."""
        return self.k // self.status_ticks - first // self.status_ticks

    def _close(
        self, row: TickRow, snapshots: list[Snapshot] | None, faults: Mapping[str, Faults]
    ) -> None:
        """End a tick. faults: faults that are present from the end of the tick on."""
        estimator = self.estimator
        if faults:
            row = emptied(row, faults)
        self.closed = row
        if row[SPEED.n]:
            self.speed = self.k, row[SPEED.mean]
        if self._preprocessor is not None:
            row = self._preprocessor.row(row, self.correction)
        estimator.step(row)
        self.correction = estimator.correction
        self._judge()
        self.k += 1
        self._take_signals()
        if snapshots is not None and self.k % self.status_ticks == 0:
            unfit = {**faults, **self.health.signals}
            snapshots.append(Snapshot(self.k - 1, estimator.estimate(), self.quality > 0, unfit))

    def _take_signals(self) -> None:
        """Pass the stuck signals that the estimator found in a new block to the signal health."""
        if self._judges is None:
            return
        judged = self._judges.stuck_signals
        if judged is not self._signals_judged:
            self._signals_judged = judged
            self.health.take_signals(judged, self.k / TICK_RATE)

    def _judge(self) -> None:
        self.quality = _QUALITY.get(self.estimator.state, 0)
        if self.correction is None or not self.quality:
            self.correction, self.quality = None, 0
            return
        if self.first_usable is None:
            self.first_usable = (self.k + 1) / TICK_RATE
        if self.first_fine is None and self.quality == _QUALITY[MountState.FINE]:
            self.first_fine = (self.k + 1) / TICK_RATE


def _judging(estimator: MountEstimator) -> JudgesSignals | None:
    return estimator if isinstance(estimator, JudgesSignals) else None


def _keeping(estimator: MountEstimator) -> KeepsTicks | None:
    return estimator if isinstance(estimator, KeepsTicks) else None


def _of_tick(series: Series, k: int) -> Series:
    low, high = (bisect_left(series.t, end, key=tick_index) for end in (k, k + 1))
    return Series(series.t[low:high], series.values[low:high])


def _unfit_ticks(
    faults: Sequence[Mapping[str, Faults]], first: int, last: int
) -> dict[str, NDArray[np.bool_]]:
    """Return masks of the ticks `first` to `last` in which a sensor is faulty, by channel.

    faults: the faults in each hop (`HOP_TICKS` ticks).
    """
    channels = {channel for of_hop in faults for channel in of_hop}
    if not channels:
        return {}
    hop = np.arange(first, last + 1) // HOP_TICKS - first // HOP_TICKS
    return {c: np.array([c in of_hop for of_hop in faults])[hop] for c in sorted(channels)}
