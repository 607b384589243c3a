"""Runs of equal values of one signal: where they are, and how long they usually last."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucald.core.arrays import Array

Places = NDArray[np.int64]

MIN_STUCK_S = 1.2
"""Nothing shorter is called stuck."""
TIMES_USUAL = 4.0
"""And so many times the usual run."""
RUNS_REMEMBERED = 200
MIN_RUNS = 50
"""Before so many nothing is called stuck."""


class EqualRuns(NamedTuple):
    """Runs of equal values: places (M,) of the first and last of each; `change`: (N - 1,), the
    size of the change after each value."""

    first: Places
    last: Places
    change: Array


def runs_of(values: Array, same: float) -> EqualRuns:
    """The runs in values (N,), N > 0, that differ by no more than `same` from one to the next."""
    change = np.abs(values[1:] - values[:-1])
    ended = np.flatnonzero(change > same)
    first, last = np.zeros((2, len(ended) + 1), np.int64)
    first[1:], last[:-1], last[-1] = ended + 1, ended, len(values) - 1
    return EqualRuns(first, last, change)


SHORT_TICKS = 11
"""No run of so many ticks lasts longer than MIN_STUCK_S."""


def short_runs(
    values: Array, same: float, leaving: int
) -> tuple[NDArray[np.bool_], Places, Places, Places, Array]:
    """Runs in each row of values (B, N) that end among its first `leaving`.

    Returns whether all of a row's runs are short and none goes on from the first `leaving` to the
    others (B,); and of each run (M,) its row, the places of its first and last value, and the size
    of the change after it.
    """
    change = np.abs(values[:, 1:] - values[:, :-1])
    is_over = change > same
    ended = np.zeros(values.shape, np.int64)
    np.cumsum(is_over, axis=1, out=ended[:, 1:])
    simple = (ended[:, SHORT_TICKS:] > ended[:, :-SHORT_TICKS]).all(axis=1)
    simple &= is_over[:, leaving - 1]
    row, last = np.nonzero(is_over[:, :leaving])
    first = np.zeros_like(last)
    goes_on = np.flatnonzero(row[1:] == row[:-1])
    first[goes_on + 1] = last[goes_on] + 1
    return simple, row, first, last, change[row, last]


class UsualRuns:
    """The last RUNS_REMEMBERED runs that ended: how long each lasted, and the change after it."""

    def __init__(self) -> None:
        self._runs = np.zeros((RUNS_REMEMBERED, 2))
        self._ended = 0

    def add(self, lasted: Array, change: Array) -> None:
        """Remember runs that ended: (M,) how long, (M,) the change after."""
        if not len(lasted):
            return
        place = (self._ended + np.arange(len(lasted))) % RUNS_REMEMBERED
        self._runs[place, 0], self._runs[place, 1] = lasted, change
        self._ended += len(lasted)

    @property
    def known(self) -> bool:
        """Whether enough have ended to say what is usual."""
        return self._ended >= MIN_RUNS

    @property
    def usual(self) -> float:
        """How long a run lasts, as seen at any time: long ones weigh more."""
        lasted = self._runs[: self._ended, 0]
        return float(lasted @ lasted / lasted.sum())

    def repeated(self, share: float, times: float) -> float:
        """How long a run of a sender lasts that repeats its values; 0: it does not.

        Most of its changes are then larger than so many times its step, the change that a share of
        all changes does not exceed.
        """
        lasted, change = self._runs[: self._ended].T
        is_jump = change > times * self.change(share)
        if 2 * np.count_nonzero(is_jump) <= len(change):
            return 0.0
        return float(lasted[is_jump] @ lasted[is_jump] / lasted[is_jump].sum())

    def change(self, share: float) -> float:
        """The change that this share of all changes does not exceed."""
        return quantile(self._runs[: self._ended, 1], share)


def quantile(values: Array, share: float) -> float:
    """As numpy.quantile, which loads its masked arrays for it (7 ms, 1.2 MiB)."""
    ordered = np.sort(values)
    place = share * (len(ordered) - 1)
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    return float(ordered[low] + (place - low) * (ordered[high] - ordered[low]))
