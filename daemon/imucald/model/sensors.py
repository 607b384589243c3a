"""Parameters of the sensors and of the CAN bus (sections of the model file).

Every effect is off at its neutral value (0, or `null` where stated), and the switches of a section
turn off whole groups without losing their values.
"""

from __future__ import annotations

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
"""Delays that a model file may hold [s]."""
DelayS = Annotated[float, Meta(ge=0.0, le=LONGEST_DELAY_S)]


class Gap(Section, frozen=True):
    """A span of time."""

    start_s: NonNegative
    duration_s: Positive


class Transmission(Section, frozen=True):
    """Timing of a signal's frames; common to all signals."""

    enabled: bool = True
    """False: the vehicle does not have this signal."""
    rate_hz: RateHz = 50.0
    delay_s: DelayS = 0.0
    """Age of the value when its frame is sent, in addition to the low-pass's delay."""
    jitter_s: NonNegative = 0.0005
    """Mean delay of a frame on the bus (exponentially distributed), from arbitration and task
    scheduling."""
    clock_drift_ppm: float = 0.0
    """Rate error of the sending unit's clock."""
    loss: Fraction = 0.0
    """Probability that a frame is lost."""
    dropouts: tuple[Gap, ...] = ()
    """Segments without frames."""
    stuck: tuple[Gap, ...] = ()
    """Segments in which the value does not change although frames come."""


class TriaxialSensor(Transmission, frozen=True):
    """Three-axis inertial sensor; units are those of the sensor (m/s^2, or rad/s)."""

    rate_hz: RateHz = 100.0
    jitter_s: NonNegative = 0.0003
    noise_density: NonNegative = 0.0
    """One-sided white noise [unit/sqrt(Hz)]."""
    bias: Vector3 = ZERO
    bias_temperature: Vector3 = ZERO
    """Change of bias per degree from 25 degC [unit/K]."""
    bias_walk: NonNegative = 0.0
    """Random walk of the bias [unit/sqrt(s)]."""
    scale: Vector3 = ZERO
    """Relative scale error per axis."""
    cross_axis: tuple[float, float, float, float, float, float] = (*ZERO, *ZERO)
    """Off-diagonal errors xy, xz, yx, yz, zx, zy: share of the second axis that appears in the
    first."""
    lowpass_hz: Positive | None = None
    """Bandwidth of the second-order Butterworth filter in the sensor; null: none."""
    full_scale: Positive | None = None
    """Values are clipped at this size; null: no clipping."""
    lsb: NonNegative = 0.0
    """Quantisation step."""


class Accelerometer(TriaxialSensor, frozen=True):
    """Accelerometer [m/s^2]; figures of a consumer MEMS part."""

    noise_density: NonNegative = 0.0018
    lowpass_hz: Positive | None = 40.0
    full_scale: Positive | None = 39.2
    lsb: NonNegative = 0.002
    vibration: bool = True
    vibration_mps2: Vector3 = (0.12, 0.12, 0.22)
    """rms of body vibration (not from suspension motion) at 20 m/s; grows with sqrt(speed)."""
    engine_mps2: NonNegative = 0.05
    """Amplitude of the engine's second order in idle, about 25 Hz."""


class Gyroscope(TriaxialSensor, frozen=True):
    """Gyroscope [rad/s]."""

    noise_density: NonNegative = 0.00012
    lowpass_hz: Positive | None = 40.0
    full_scale: Positive | None = 4.363323
    lsb: NonNegative = 0.00035
    g_sensitivity: Vector3 = ZERO
    """Rate per specific force on the same axis [(rad/s)/(m/s^2)]."""
    vibration: bool = True
    vibration_radps: NonNegative = 0.004
    """rms of angular vibration at 20 m/s."""


class Temperature(Transmission, frozen=True):
    """Sensor temperature: first-order warm-up."""

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
    """Below this speed the signal shows 0."""
    noise_mps: NonNegative = 0.01
    time_constant_s: NonNegative = 0.0
    """First-order filter in the sending unit."""
    delay_rate: Annotated[float, Meta(ge=-0.01, le=0.01)] = 0.0
    """Growth of the delay [s/s], because the stamps of speed and sensor come from two clocks."""


class WheelSpeeds(Transmission, frozen=True):
    """Four wheel speeds, with their differences in curves and with drive or brake slip."""

    scale: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    lsb: NonNegative = 0.01 / 3.6
    dead_band_mps: NonNegative = 0.4
    noise_mps: NonNegative = 0.02
    slip_per_mps2: NonNegative = 0.003
    """Slip of the driven (front) or braked (all) wheels per longitudinal specific force."""
    slip_events: tuple[Gap, ...] = ()
    """Segments in which the wheels slip and disagree, as on ice with active brake control. The
    speed signal has the slip of the rear wheels."""
    slip_event_size: Fraction = 0.4
    """Largest slip in such a segment."""


class Scalar(Transmission, frozen=True):
    """A vehicle signal with offset and scale error."""

    offset: float = 0.0
    scale: float = 0.0
    noise: NonNegative = 0.0
    """rms of white noise per sample."""
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
    """Lateral acceleration of the stability control [m/s^2]: a sensor in the rolling body."""

    noise: NonNegative = 0.03
    lsb: NonNegative = 0.01
    delay_s: DelayS = 0.01
    lowpass_hz: Positive | None = 15.0


class LongitudinalAccel(LateralAccel, frozen=True):
    """Longitudinal acceleration of the stability control [m/s^2]: a sensor in the body."""


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
    """Magnetometer [T] in sensor axes, parallel to the accelerometer."""

    enabled: bool = False
    rate_hz: RateHz = 20.0
    field_horizontal_t: NonNegative = 20e-6
    field_down_t: float = 45e-6
    hard_iron_t: Vector3 = ZERO
    noise_t: NonNegative = 0.3e-6
    lsb: NonNegative = 0.02e-6


class BusLoad(Section, frozen=True):
    """The CAN bus that a log is written for."""

    bitrate: Positive = 500_000.0
    background_frames_per_s: NonNegative = 2300.0
    """Frames per second of other units, if background traffic is requested."""
