"""Configuration -> estimator."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import TYPE_CHECKING

from imucald.config import Config
from imucald.mount.estimate import MountEstimator
from imucald.mount.estimator import FullEstimator
from imucald.mount.estimator_settings import DelayPrior, EstimatorSettings

if TYPE_CHECKING:
    from imucald.model_compensation import ModelCompensation
    from imucald.mount.method_a.settings import PublishedSettings

CONFIGURED_DELAY_STD = 0.03
"""How well a configured delay is taken to be known [s]."""


def estimator_for(
    config: Config,
    compensation: ModelCompensation | None = None,
    stated: Collection[str] = (),
) -> MountEstimator:
    """Return the estimator that a configuration asks for, with what its model knows.

    stated: keys of `vehicle` that stand in the file, which no model overrules.
    """
    if config.calibration.estimator == "published":
        from imucald.mount.method_a.estimator import PublishedEstimator  # noqa: PLC0415 - few use it

        published = published_settings(config)
        if compensation is not None:
            published = compensation.published_settings(published, stated)
        return PublishedEstimator(published)
    full = full_settings(config)
    if compensation is not None:
        full = compensation.full_settings(full, stated)
    return FullEstimator(full)


def published_settings(config: Config) -> PublishedSettings:
    """Settings of method A."""
    from imucald.mount.method_a.settings import PublishedSettings  # noqa: PLC0415 - few use it

    signals = config.signals
    return PublishedSettings(
        config.calibration,
        config.vehicle,
        planar=signals.accelerometer[0].z is None,
        use_speed=signals.speed is not None or signals.wheel_speeds is not None,
    )


def full_settings(config: Config) -> EstimatorSettings:
    """Settings of the full estimator."""
    settings = EstimatorSettings(
        config.calibration,
        config.vehicle,
        uses_steering=config.signals.steering_wheel_angle is not None,
    )
    delay = config.calibration.speed_delay
    if delay is None:
        return settings
    stated = DelayPrior(delay, CONFIGURED_DELAY_STD)
    return replace(settings, delays={**settings.delays, "speed": stated})
