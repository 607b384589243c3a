"""Fusing sources whose accelerometer has a cross-axis error: configured, or found while driving.

A configured one is among the errors that sources share. Else it is estimated. With E the six terms
in sensor axes and C = R E R^T in the vehicle's, the force is (1 + C) f, and each source shows one
entry of C next to its angle:

    yaw from dv/dt -C_yx, yaw from turns +C_xy, pitch from dv/dt +C_zx, roll from turns -C_zy,
    level parts of gravity C_xz, C_yz (most of them taken for a bias, and taken off with it),

while C_xx and C_yy change the response to dv/dt and to turns, and C_zz the size of gravity. The
terms are independent, of one unknown rms. Three of their six combinations are symmetric and show
in contradictions alone, two turn the force against the gyroscope's axis of turning; the sixth
turns all forces about the vertical, is taken for yaw, and shows in nothing. How large it may be
follows from the rms that the other five have: few values, so an rms of the data's order of size
is as probable as one of half or twice that (a prior that is even in its logarithm, for which the
interval is Student's; Box and Tiao, Bayesian Inference in Statistical Analysis, 1973, ch. 2).
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
"""From as much information as the prior's on what the data say of a bias is looked at."""
SHOWN = {
    "yaw_dvdt": (-1.0, 1, 0),
    "yaw_turn": (1.0, 0, 1),
    "pitch_dvdt": (1.0, 2, 0),
    "roll_turn": (-1.0, 2, 1),
    "roll_gravity": (1.0, 1, 2),
    "pitch_gravity": (-1.0, 0, 2),
}
"""Of each source the entry of C that it shows, and its sign; axes of rotation show none."""
_OFF_ROW, _OFF_COLUMN = np.nonzero(~np.eye(3, dtype=bool))


class ForceSeen(Struct, frozen=True):
    """What the force has shown besides the sources of angles; sensor axes, SI.

    mean: (3,) of the drive. bias: (3,) of the accelerometer, bias_cov: (3, 3). gains: of the
    response to dv/dt and to turns, None where no gyroscope takes the body's leaning out of them.
    responses: the responses' sources as they are, before any is widened. turning: how far roll from
    turns lies from roll from their axis; both see the same pitch rate of the road.
    """

    mean: Array
    bias: Array
    bias_cov: Array
    gains: tuple[float, float] | None
    responses: Mapping[str, AngleEvidence]
    turning: AngleEvidence | None = None


class CrossAxisFusion:
    """Fuses, and keeps what it found of the cross-axis error.

    bias_spread: standard deviation of the accelerometer's bias before any data [m/s^2]. scales:
    cross-axis errors that are not among the shared ones (part), with their probabilities; probable:
    their rms.
    answers: of the sources that were fused last (6,) to the six terms.
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
        """Cross-axis error that is reckoned with (part): configured, or probable."""
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
        """Gravity's size, level bias, gains of motion, and turns against their own axis."""
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
    """Of each source (6,) to the six terms; left: what the bias leaves of gravity's level parts."""
    found = {}
    for name in sources:
        if name in SHOWN:
            sign, row, column = SHOWN[name]
            found[name] = sign * (left[row] if column == 2 else 1.0) * entries[row, column]
        else:
            found[name] = np.zeros(len(entries[0, 0]))
    return found
