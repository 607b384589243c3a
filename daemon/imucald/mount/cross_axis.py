"""Fusing sources whose accelerometer has a cross-axis error: configured, or found while driving.

A configured one is among the errors that sources share. Else candidates from `priors` are weighed
by how far sources contradict one another, by the size of gravity, and by what looks like a bias.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.mount.common_errors import common_errors, cross_axis_errors
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.fusion import CERTAIN, CommonCovariance, Fused, fuse, fuse_weighing
from imucald.mount.priors import BIAS_DRIFT_STD, CROSS_AXIS
from imucald.mount.road_segments import AngleEvidence

Array = NDArray[np.float64]

SEEN_SHARE = 1.0
"""From as much information as the prior's on what the data say of a bias is looked at."""


class CrossAxisFusion:
    """Fuses, and keeps what it found of the cross-axis error.

    bias_spread: standard deviation of the accelerometer's bias before any data [m/s^2]. scales:
    cross-axis errors that are not among the shared ones (part), with their probabilities.
    """

    def __init__(self, settings: EstimatorSettings) -> None:
        calibration = settings.calibration
        self._sharing = CommonCovariance(common_errors(settings), cross_axis_errors())
        self._configured = calibration.cross_axis
        self.scales = CERTAIN if self._configured > 0.0 else CROSS_AXIS
        self.bias_spread = math.sqrt(
            calibration.accelerometer_bias**2
            + BIAS_DRIFT_STD**2
            + (GRAVITY * self._configured) ** 2
        )

    @property
    def probable(self) -> float:
        """Cross-axis error beside the configured one (part, rms)."""
        return math.sqrt(math.fsum(p * scale * scale for scale, p in self.scales))

    @property
    def std(self) -> float:
        """Cross-axis error that is reckoned with (part): configured, or probable."""
        return math.hypot(self._configured, self.probable)

    def fused(
        self,
        sources: Mapping[str, AngleEvidence],
        R: Matrix3,
        mean_force: Array,
        bias: Array,
        bias_cov: Array,
    ) -> Fused:
        """Fuse the sources of the error of R (3, 3).

        mean_force: (3,) of the drive; bias: (3,) of the accelerometer, bias_cov: (3, 3) its
        covariance; all in sensor axes, SI.
        """
        if self._configured > 0.0:
            return fuse(sources, self._sharing, self.scales)
        size = float(np.linalg.norm(mean_force)) / GRAVITY - 1.0
        as_bias = self._seen_as_bias((R @ bias).tolist(), R @ bias_cov @ R.T)
        seen = [(size, self.bias_spread / GRAVITY), *as_bias]
        fused, self.scales = fuse_weighing(sources, self._sharing, CROSS_AXIS, seen)
        return fused

    def _seen_as_bias(self, values: list[float], covariance: Array) -> list[tuple[float, float]]:
        """Level parts of the bias over g, with their deviations: cross-axis errors of gravity
        come out as one. What the prior has drawn them to zero by is taken back."""
        spread, found = self.bias_spread, []
        for value, variance in zip(values[:2], np.diag(covariance).tolist()[:2], strict=True):
            data = 1.0 / variance - 1.0 / (spread * spread)
            if data > SEEN_SHARE / (spread * spread):
                own = math.hypot(spread, math.sqrt(1.0 / data))
                found.append((value / (variance * data) / GRAVITY, own / GRAVITY))
        return found
