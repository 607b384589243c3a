"""Create the estimator of a configuration."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from imucald.config import Config
from imucald.config.calibration import KnownMount
from imucald.config.signals import Signals
from imucald.core.errors import EstimateError
from imucald.core.rotations import rotation_from_angles
from imucald.mount.estimate import BETWEEN_DRIVES_STD, MountEstimator, MountState, Targets
from imucald.mount.estimator import JointEstimator
from imucald.mount.estimator_settings import DelayPrior, EstimatorSettings
from imucald.mount.mirror import DOUBTED, SIDED, probability
from imucald.mount.stated_orientation import StatedOrientation

if TYPE_CHECKING:
    from imucald.model_compensation import ModelCompensation
    from imucald.mount.method_a.settings import PublishedSettings
    from imucald.mount.restored import StoredMount

CONFIGURED_DELAY_STD = 0.03
"""Standard deviation of a configured delay [s]."""


def estimator_for(
    config: Config,
    compensation: ModelCompensation | None = None,
    stated: Collection[str] = (),
) -> MountEstimator:
    """Return the estimator for a configuration. If the configuration states a mount, the estimator
    starts with this mount. Raises EstimateError if the stated mount is too uncertain. See
    `learning_estimator`.
    """
    learning = learning_estimator(config, compensation, stated)
    if (mount := config.calibration.mount) is None:
        return learning
    from imucald.mount.restored import RestoredEstimator  # noqa: PLC0415 - few state one

    stored = known_mount(mount, learning.estimate().targets)
    return RestoredEstimator(learning, stored, is_held=mount.hold, by_configuration=mount.hold)


def learning_estimator(
    config: Config,
    compensation: ModelCompensation | None = None,
    stated: Collection[str] = (),
) -> MountEstimator:
    """Return the estimator that finds the mount, with the settings of a configuration and the
    knowledge of its model file.

    If the configuration has neither a speed nor a turn rate, the estimator is method A. stated:
    keys of `vehicle` in the configuration file; the model file does not override these keys.
    """
    if config.uses_method_a:
        from imucald.mount.method_a.estimator import PublishedEstimator  # noqa: PLC0415 - few use it

        published = published_settings(config)
        if compensation is not None:
            published = compensation.published_settings(published, stated)
        return PublishedEstimator(published)
    settings = joint_settings(config)
    if compensation is not None:
        settings = compensation.joint_settings(settings, stated)
    return JointEstimator(settings)


FINEST_STATED = math.radians(0.01)
"""Smallest accepted deviation of a stated mount [rad]: a tenth of the accuracy of a workshop. With
a smaller deviation, no evidence could ever change the mount.
"""


def known_mount(mount: KnownMount, targets: Targets | None) -> StoredMount:
    """Convert a mount that a person states to the form that an estimator uses. Raises EstimateError
    if its deviations are too large for *usable* (`targets`) or smaller than `FINEST_STATED`.
    """
    from imucald.mount.restored import StoredMount  # noqa: PLC0415 - few state one

    std, state = np.array(mount.std), MountState.USABLE
    if (finest := std.min()) < FINEST_STATED:
        text = f"{math.degrees(finest):.3g} deg is too small for any mount: it must be "
        raise EstimateError(f"{text}{math.degrees(FINEST_STATED):g} deg or more")
    if targets is not None:
        for s, limit, axis in zip(std, targets.usable, "xyz", strict=True):
            if s >= limit:
                text = f"{math.degrees(s):.3g} deg about {axis} is too uncertain for a usable mount"
                most = math.degrees(limit)
                better = f"it must be below {most:.3g} deg (±{2.0 * most:.3g} deg at 95 %)"
                raise EstimateError(f"{text}: {better}, or let the daemon find the mount")
        if (np.hypot(std, BETWEEN_DRIVES_STD) < targets.fine).all():
            state = MountState.FINE
    R = rotation_from_angles(mount.roll, mount.pitch, mount.yaw)
    return StoredMount(R, np.diag(std**2), state, is_given=True)


def against_orientation(mount: KnownMount | None, config: Config) -> str | None:
    """Return a text about the contradiction between a stated mount and `orientation`; None if they
    agree."""
    if mount is None or config.uses_method_a:  # that does not read `orientation`
        return None
    calibration = config.calibration
    R = rotation_from_angles(mount.roll, mount.pitch, mount.yaw)
    key = StatedOrientation(calibration.orientation).contradicted(R, yaw_known=True)
    if key is None:
        return None
    axis = calibration.orientation.up if key == "up" else calibration.orientation.forward
    other = "down" if key == "up" else "back"
    return f"turns {axis} {other}, but 'orientation' says {key}: {axis}; correct one of them"


def published_settings(config: Config) -> PublishedSettings:
    """Return the settings of method A."""
    from imucald.mount.method_a.settings import PublishedSettings  # noqa: PLC0415 - few use it

    signals = config.signals
    return PublishedSettings(
        config.calibration,
        config.vehicle,
        planar=signals.accelerometer[0].z is None,
        use_speed=signals.speed is not None or signals.wheel_speeds is not None,
    )


def _are_sides_turned(signals: Signals) -> bool:
    """Return whether the signs of signals that distinguish left from right are inverted while the
    accelerometer's signs are not. In this case the accelerometer may be mirrored instead.
    """
    accelerometer, gyroscope = signals.accelerometer[0], signals.gyroscope
    if accelerometer.x.sign < 0 or accelerometer.y.sign < 0:
        return False
    turned = {}
    if gyroscope is not None:
        turned["gyroscope"] = gyroscope[0].x.sign < 0 and gyroscope[0].y.sign < 0
    for name in SIDED:
        sources = getattr(signals, name)
        if sources is not None and sources[0].sign_signal is None:
            turned[name] = sources[0].sign < 0
    return any(turned.get(name) for name in SIDED) and probability(turned) >= DOUBTED


def joint_settings(config: Config) -> EstimatorSettings:
    """Return the settings of the joint estimator."""
    settings = EstimatorSettings(
        config.calibration,
        config.vehicle,
        uses_steering=config.signals.steering_wheel_angle is not None,
        are_sides_turned=_are_sides_turned(config.signals),
    )
    delay = config.calibration.speed_delay
    if delay is None:
        return settings
    stated = DelayPrior(delay, CONFIGURED_DELAY_STD)
    return replace(settings, delays={**settings.delays, "speed": stated})
