"""Hypotheses of a sudden change: the sensor was turned, or a zero of the accelerometer stepped.

The filter of `drift` follows a sound sensor in a fixed mount. Each hypothesis adds `size` times a
known direction to the state of the filter at an onset. The innovations answer linearly, so each
onset has its likelihood ratio in closed form (Willsky and Jones, IEEE Trans. Automatic Control 21,
1976). The ratios are summed over the onsets as in `drift`.

A turn of the sensor by a small rotation phi moves the vertical, its mean (u x phi) and the response
to motion (f x phi). The gyroscope has felt the turn, and carried the vertical with it, or has not.
A step of a zero moves the force alone. Bends tell both apart: the vertical of a turned sensor goes
on about the axis that its gyroscope shows. A long grade moves the mean vertical and is no fault.
What it explains as well makes no change certain.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from imucald.core.arrays import Array, solved
from imucald.core.samples import GRAVITY

UP, RATE_ZERO, GYRO, TILT = slice(0, 2), slice(2, 5), slice(5, 7), slice(7, 9)
MOTIONS = 5
"""Motions that the force responds to: dv/dt, v r, dr/dt, r^2, (v r)^2."""
ZERO, ANSWER = slice(9, 12), slice(12, 12 + 3 * MOTIONS)
UPWARD = slice(ZERO.stop - 1, ZERO.stop)
STATES = ANSWER.stop
"""The state of the filter, see `drift`."""
MOST_ONSETS = 10
"""Onsets that are tested: the beginnings of the last blocks (64 s). An open question keeps its
onset for longer.
"""
BELIEVED: Final = math.log(1000.0)
"""Log of the odds from which one cause is believed: the first order and a level road are not exact,
and a wrong answer costs minutes.
"""
LEAST_BLOCKS = 3
"""Blocks since the onset from which the cause is decided: the change may lie at the end of the
first.
"""
TURNED_STD, ZERO_STD = 0.1, 0.5
"""Prior deviations of a turn about each axis [rad], and of a step of each zero [m/s^2]: most turns
by hand are by some degrees; a step is a fault from some tens of mg on.
"""
SECOND_ORDER = 0.05
"""Prior deviation of the change of the upward force by a turn or grade [m/s^2], about its second
order -g (x^2 + y^2) / 2: the slope before adds to it.
"""


def _turned(is_felt: bool) -> Array:
    """Return the effect on the state (STATES, 4) of a turn about x, y, z and of its second order.

    is_felt: by the gyroscope, which has carried the vertical with it.
    """
    made = np.zeros((STATES, 4))
    for part in (TILT,) if is_felt else (UP, TILT):
        made[part, :2] = [[0.0, -1.0], [1.0, 0.0]]
    dvdt, vr = (slice(ANSWER.start + i, ANSWER.stop, MOTIONS) for i in range(2))
    made[dvdt, 1:3] = [[0.0, 0.0], [0.0, -1.0], [1.0, 0.0]]
    made[vr, 2] = [1.0, 0.0, 0.0]  # in z, -v q of the turned gyroscope adds phi_x v r again
    made[UPWARD, 3] = 1.0
    return made


def _unit(part: slice) -> Array:
    """Return the effect on the state of one unknown for each number of a part."""
    return np.eye(STATES)[:, part]


class ChangeHypothesis(NamedTuple):
    """A change with k unknowns. effect: (STATES, k) on the state. std: (k,) prior deviations.

    chance: of this change, if there is one. tilts: the first two unknowns tilt the vertical, and
    the last one is the second order of that.
    """

    effect: Array
    std: Array
    chance: float
    tilts: bool = True


_TURNED_STDS: Final = np.array([TURNED_STD] * 3 + [SECOND_ORDER])
NOT_FELT: Final = ChangeHypothesis(_turned(is_felt=False), _TURNED_STDS, 0.25)
FELT: Final = ChangeHypothesis(_turned(is_felt=True), _TURNED_STDS, 0.25)
STEPPED: Final = ChangeHypothesis(_unit(ZERO), np.full(3, ZERO_STD), 0.5, tilts=False)
GRADE: Final = ChangeHypothesis(
    np.hstack([_unit(TILT), _unit(UPWARD)]), np.array([0.05, 0.03, SECOND_ORDER]), 1.0
)
"""A long grade or bank of the road: 10 % is a steep mountain road, 6 % a steep superelevation (two
deviations).
"""
HYPOTHESES: Final = (NOT_FELT, FELT, STEPPED, GRADE)
EFFECT: Final = np.hstack([one.effect for one in HYPOTHESES])
"""Effect of the unknowns of all hypotheses at an onset (STATES, 14)."""


class SuddenChange(NamedTuple):
    """The most likely sudden change.

    is_turn: the sensor was turned; otherwise, a zero stepped. size: (3,) rotation vector of the
    sensor [rad] or change of the zero [m/s^2], working axes. covariance: (3, 3) of it. log_odds:
    log of the statistic of any sudden change over its threshold, and over that of a long grade.
    grade: log of the statistic of a long grade. ahead: log of the odds against the other cause.
    began: time of the onset. blocks: number of blocks since then. level: upward force of the
    filter, about that before it [m/s^2].
    """

    is_turn: bool
    size: Array
    covariance: Array
    log_odds: float
    grade: float
    ahead: float
    began: float
    blocks: int
    level: float

    @property
    def is_certain(self) -> bool:
        """True if something has changed."""
        return self.log_odds > 0.0

    @property
    def is_decided(self) -> bool:
        """True if it is known what has changed."""
        return self.ahead > BELIEVED and self.blocks >= LEAST_BLOCKS


class Onsets:
    """Answers of a filter to changes that may have begun at several times, k unknowns each.

    began: (n,) times. shift: (STATES, n k) effect on the mean of the filter; what the filter does
    not know of, it shows as a negative shift. information: (n, k, k) on the unknowns, and score (n,
    k).
    """

    def __init__(self, unknowns: int) -> None:
        k = self._unknowns = unknowns
        self.began = np.zeros(0)
        self.shift = np.zeros((STATES, 0))
        self.information, self.score = np.zeros((0, k, k)), np.zeros((0, k))

    def begin(self, t: float, effect: Array, most: int, kept: float = math.nan) -> bool:
        """Begin an onset at t with an effect (STATES, k) that the filter does not know of.

        most: number of onsets. Of more, the oldest one goes, or the next one if the oldest began at
        `kept`. Returns whether one has gone.
        """
        k, is_full = self._unknowns, len(self.began) == most
        if is_full:
            gone = int(self.began[0] == kept)
            self.began = np.delete(self.began, gone)
            self.shift = np.delete(self.shift, slice(gone * k, (gone + 1) * k), axis=1)
            self.information = np.delete(self.information, gone, axis=0)
            self.score = np.delete(self.score, gone, axis=0)
        self.began = np.append(self.began, t)
        self.shift = np.hstack([self.shift, -effect])
        self.information = np.concatenate([self.information, np.zeros((1, k, k))])
        self.score = np.concatenate([self.score, np.zeros((1, k))])
        return is_full

    def add_answers(self, answers: Array, both: Array) -> None:
        """Take the whitened answers (m, n k) of m innovations to the unknowns.

        both: (1 + STATES, n k) products of the answers with the innovations, and with the rows by
        which these correct the mean.
        """
        n, k = len(self.began), self._unknowns
        by_onset = answers.reshape(-1, n, k).transpose(1, 0, 2)
        self.information += by_onset.transpose(0, 2, 1) @ by_onset
        self.score += both[0].reshape(n, k)
        self.shift += both[1:]


class _Fit(NamedTuple):
    """Fit of a hypothesis to n onsets, k unknowns: log (n,) of the likelihood ratio, size (n, k),
    information (n, k, k).
    """

    log: Array
    size: Array
    information: Array


def _fitted(onsets: Onsets, one: ChangeHypothesis, columns: slice) -> _Fit:
    """Fit a hypothesis, whose unknowns are these of an onset. A tilt is fitted twice, the second
    time with its second order.
    """
    weight = one.std**-2
    known = onsets.information[:, columns, columns] + np.diag(weight)
    score, expected = onsets.score[:, columns], np.zeros((len(known), len(weight)))
    size = solved(known, score[:, :, None])[..., 0]
    if one.tilts:
        expected[:, -1] = -0.5 * GRAVITY * np.square(size[:, :2]).sum(axis=1)
        score = score + weight * expected
        size = solved(known, score[:, :, None])[..., 0]
    log = 0.5 * ((size * score).sum(axis=1) - np.square(expected) @ weight)
    log += math.log(one.chance) - 0.5 * np.linalg.slogdet(known * one.std[:, None] ** 2)[1]
    return _Fit(log, size, known)


def likeliest_change(
    onsets: Onsets, now: float, a_block: float, log_onsets: float, level: float
) -> SuddenChange:
    """Return the most likely change.

    now, a_block: in the unit of the onsets' times. log_onsets: log of the number of onsets in which
    one false alarm may come. level: upward force so far [m/s^2].
    """
    fits, first = [], 0
    for one in HYPOTHESES:
        end = first + len(one.std)
        fits.append(_fitted(onsets, one, slice(first, end)))
        first = end
    logs = [fit.log for fit in fits]
    turned, stepped = np.logaddexp.reduce([*logs[0], *logs[1]]), np.logaddexp.reduce(logs[2])
    grade = np.logaddexp.reduce(logs[3])
    is_turn = bool(turned > stepped)
    which = 2 if not is_turn else int(logs[1].max() > logs[0].max())
    k = int(logs[which].argmax())
    return SuddenChange(
        is_turn,
        fits[which].size[k, :3],
        np.linalg.inv(fits[which].information[k])[:3, :3],
        float(np.logaddexp(turned, stepped) - np.logaddexp(log_onsets, grade)),
        float(grade),
        float(abs(turned - stepped)),
        float(onsets.began[k]),
        round((now - float(onsets.began[k])) / a_block),
        level,
    )
