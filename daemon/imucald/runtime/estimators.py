"""Configuration -> estimator."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

from imucald.config import Config, Vehicle
from imucald.mount.estimate import MountEstimator
from imucald.mount.estimator import FullEstimator
from imucald.mount.estimator_settings import DelayPrior, EstimatorSettings
from imucald.mount.method_a.estimator import PublishedEstimator
from imucald.mount.method_a.settings import PublishedSettings

if TYPE_CHECKING:
    from imucald.compensation import Compensation

CONFIGURED_DELAY_STD = 0.03
"""How well a configured delay is taken to be known [s]."""
_KERB = {"right": 1.0, "left": -1.0, "unknown": 0.0}
"""Sign of the roll that a road's crown gives a vehicle that keeps to this side."""


def estimator_for(config: Config, compensation: Compensation | None = None) -> MountEstimator:
    """Return the estimator that a configuration asks for, with what its model knows."""
    if config.calibration.estimator == "published":
        published = published_settings(config)
        if compensation is not None:
            side = config.vehicle.driving_side
            published = compensation.published_settings(published, side, _stated(config.vehicle))
        return PublishedEstimator(published)
    full = full_settings(config)
    if compensation is not None:
        full = compensation.full_settings(full, _stated(config.vehicle))
    return FullEstimator(full)


def _stated(vehicle: Vehicle) -> frozenset[str]:
    """Keys that the configuration says otherwise than the presets: no model overrules them."""
    presets = Vehicle()
    keys = Vehicle.__struct_fields__
    return frozenset(k for k in keys if getattr(vehicle, k) != getattr(presets, k))


def _is_planar(config: Config) -> bool:
    return config.signals.accelerometer[0].z is None


def published_settings(config: Config) -> PublishedSettings:
    """Settings of method A."""
    calibration = config.calibration
    static, straight, target = calibration.static, calibration.straight, calibration.target_angle
    vehicle = config.vehicle
    presets = PublishedSettings()
    states = calibration.states
    return replace(
        presets,
        static=replace(
            presets.static,
            count=static.samples,
            seconds=static.duration,
            thresholds=static.threshold,
            thresholds_at_zero_speed=static.threshold_at_zero_speed,
        ),
        standstill_speed=static.standstill_speed,
        average_stops=static.average_stops,
        accel_bias_std=calibration.accelerometer_bias,
        accel_range=calibration.accelerometer_range or math.inf,
        crown=_KERB[vehicle.driving_side] * vehicle.crown_percent / 100.0,
        crown_std=_crown_std(vehicle),
        planar=_is_planar(config),
        recognisers=straight.recognise_by,
        yaw_rate_limit=math.radians(straight.yaw_rate_limit_deg_s),
        yaw_rate_limit_without_speed=math.radians(straight.yaw_rate_limit_without_speed_deg_s),
        steering_limit=math.radians(straight.steering_limit_deg),
        steering_ratio=vehicle.steering_ratio,
        wheelbase=vehicle.wheelbase,
        consistency_window=straight.consistency_window,
        consistency_spread=math.radians(straight.consistency_range_deg),
        lateral_limit=straight.lateral_limit,
        min_speed_change=straight.min_speed_change,
        manoeuvre_peak=straight.manoeuvre_peak,
        min_speed=straight.min_speed,
        sign_sources=target.sign_from,
        subtract_lateral=target.subtract_lateral,
        remove_offset_after=target.remove_offset_after,
        speed_delay=calibration.speed_delay or 0.0,
        usable_yaw_std=_limit(states.usable_yaw_deg, presets.usable_yaw_std),
        usable_tilt_std=_limit(states.usable_tilt_deg, presets.usable_tilt_std),
        fine_yaw_std=_limit(states.fine_yaw_deg, presets.fine_yaw_std),
        fine_tilt_std=_limit(states.fine_tilt_deg, presets.fine_tilt_std),
    )


def full_settings(config: Config) -> EstimatorSettings:
    """Settings of the full estimator."""
    calibration, vehicle = config.calibration, config.vehicle
    defaults = EstimatorSettings()
    delays = dict(defaults.delays)
    if calibration.speed_delay is not None:
        delays["speed"] = DelayPrior(calibration.speed_delay, CONFIGURED_DELAY_STD)
    states = calibration.states
    return replace(
        defaults,
        accel_bias_std=calibration.accelerometer_bias,
        driving_side={"left": "left", "right": "right"}.get(vehicle.driving_side, "none"),
        crown_mean=vehicle.crown_percent / 100.0,
        crown_std=_crown_std(vehicle),
        accel_cross_axis_std=calibration.cross_axis,
        accel_range=calibration.accelerometer_range or math.inf,
        delays=delays,
        steering_ratio=vehicle.steering_ratio if config.signals.steering_wheel_angle else None,
        wheelbase=vehicle.wheelbase,
        track=vehicle.track,
        usable_std=_limit(states.usable_yaw_deg, defaults.usable_std),
        usable_tilt_std=_limit(states.usable_tilt_deg, defaults.usable_tilt_std),
        fine_std=_limit(states.fine_yaw_deg, defaults.fine_std),
        fine_tilt_std=_limit(states.fine_tilt_deg, defaults.fine_tilt_std),
    )


def _limit(given_deg: float | None, preset: float) -> float:
    """A standard deviation [rad]: the configured one, else the estimator's own."""
    return preset if given_deg is None else math.radians(given_deg)


def _crown_std(vehicle: Vehicle) -> float:
    """Spread of the road's lean (tangent): where the side is not known, its mean is in it too."""
    mean, spread = vehicle.crown_percent / 100.0, vehicle.crown_spread_percent / 100.0
    return spread if vehicle.driving_side != "unknown" else math.hypot(mean, spread)
