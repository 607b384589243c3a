"""Parameters of the sensors and of the CAN bus (sections of the model file).

Every effect is off at its neutral value (0, or `null` where stated). The switches of a section turn
off whole groups and keep the values.
"""

from __future__ import annotations

import math
from typing import Annotated

from msgspec import Meta

from imucald.model.section import (
    ZERO,
    Fraction,
    NonNegative,
    Positive,
    Section,
    Vector3,
)

RateHz = Annotated[float, Meta(ge=0.2, le=1000.0)]
LONGEST_DELAY_S = 2.0
"""Largest delay that a model file may contain [s]."""
REFERENCE_DEGC = 25.0
"""Temperature at which zero errors are stated [degC]."""
BUTTERWORTH_S_HZ = math.sqrt(2.0) / (2.0 * math.pi)
"""Product of delay and cut-off frequency of a second-order Butterworth low-pass, for signals well
below the cut-off."""
DelayS = Annotated[float, Meta(ge=0.0, le=LONGEST_DELAY_S)]


class Gap(Section, frozen=True):
    """An interval of time."""

    start_s: NonNegative
    duration_s: Positive


class Transmission(Section, frozen=True):
    """Timing of a signal's frames. All signals have these parameters."""

    enabled: bool = True
    """False if the vehicle does not have this signal."""
    rate_hz: RateHz = 50.0
    delay_s: DelayS = 0.0
    """Age of the value when its frame is sent [s], in addition to the delay of the low-pass
    filter."""
    jitter_s: NonNegative = 0.0005
    """Mean delay of a frame on the bus [s] (exponentially distributed), from arbitration and task
    scheduling."""
    clock_drift_ppm: float = 0.0
    """Rate error of the sending unit's clock [ppm]."""
    loss: Fraction = 0.0
    """Probability that a frame is lost."""
    dropouts: tuple[Gap, ...] = ()
    """Intervals without frames."""
    stuck: tuple[Gap, ...] = ()
    """Intervals in which the value does not change although frames are sent."""


class TriaxialSensor(Transmission, frozen=True):
    """Three-axis inertial sensor. The unit of the samples is m/s^2 or rad/s."""

    rate_hz: RateHz = 100.0
    jitter_s: NonNegative = 0.0003
    noise_density: NonNegative = 0.0
    """Density of one-sided white noise [unit/sqrt(Hz)]."""
    bias: Vector3 = ZERO
    bias_temperature: Vector3 = ZERO
    """Change of the bias per kelvin, relative to 25 degC [unit/K]."""
    bias_walk: NonNegative = 0.0
    """Random walk of the bias [unit/sqrt(s)]."""
    scale: Vector3 = ZERO
    """Relative scale error of each axis."""
    cross_axis: tuple[float, float, float, float, float, float] = (*ZERO, *ZERO)
    """Cross-axis errors xy, xz, yx, yz, zx, zy. The error xy is the share of y that appears in
    x."""
    lowpass_hz: Positive | None = None
    """Bandwidth of the second-order Butterworth filter in the sensor [Hz]; null: no filter."""
    full_scale: Positive | None = None
    """Absolute value at which values are clipped; null: no clipping."""
    lsb: NonNegative = 0.0
    """Quantisation step; 0: no quantisation."""


class Accelerometer(TriaxialSensor, frozen=True):
    """Accelerometer [m/s^2]. The defaults are those of a consumer MEMS part."""

    noise_density: NonNegative = 0.0018
    lowpass_hz: Positive | None = 40.0
    full_scale: Positive | None = 39.2
    lsb: NonNegative = 0.002
    vibration: bool = True
    vibration_mps2: Vector3 = (0.12, 0.12, 0.22)
    """rms of the body vibration at 20 m/s, without the motion of the suspension. It grows with
    sqrt(speed)."""
    engine_mps2: NonNegative = 0.05
    """Amplitude of the second engine order of an idling engine, about 25 Hz."""


class Gyroscope(TriaxialSensor, frozen=True):
    """Gyroscope [rad/s]."""

    noise_density: NonNegative = 0.00012
    lowpass_hz: Positive | None = 40.0
    full_scale: Positive | None = 4.363323
    lsb: NonNegative = 0.00035
    g_sensitivity: Vector3 = ZERO
    """Rate error per specific force on the same axis [(rad/s)/(m/s^2)]."""
    vibration: bool = True
    vibration_radps: NonNegative = 0.004
    """rms of the angular vibration at 20 m/s."""


class Temperature(Transmission, frozen=True):
    """Temperature of the sensor: a first-order warm-up."""

    rate_hz: RateHz = 1.0
    start_degc: float = 20.0
    rise_k: float = 18.0
    time_constant_s: Positive = 600.0
    lsb: NonNegative = 0.5


class Speed(Transmission, frozen=True):
    """Vehicle speed signal, from the rear wheels."""

    scale: float = 0.0
    """Relative error (tyre radius)."""
    lsb: NonNegative = 0.01 / 3.6
    dead_band_mps: NonNegative = 0.3
    """Speed below which the signal is 0."""
    noise_mps: NonNegative = 0.01
    time_constant_s: NonNegative = 0.0
    """Time constant of the first-order filter in the sending unit."""
    delay_rate: Annotated[float, Meta(ge=-0.01, le=0.01)] = 0.0
    """Growth of the delay [s/s]. The reason for a growth is that the time stamps of speed and
    sensor come from two clocks."""


class WheelSpeeds(Transmission, frozen=True):
    """Four wheel speeds, with their differences in curves and with slip from driving or braking."""

    scale: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    lsb: NonNegative = 0.01 / 3.6
    dead_band_mps: NonNegative = 0.4
    noise_mps: NonNegative = 0.02
    slip_per_mps2: NonNegative = 0.003
    """Slip of the driven (front) or braked (all) wheels per longitudinal specific force."""
    slip_events: tuple[Gap, ...] = ()
    """Intervals in which the wheels slip differently, as on ice with active brake control. The
    speed signal has the slip of the rear wheels."""
    slip_event_size: Fraction = 0.4
    """Largest slip in an interval of `slip_events`."""


class Scalar(Transmission, frozen=True):
    """A vehicle signal with one component, with offset and scale error."""

    offset: float = 0.0
    scale: float = 0.0
    noise: NonNegative = 0.0
    """rms of white noise, for each sample."""
    lsb: NonNegative = 0.0
    lowpass_hz: Positive | None = None


class Steering(Scalar, frozen=True):
    """Steering-wheel angle [rad]."""

    rate_hz: RateHz = 100.0
    lsb: NonNegative = 0.00174533
    delay_s: DelayS = 0.01


class YawRate(Scalar, frozen=True):
    """Yaw rate signal of the stability control [rad/s], about the body's vertical axis."""

    noise: NonNegative = 0.001
    lsb: NonNegative = 0.000174533
    delay_s: DelayS = 0.01
    lowpass_hz: Positive | None = 15.0


class LateralAccel(Scalar, frozen=True):
    """Lateral acceleration of the stability control [m/s^2], from a sensor in the body, which
    rolls."""

    noise: NonNegative = 0.03
    lsb: NonNegative = 0.01
    delay_s: DelayS = 0.01
    lowpass_hz: Positive | None = 15.0


class LongitudinalAccel(LateralAccel, frozen=True):
    """Longitudinal acceleration of the stability control [m/s^2], from a sensor in the body."""


class Flag(Transmission, frozen=True):
    """A switch (reverse gear, brake pedal)."""

    rate_hz: RateHz = 10.0
    delay_s: DelayS = 0.02


class Heading(Scalar, frozen=True):
    """Heading, clockwise from north [rad]."""

    enabled: bool = False
    rate_hz: RateHz = 1.0
    noise: NonNegative = 0.01


class Magnetometer(Transmission, frozen=True):
    """Magnetometer [T] in sensor axes, parallel to the axes of the accelerometer."""

    enabled: bool = False
    rate_hz: RateHz = 20.0
    field_horizontal_t: NonNegative = 20e-6
    field_down_t: float = 45e-6
    hard_iron_t: Vector3 = ZERO
    noise_t: NonNegative = 0.3e-6
    lsb: NonNegative = 0.02e-6


class BusLoad(Section, frozen=True):
    """The CAN bus for which a log is written."""

    bitrate: Positive = 500_000.0
    background_frames_per_s: NonNegative = 2300.0
    """Number of frames per second from other control units, if background traffic is requested."""
