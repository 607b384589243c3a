"""Hypotheses of a sudden change: the sensor was turned, or a zero error of the accelerometer
jumped.

The Kalman filter of `drift` models a sensor without faults in a fixed mount. Each hypothesis adds a
change of known direction and unknown size to the state of the filter at an onset. The innovations
are linear in the size of the change. The likelihood ratio of each onset is therefore known in
closed form (Willsky and Jones, IEEE Trans. Automatic Control 21, 1976). The ratios are summed over
the onsets as in `drift`.

A small rotation phi of the sensor changes the vertical u and its mean by u x phi. The rotation also
changes the force f of a motion by f x phi. There are two hypotheses of a rotation. In the first
hypothesis, the gyroscope measured the rotation, so the filter has already rotated the vertical. In
the second hypothesis, the gyroscope did not measure the rotation. A jump of a zero error changes
only the force. In bends, a rotation differs from a jump: after a rotation, the vertical turns about
the axis that the gyroscope measures. The start of a long grade changes the mean of the vertical and
is no fault. If a grade explains the data as well as a change, the change is not certain.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from imucald.core.arrays import Array, solved
from imucald.core.samples import GRAVITY

UP, RATE_ZERO, GYRO, TILT = slice(0, 2), slice(2, 5), slice(5, 7), slice(7, 9)
MOTIONS = 6
"""Number of motions to which the force responds: dv/dt, v r, dr/dt, r^2, (v r)^2, d(v r)/dt."""
ZERO, ANSWER = slice(9, 12), slice(12, 12 + 3 * MOTIONS)
UPWARD = slice(ZERO.stop - 1, ZERO.stop)
STATES = ANSWER.stop
"""Number of states of the filter, see `drift`."""
MOST_ONSETS = 10
"""Number of onsets that are tested: the starts of the last blocks (64 s). If the cause of a change
is not decided, the onset of this change is kept longer.
"""
BELIEVED: Final = math.log(1000.0)
"""Logarithm of the odds from which one cause counts as decided.

The limit is high because the model is not exact: the model assumes a small rotation and a level
road. The correction of a wrong decision takes minutes of driving.
"""
LEAST_BLOCKS = 3
"""Smallest number of blocks after the onset for a decision about the cause. The change may be at
the end of the first block.
"""
TURNED_STD, ZERO_STD = 0.1, 0.5
"""Prior standard deviations of a rotation about each axis [rad], and of a jump of each zero error
[m/s^2].

Most rotations by hand are some degrees. A jump of more than some tens of mg is a fault.
"""
SECOND_ORDER = 0.05
"""Prior standard deviation of the change of the upward force by a rotation or a grade [m/s^2].

The mean of this change is the second-order term -g (x^2 + y^2) / 2. The slope before the change
adds to the change.
"""


def _turned(is_felt: bool) -> Array:
    """Return the effect (STATES, 4) on the state of a rotation about x, y and z, and of the
    second-order term of the rotation.

    is_felt: the gyroscope measured the rotation, so the filter has already rotated the vertical.
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
    """Return the effect on the state if each element of `part` changes by its own unknown."""
    return np.eye(STATES)[:, part]


class ChangeHypothesis(NamedTuple):
    """Hypothesis of a change with k unknowns.

    effect: (STATES, k) effect of the unknowns on the state. std: (k,) prior standard deviations of
    the unknowns. chance: probability of this hypothesis if a change has happened. tilts: the first
    two unknowns tilt the vertical, and the last unknown is the second-order term of this tilt.
    """

    effect: Array
    std: Array
    chance: float
    tilts: bool = True


_TURNED_STDS: Final = np.array([TURNED_STD] * 3 + [SECOND_ORDER])
HYPOTHESES: Final = (
    ChangeHypothesis(_turned(is_felt=False), _TURNED_STDS, 0.25),
    ChangeHypothesis(_turned(is_felt=True), _TURNED_STDS, 0.25),
    ChangeHypothesis(_unit(ZERO), np.full(3, ZERO_STD), 0.5, tilts=False),
    ChangeHypothesis(
        np.hstack([_unit(TILT), _unit(UPWARD)]), np.array([0.05, 0.03, SECOND_ORDER]), 1.0
    ),
)
"""Hypotheses: a turn that the gyroscope did not measure, a turn that it measured, a jump of a zero
error, and a long grade or superelevation of the road.

A grade of 10 % is a steep mountain road, and a superelevation of 6 % is steep. These values are two
standard deviations of the prior.
"""
EFFECT: Final = np.hstack([one.effect for one in HYPOTHESES])
"""Effect (STATES, 14) on the state, at an onset, of the unknowns of all hypotheses."""


class SuddenChange(NamedTuple):
    """The most likely sudden change.

    is_turn: True: the sensor was turned. False: a zero error jumped. size: (3,) rotation vector of
    the sensor [rad] or change of the zero error [m/s^2], working axes. covariance: (3, 3)
    covariance of `size`. log_odds: logarithm of a ratio. The numerator is the statistic of a sudden
    change. The denominator is the sum of the threshold and the statistic of a long grade. grade:
    logarithm of the statistic of a long grade. ahead: logarithm of the odds of the reported cause
    against the other cause. began: time of the onset. blocks: number of blocks since the onset.
    level: upward force in the state of the filter [m/s^2], about equal to the upward force before
    the change.
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
        """True if a sudden change is certain."""
        return self.log_odds > 0.0

    @property
    def is_decided(self) -> bool:
        """True if the cause of the change is decided."""
        return self.ahead > BELIEVED and self.blocks >= LEAST_BLOCKS


class Onsets:
    """Responses of a filter to changes with k unknowns that may have begun at n onsets.

    began: (n,) times of the onsets. shift: (STATES, n k) error of the filter's mean for each
    unknown of size one. This error starts as minus the effect of the change if the filter does not
    model the change. information: (n, k, k) information about the unknowns. score: (n, k) score of
    the unknowns.
    """

    def __init__(self, unknowns: int) -> None:
        k = self._unknowns = unknowns
        self.began = np.zeros(0)
        self.shift = np.zeros((STATES, 0))
        self.information, self.score = np.zeros((0, k, k)), np.zeros((0, k))

    def begin(self, t: float, effect: Array, most: int, kept: float = math.nan) -> bool:
        """Add an onset at the time t. The filter does not model the effect (STATES, k) of this
        change.

        most: largest number of onsets. If there are more onsets, the oldest onset is deleted. If
        the oldest onset is at the time `kept`, the second oldest onset is deleted instead. Returns
        True if an onset was deleted.
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
        """Add the whitened responses (m, n k) of m innovations to the unknowns.

        both: (1 + STATES, n k) products. Row 0 has the products of the responses with the
        innovations. Each other row belongs to one state and has the products of the responses with
        the gains of this state.
        """
        n, k = len(self.began), self._unknowns
        by_onset = answers.reshape(-1, n, k).transpose(1, 0, 2)
        self.information += by_onset.transpose(0, 2, 1) @ by_onset
        self.score += both[0].reshape(n, k)
        self.shift += both[1:]


class _Fit(NamedTuple):
    """Fit of a hypothesis with k unknowns to n onsets.

    log: (n,) logarithm of the likelihood ratio. size: (n, k) unknowns. information: (n, k, k)
    information about the unknowns.
    """

    log: Array
    size: Array
    information: Array


def _fitted(onsets: Onsets, one: ChangeHypothesis, columns: slice) -> _Fit:
    """Fit a hypothesis to all onsets. A tilt is fitted twice, and the second fit includes the
    second-order term. columns: indices of the hypothesis's unknowns among the unknowns of an onset.
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

    now: present time, in the unit of the onsets' times. a_block: length of a block, in the same
    unit. log_onsets: logarithm of the number of onsets in which one false alarm is allowed. level:
    present upward force in the state of the filter [m/s^2].
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
