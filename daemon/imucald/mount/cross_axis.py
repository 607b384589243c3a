"""Fuse sources when the accelerometer has a cross-axis error, configured or found while driving.

A configured cross-axis error is one of the errors that sources share. Without a configured error,
the error is estimated. Let E be the six terms in sensor axes and C = R E R^T the terms in the
vehicle's axes. The force is then (1 + C) f, and each source shows one entry of C in addition to its
angle:

    yaw from dv/dt -C_yx, yaw from turns +C_xy, pitch from dv/dt +C_zx, roll from turns -C_zy,
    level parts of gravity C_xz, C_yz (they look mostly like a bias and are subtracted with it).

C_xx and C_yy change the response to dv/dt and to turns, and C_zz changes the size of gravity. The
terms are independent and share one unknown rms. Three of the six combinations are symmetric and
show only as contradictions. Two combinations turn the force against the gyroscope's axis of
turning. The sixth turns all forces about the vertical: it looks like yaw and shows in no
contradiction. The rms of the other five limits the size of the sixth. Five values are few, so the
prior on the rms is even in its logarithm: half or twice the rms of the data is about as probable.
With this prior the interval is Student's (Box and Tiao, Bayesian Inference in Statistical Analysis,
1973, ch. 2).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from msgspec import Struct

from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.mount.common_errors import common_errors
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.fusion import (
    CERTAIN,
    CommonCovariance,
    Fused,
    Seen,
    fuse,
    weighed_scales,
)
from imucald.mount.priors import (
    BIAS_DRIFT_STD,
    CROSS_AXIS,
    GAIN_STD,
    GYRO_MISALIGNMENT_STD,
    SPEED_SCALE_STD,
)
from imucald.mount.road_segments import AngleEvidence

SEEN_SHARE = 1.0
"""Ratio of the data's information on a bias to the prior's, from which the data are used."""
SHOWN = {
    "yaw_dvdt": (-1.0, 1, 0),
    "yaw_turn": (1.0, 0, 1),
    "pitch_dvdt": (1.0, 2, 0),
    "roll_turn": (-1.0, 2, 1),
    "roll_gravity": (1.0, 1, 2),
    "pitch_gravity": (-1.0, 0, 2),
}
"""For each source, the entry of C that it shows and the sign.

Sources from axes of rotation show no entry.
"""
_OFF_ROW, _OFF_COLUMN = np.nonzero(~np.eye(3, dtype=bool))


class ForceSeen(Struct, frozen=True):
    """Results from the force besides the sources of angles; sensor axes, SI.

    mean: (3,) mean force of the drive. bias: (3,) of the accelerometer, bias_cov: (3, 3). gains: of
    the response to dv/dt and to turns. They are None without a gyroscope, because the lean of the
    body is then not removed. responses: sources from the responses, before their variances are
    widened. turning: difference between roll from turns and roll from the axis of turns. Both
    contain the same pitch rate of the road.
    """

    mean: Array
    bias: Array
    bias_cov: Array
    gains: tuple[float, float] | None
    responses: Mapping[str, AngleEvidence]
    turning: AngleEvidence | None = None


class CrossAxisFusion:
    """Fuses the sources, and keeps the cross-axis error that it found.

    bias_spread: standard deviation of the accelerometer's bias before any data [m/s^2]. scales:
    sizes of cross-axis errors (part) that are not among the shared errors, with their
    probabilities. probable: their rms. answers: responses (6,) of the sources that were fused last
    to the six terms.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        calibration = settings.calibration
        self._sharing = CommonCovariance(common_errors(settings))
        self._scale_std = settings.accel_scale_std
        self._configured = calibration.cross_axis
        self._take(CERTAIN if self._configured > 0.0 else CROSS_AXIS)
        self.answers: Mapping[str, Array] = {}
        self.bias_spread = math.sqrt(
            calibration.accelerometer_bias**2
            + BIAS_DRIFT_STD**2
            + (GRAVITY * self._configured) ** 2
        )

    def _take(self, scales: Sequence[tuple[float, float]]) -> None:
        self.scales = scales
        self.probable = math.sqrt(math.fsum(p * scale * scale for scale, p in scales))

    @property
    def std(self) -> float:
        """Cross-axis error that is assumed (part): the configured or the probable one."""
        return math.hypot(self._configured, self.probable)

    def fused(self, sources: Mapping[str, AngleEvidence], R: Matrix3, force: ForceSeen) -> Fused:
        """Fuse the sources of the error of R (3, 3)."""
        if self._configured > 0.0:
            return fuse(sources, self._sharing)
        entries = R[:, None, _OFF_ROW] * R[None, :, _OFF_COLUMN]
        bias_cov = R @ force.bias_cov @ R.T
        left = bias_cov.diagonal() / (self.bias_spread * self.bias_spread)
        self.answers = _answers(sources, entries, left.tolist())
        seen = self._seen(entries, R @ force.bias, bias_cov, force)
        self._take(weighed_scales(sources, self._sharing, CROSS_AXIS, self.answers, seen))
        return fuse(sources, self._sharing, self.scales, self.answers)

    def _seen(self, entries: Array, bias: Array, bias_cov: Array, force: ForceSeen) -> Seen:
        """Return size of gravity, level bias, gains of motion, and the difference of turns from
        their own axis.
        """
        spread, known = self.bias_spread / GRAVITY, force.responses
        scale2 = self._scale_std * self._scale_std
        rows = [(math.sqrt(float(force.mean @ force.mean)) / GRAVITY - 1.0, spread**2 + scale2)]
        answers = [entries[2, 2]]
        for i, (value, variance) in enumerate(
            zip(bias[:2].tolist(), bias_cov.diagonal().tolist()[:2], strict=True)
        ):
            # what the prior has drawn the bias to zero by is taken back
            data = 1.0 / variance - 1.0 / self.bias_spread**2
            if data > SEEN_SHARE / self.bias_spread**2:
                own = spread**2 + 1.0 / (data * GRAVITY**2)
                rows.append((value / (variance * data) / GRAVITY, own))
                answers.append(entries[i, 2])
        if force.turning is not None:
            own = force.turning.variance + scale2 + GYRO_MISALIGNMENT_STD**2
            rows.append((force.turning.value, own))
            answers.append(-entries[2, 1])
        has_gains = force.gains is not None and {"yaw_dvdt", "yaw_turn"} <= known.keys()
        if force.gains is not None and has_gains:
            for i, name in enumerate(("yaw_dvdt", "yaw_turn")):
                rows.append((force.gains[i] - 1.0, GAIN_STD**2 + known[name].variance))
                answers.append(entries[i, i])
        values, variances = np.array(rows).T
        covariance = np.diag(variances)
        if has_gains:
            covariance[-2:, -2:] += SPEED_SCALE_STD * SPEED_SCALE_STD
        return Seen(values, covariance, np.array(answers))


def _answers(
    sources: Mapping[str, AngleEvidence], entries: Array, left: list[float]
) -> dict[str, Array]:
    """Return the response of each source (6,) to the six terms.

    left: share of the level parts of gravity that remains after the fit of a bias.
    """
    found = {}
    for name in sources:
        if name in SHOWN:
            sign, row, column = SHOWN[name]
            found[name] = sign * (left[row] if column == 2 else 1.0) * entries[row, column]
        else:
            found[name] = np.zeros(len(entries[0, 0]))
    return found
