"""Diagnoses made by hand, one of each verdict, with pictures of a drive that looks like one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import butter, sosfiltfilt, welch

from imucald.diagnosis.result import (
    Candidate,
    Diagnosis,
    Estimated,
    FoundCause,
    Gain,
    SignalGain,
    SignalPicture,
    Structure,
)
from imucald.model.model import VehicleModel

RATE_HZ = 10.0
BEFORE = VehicleModel()
AFTER = BEFORE.with_changes(
    {"suspension.roll_gradient": 0.01712345678, "accel.bias": [0.0, 0.2471, 0.0]}
)

ROLL = FoundCause(
    name="body_roll",
    parameters={
        "suspension.roll_gradient": Estimated(0.01712345678, 0.00031, "rad/(m/s^2)", 0.008, 0.0025)
    },
    signals=("accel_y", "gyro_x"),
    evidence={
        "held_out_nats": 812.4,
        "sigma": 29.4,
        "quantile": 3.9,
        "beyond_tolerance": 21.3,
        "threshold": 3.9,
    },
    text="Body roll in bends differs from the model file's.",
    against=("it predicts worse in 40 % of the segments",),
)
BIAS = FoundCause(
    name="accel_bias",
    parameters={
        f"accel.bias.{axis}": Estimated(value, 0.011, "m/s^2", 0.0, 0.06)
        for axis, value in zip("xyz", (0.004, 0.2471, -0.002), strict=True)
    },
    signals=("accel_y",),
    evidence={
        "held_out_nats": 41.0,
        "sigma": 22.0,
        "quantile": 3.9,
        "beyond_tolerance": 15.8,
        "threshold": 3.9,
    },
    text="The accelerometer reads a constant too much.",
)


def picture(signal="accel_y", unit="m/s^2", seconds=1800.0, size=0.15, seed=1) -> SignalPicture:
    """A residual that goes with lateral acceleration before, and is noise after."""
    rng = np.random.default_rng(seed)
    n = round(seconds * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    slow = sosfiltfilt(butter(2, 0.08, fs=RATE_HZ, output="sos"), rng.normal(size=n))
    driver = np.sign(slow) * (np.abs(slow) / slow.std()) ** 1.5
    noise = sosfiltfilt(butter(1, 3.0, fs=RATE_HZ, output="sos"), rng.normal(size=n)) * 0.06
    truth = driver + size * driver
    measured = truth + noise
    measured[n // 3 : n // 3 + 300] = np.nan  # a stretch that was not believed
    clean = noise - noise.mean()
    frequency, before = welch(size * driver + clean, RATE_HZ, nperseg=min(n, 1024))
    _, after = welch(clean, RATE_HZ, nperseg=min(n, 1024))
    return SignalPicture(
        signal=signal,
        unit=unit,
        t=t,
        measured=measured,
        predicted_before=driver,
        predicted_after=truth,
        driver_name="v * yaw rate [m/s^2]",
        driver=driver,
        frequency=frequency,
        spectrum_before=before,
        spectrum_after=after,
    )


def not_extended(p: SignalPicture) -> SignalPicture:
    return replace(p, predicted_after=p.predicted_before, spectrum_after=p.spectrum_before)


SIGNALS = {
    "accel_x": SignalGain(0.081, 0.080, 0.078, "m/s^2"),
    "accel_y": SignalGain(
        0.312, 0.101, 0.094, "m/s^2", 0.3, 0.08, "offset +0.13 m/s^2", 0.102, "found"
    ),
    "gyro_x": SignalGain(0.0102, 0.0068, 0.0065, "rad/s"),
    "yaw_rate": SignalGain(0.0021, 0.0021, 0.0020, "rad/s"),
}


def found(**changes) -> Diagnosis:
    diagnosis = Diagnosis(
        verdict="found",
        causes=(ROLL, BIAS),
        look_alikes=(),
        to_separate="",
        signals=SIGNALS,
        gain=Gain(673.0, (590.0, 755.0)),
        recommended=True,
        duration_s=1800.0,
        candidates=(
            Candidate("gyro_scale", "within tolerance", -2.0, "gyro.scale.2 off by 0.001 +- 0.001"),
            Candidate(
                "accel_scale", "not decidable here", 3.2, "accel.scale.0 off by 0.01 +- 0.02"
            ),
        ),
        notes=("no temperature signal: drift with temperature was not looked for",),
        pictures=(
            picture(),
            picture("gyro_x", "rad/s", size=0.02, seed=2),
            picture("yaw_rate", "rad/s", size=0.001, seed=3),
        ),
        model_before=BEFORE,
        model_after=AFTER,
    )
    return replace(diagnosis, **changes)


def ambiguous() -> Diagnosis:
    return found(
        verdict="ambiguous",
        pictures=(picture(),),
        look_alikes=(("accel_bias", "accel_cross_axis", "mount_rotation"),),
        to_separate="Drive the same road in both directions and corner both ways.",
        causes=(BIAS,),
        model_after=BEFORE,
    )


def unknown() -> Diagnosis:
    return found(
        verdict="unknown",
        signals={name: replace(s, rms_after=s.rms_before) for name, s in SIGNALS.items()},
        pictures=(not_extended(picture()),),
        causes=(),
        structure=(
            Structure("accel_y", "spectral peak", 41.0, "at 0.62 Hz, while cornering"),
            Structure("yaw_rate", "bursts", 9.3, "above 25 m/s, a few seconds each"),
        ),
        gain=Gain(0.0, (0.0, 0.0)),
        recommended=False,
        model_after=BEFORE,
    )


def nothing() -> Diagnosis:
    return found(
        verdict="nothing",
        pictures=(picture(size=0.0),),
        signals={name: replace(s, rms_before=s.rms_after) for name, s in SIGNALS.items()},
        causes=(),
        candidates=(Candidate("gyro_bias", "within tolerance", -4.1, "0.01 +- 0.01"),),
        gain=Gain(0.0, (0.0, 0.0)),
        recommended=False,
        model_after=BEFORE,
    )


ALL = {"found": found, "ambiguous": ambiguous, "unknown": unknown, "nothing": nothing}
