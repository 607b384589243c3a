"""Errors that several sources of evidence share and that the data cannot show."""

from __future__ import annotations

import math

from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.fusion import CommonError
from imucald.mount.priors import BIAS_FLOOR_STD, PITCHING_STD, SIDESLIP_STD, YAW_FLOOR_STD


def common_errors(settings: EstimatorSettings) -> tuple[CommonError, ...]:
    """Return the errors of the sensor itself that the spread of the data cannot show.

    Scale errors s of a sensor that is turned against the vehicle act as a symmetric cross-axis
    error of s / sqrt(5) (mean over all mounts). Such an error has opposite signs in e_z from dv/dt
    and in e_z from v r. In e_y it has opposite signs from dv/dt and from gravity, where it acts as
    a bias.
    """
    scale = settings.accel_scale_std / math.sqrt(5.0)
    cross = settings.calibration.cross_axis
    return (
        CommonError(scale, {"yaw_dvdt": 1.0, "yaw_turn": -1.0}),
        CommonError(SIDESLIP_STD, {"yaw_turn": 1.0}),
        CommonError(YAW_FLOOR_STD, {"yaw_dvdt": 1.0, "yaw_turn": 1.0}),
        CommonError(scale, {"pitch_dvdt": 1.0}),
        CommonError(scale, {"roll_turn": 1.0}),
        CommonError(cross, {"yaw_dvdt": 1.0}),
        CommonError(cross, {"yaw_turn": 1.0}),
        CommonError(cross, {"pitch_dvdt": 1.0}),
        CommonError(cross, {"roll_turn": 1.0}),
        CommonError(0.5 * cross, {"pitch_gravity": 1.0}),
        CommonError(0.5 * cross, {"roll_gravity": 1.0}),
        CommonError(PITCHING_STD, {"pitch_dvdt": 1.0}),
        CommonError(settings.gyro_misalignment_std, {"roll_axis": 1.0}),
        CommonError(settings.gyro_misalignment_std, {"pitch_axis": 1.0}),
        CommonError(BIAS_FLOOR_STD, {"roll_gravity": 1.0}),
        CommonError(BIAS_FLOOR_STD, {"pitch_gravity": 1.0}),
    )


GRAVITY_SHARE = 0.2
"""Share of a cross-axis error that gravity shows in the long run.

For gravity the error is a bias, which turns separate from tilt (`gravity_observer`). Simulated
drives of 6 to 20 min with 4 % gave 0.1 to 0.2.
"""


def cross_axis_errors() -> tuple[CommonError, ...]:
    """Return the effect on each source of cross-axis errors with an rms of one (part)."""
    whole = ("yaw_dvdt", "yaw_turn", "pitch_dvdt", "roll_turn")
    gravity = ("pitch_gravity", "roll_gravity")
    return (
        *(CommonError(1.0, {name: 1.0}) for name in whole),
        *(CommonError(GRAVITY_SHARE, {name: 1.0}) for name in gravity),
    )
