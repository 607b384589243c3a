"""Settings of the estimators from a few keys of the configuration; SI, as the keys are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from imucald.config.calibration import (
    CalibrationSettings,
    StaticTestSettings,
    StraightMotionSettings,
    TargetAngleSettings,
)
from imucald.config.vehicle import VehicleSettings
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.method_a.settings import PublishedSettings

Keys = Mapping[str, Any]
NONE: Keys = {}


def joint_settings(calibration: Keys = NONE, vehicle: Keys = NONE, **own: Any) -> EstimatorSettings:
    """The joint estimator's, on roads whose traffic keeps right."""
    return EstimatorSettings(
        CalibrationSettings(**calibration),
        VehicleSettings(**{"driving_side": "right", **vehicle}),
        **own,
    )


def published(
    calibration: Keys = NONE,
    static: Keys = NONE,
    straight: Keys = NONE,
    target: Keys = NONE,
    vehicle: Keys = NONE,
    **own: Any,
) -> PublishedSettings:
    """Method A's."""
    return PublishedSettings(
        CalibrationSettings(
            static=StaticTestSettings(**static),
            straight=StraightMotionSettings(**straight),
            target_angle=TargetAngleSettings(**target),
            **calibration,
        ),
        VehicleSettings(**vehicle),
        **own,
    )
