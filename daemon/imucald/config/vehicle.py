"""Settings of the vehicle and of its model file."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from msgspec import Meta

from imucald.config.base import Part, Settings
from imucald.core import default_vehicle


class ModelFile(Settings, frozen=True):
    """Model file of the vehicle: the sensor errors that it states are removed from the signals."""

    path: str
    """Path of the model file, relative to the configuration file."""
    compensate_suspension: bool = True
    """True: the effects of squat, dive and roll of the body are removed from the corrected
    signals."""


class VehicleSettings(Settings, frozen=True):
    """Known properties of the vehicle."""

    id: Annotated[str, Meta(max_length=64)] = "vehicle"
    """Identity of the vehicle. A saved state is used only for the vehicle with the same
    identity."""
    driving_side: Literal["left", "right", "unknown"] = "unknown"
    """Side of the road on which the vehicle drives. The crown of the road leans the vehicle towards
    the kerb."""
    crown_percent: Annotated[float, Meta(ge=0, le=5)] = 1.2
    """Mean cross slope of the roads, towards the kerb [%]."""
    crown_spread_percent: Annotated[float, Meta(gt=0, le=5)] = 0.65
    """Spread of the mean cross slope from drive to drive [%]."""
    wheelbase: Annotated[float, Meta(ge=0.5, le=15)] = default_vehicle.WHEELBASE
    """Wheelbase [m]. With the wheelbase, the yaw rate is computed from the steering angle if there
    is no other signal for the yaw rate."""
    steering_ratio: Annotated[float, Meta(ge=1, le=100)] = default_vehicle.STEERING_RATIO
    """Ratio of steering-wheel angle to road-wheel angle."""
    track: Annotated[float, Meta(ge=0.5, le=5)] = default_vehicle.TRACK
    """Distance between left and right wheels [m]."""

    crown_mean = Part("crown_percent")
    crown_spread = Part("crown_spread_percent")

    @property
    def kerb(self) -> float:
        """Sign of the roll of this vehicle on a crowned road; 0 if the driving side is unknown."""
        return {"right": 1.0, "left": -1.0}.get(self.driving_side, 0.0)

    @property
    def crown_std(self) -> float:
        """Spread of the roll from the crown [rad]. If the driving side is unknown, the spread
        includes the mean roll."""
        spread = self.crown_spread
        return spread if self.kerb else math.hypot(self.crown_mean, spread)
