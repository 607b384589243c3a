"""The forms: how signals come on real buses, each as something done to a sound drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from benchmarks.integrity.bases import Base
from benchmarks.signal_forms.bus import ONE_AXIS_A_FRAME, TWO_MESSAGES, Layout
from imucald.can.columns import FrameColumns
from imucald.core.samples import Samples, Series

Array = NDArray[np.float64]
SampleEdit = Callable[[Samples, np.random.Generator], Samples]
FrameEdit = Callable[[FrameColumns, np.random.Generator], FrameColumns]

KMH = 3.6
BURST_S = 0.2
"""Mean length of a burst of lost frames: a recorder that does not keep up."""
TOLD_PERCENT = 5
"""So many lost frames get a word from `check`."""
SHAKING = 0.5
"""rms on each axis [m/s^2]."""
WHEELS = frozenset({"wheel_speeds"})
TURNING = frozenset({"gyro", "yaw_rate", "steering", "wheel_speeds", "lateral_accel"})
"""What tells how fast the vehicle turns, or to which side."""
NEARLY = 0.9
"""A log whose rate is this share of a form's has that rate."""


def _same(samples: Samples, _: np.random.Generator) -> Samples:
    return samples


def _as_sent(frames: FrameColumns, _: np.random.Generator) -> FrameColumns:
    return frames


@dataclass(frozen=True)
class Form:
    """A form of signals.

    samples, frames: what is done to a drive's samples, and to the frames that are made of them.
    without: channels that it lacks. needs: least rate of a channel that it begins with [Hz].
    own_twin: whether the drive that it is held against lacks the same channels; else it has all.
    counters: whether they are configured. carries: whether the information is in it; where it is
    not, `check` has to say so. tells: a word that the findings of `check` must have. changes: of
    the simulated vehicle (measured drives are left out).
    twin: what makes the unspoilt drive of one with these changes.
    constant: only put on drives of constant cruising.
    """

    name: str
    samples: SampleEdit = _same
    frames: FrameEdit = _as_sent
    layout: Layout = field(default_factory=Layout)
    without: frozenset[str] = frozenset()
    needs: Mapping[str, float] = field(default_factory=dict)
    own_twin: bool = True
    counters: bool = True
    carries: bool = True
    tells: str = ""
    changes: Mapping[str, Any] = field(default_factory=dict)
    twin: SampleEdit = _same
    constant: bool = False
    is_unspoilt: bool = False

    def fits(self, base: Base, is_constant: bool) -> bool:
        """Whether it can be put on a drive."""
        if base.seed is None and self.changes:
            return False
        if self.constant and not is_constant:
            return False
        for channel, rate in self.needs.items():
            series = base.samples.get(channel)
            if series is None or len(series.t) < NEARLY * rate * base.duration_s:
                return False
        return True


# what is done to samples -------------------------------------------------------------------------


def seldom(series: Series, rate: float) -> Series:
    """Of a series the samples that are sent so often [Hz], as a gateway thins them out."""
    if len(series.t) < (1.0 + 0.5 * (1.0 - NEARLY)) * rate * (series.t[-1] - series.t[0]):
        return series
    rows = np.searchsorted(series.t, np.arange(series.t[0], series.t[-1], 1.0 / rate) - 1e-3)
    rows = np.unique(np.minimum(rows, len(series.t) - 1))
    return Series(series.t[rows], series.values[rows])


def _speed_rate(samples: Samples, rate: float) -> Series:
    speed = samples["speed"]
    if rate <= len(speed.t) / (speed.t[-1] - speed.t[0]) / NEARLY:
        return seldom(speed, rate)
    t = np.arange(speed.t[0], speed.t[-1], 1.0 / rate)
    return Series(t, np.interp(t, speed.t, speed.values))


def speed_at(rate: float) -> SampleEdit:
    """The speed at another rate [Hz]; its step is the database's."""
    return lambda samples, _: {**samples, "speed": _speed_rate(samples, rate)}


def dead_below(kmh: float) -> SampleEdit:
    """The speed is zero below so many km/h."""

    def edit(samples: Samples, _: np.random.Generator) -> Samples:
        speed = samples["speed"]
        values = np.where(KMH * np.abs(speed.values) < kmh, 0.0, speed.values)
        return {**samples, "speed": Series(speed.t, values)}

    return edit


def late(seconds: float) -> SampleEdit:
    """The speed comes later."""

    def edit(samples: Samples, _: np.random.Generator) -> Samples:
        speed = samples["speed"]
        return {**samples, "speed": Series(speed.t + seconds, speed.values)}

    return edit


def imu_at(rate: float) -> SampleEdit:
    """Accelerometer and gyroscope at another rate [Hz]: every nth sample, not a mean."""

    def edit(samples: Samples, _: np.random.Generator) -> Samples:
        found = {c: seldom(samples[c], rate) for c in ("accel", "gyro") if c in samples}
        return {**samples, **found}

    return edit


def shaking(samples: Samples, rng: np.random.Generator) -> Samples:
    """The accelerometer is shaken."""
    accel = samples["accel"]
    values = accel.values + SHAKING * rng.standard_normal(accel.values.shape)
    return {**samples, "accel": Series(accel.t, values)}


# what is done to frames --------------------------------------------------------------------------


def lost_at_random(share: float) -> FrameEdit:
    """Each frame is lost with this probability."""
    return lambda frames, rng: frames.take(rng.random(len(frames)) >= share)


def lost_in_bursts(share: float) -> FrameEdit:
    """All frames of some moments are lost, this share of the time."""

    def edit(frames: FrameColumns, rng: np.random.Generator) -> FrameColumns:
        length = float(frames.t[-1] - frames.t[0])
        n = rng.poisson(share * length / BURST_S)
        start = frames.t[0] + length * np.sort(rng.random(n))
        stop = start + rng.exponential(BURST_S, n)
        kept = np.ones(len(frames), dtype=bool)
        for low, high in np.searchsorted(frames.t, np.column_stack([start, stop])).tolist():
            kept[low:high] = False
        return frames.take(kept)

    return edit


def handed_over_every(seconds: float) -> FrameEdit:
    """An adapter hands over in bursts: the stamp is that of the burst."""
    return lambda frames, _: frames.at(np.ceil(frames.t / seconds) * seconds)


def whole_seconds(frames: FrameColumns, _: np.random.Generator) -> FrameColumns:
    """Stamps are cut to seconds."""
    return frames.at(np.floor(frames.t))


def jitter(seconds: float) -> FrameEdit:
    """Each frame is late by a random time (exponential, this mean); messages keep their order."""

    def edit(frames: FrameColumns, rng: np.random.Generator) -> FrameColumns:
        t = frames.t + rng.exponential(seconds, len(frames))
        for can_id in np.unique(frames.can_id).tolist():
            rows = np.flatnonzero(frames.can_id == can_id)
            t[rows] = np.maximum.accumulate(t[rows])
        moved = replace(frames, t=t)
        return moved.take(np.argsort(t, kind="stable"))

    return edit


# the table ---------------------------------------------------------------------------------------

OBD_ONLY = frozenset(
    {"wheel_speeds", "steering", "yaw_rate", "lateral_accel", "longitudinal_accel", "reverse"}
    | {"brake", "temperature"}
)
"""What a dongle and an IMU of one's own do not have."""


def _all() -> list[Form]:
    found = [
        Form("unspoilt", is_unspoilt=True),
        Form("unspoilt, no wheel speeds", without=WHEELS, is_unspoilt=True),
        Form("unspoilt, IMU and speed", without=OBD_ONLY, needs={"gyro": 5}, is_unspoilt=True),
    ]
    for step in (0.1, 0.5, 1.0):
        for rate in (10.0, 50.0, 100.0):
            found.append(
                Form(
                    f"speed {step:g} km/h, {rate:g} Hz",
                    speed_at(rate),
                    layout=Layout(steps={"speed": step}),
                    without=WHEELS,
                    needs={"speed": min(rate, 50.0)},
                )
            )
    for kmh in (1.0, 3.0, 5.0):
        found.append(Form(f"speed dead below {kmh:g} km/h", dead_below(kmh), without=WHEELS))
    quiet = {"speed.noise_mps": 0.0, "wheel_speeds.noise_mps": 0.0}
    for words, without, step in (
        ("speeds", frozenset(), 0.01),
        ("speed, no wheel speeds", WHEELS, 0.01),
        ("speed, 1 km/h", WHEELS, 1.0),
    ):
        found.append(
            Form(
                f"exactly constant {words}",
                layout=Layout(steps={"speed": step}),
                without=without,
                changes=quiet,
                constant=True,
            )
        )
    for rate in (0.5, 1.0, 2.0):
        found.append(
            Form(
                f"OBD speed, {rate:g} Hz",
                speed_at(rate),
                layout=Layout(obd_speed=True),
                without=OBD_ONLY,
                needs={"speed": rate, "gyro": 5.0},
            )
        )
    for seconds in (0.3, 0.7, 1.2):
        found.append(Form(f"speed late by {seconds:g} s", late(seconds), without=WHEELS))
    for counters in (True, False):
        words = "counters" if counters else "no counters"
        for percent in (1, 5, 10):
            share = percent / 100.0
            random, bursts = lost_at_random(share), lost_in_bursts(share)
            tells = "lost" if percent >= TOLD_PERCENT else ""
            for how, edit in (("lost", random), ("lost in bursts", bursts)):
                name = f"{percent} % {how}, {words}"
                found.append(Form(name, frames=edit, counters=counters, tells=tells))
    for rate in (5.0, 10.0, 25.0, 100.0):
        found.append(Form(f"IMU {rate:g} Hz", imu_at(rate), needs={"accel": rate}))
    found += [
        Form(
            "IMU 1000 Hz",
            changes=dict.fromkeys(("grid_hz", "accel.rate_hz", "gyro.rate_hz"), 1000.0),
            twin=imu_at(100.0),
        ),
        Form("steps 0.125 m/s2, 0.25 deg/s", layout=Layout(steps={"accel": 0.125, "gyro": 0.25})),
        Form("shaking 0.5 m/s2", shaking),
        Form(
            "coarse yaw rate, no gyroscope",
            layout=Layout(steps={"yaw_rate": 0.5}),
            without=TURNING - {"yaw_rate"},
            needs={"yaw_rate": 10.0},
            own_twin=False,
        ),
        Form(
            "steering alone",
            without=TURNING - {"steering"},
            needs={"steering": 10.0},
            own_twin=False,
        ),
        Form(
            "gyroscope alone",
            without=TURNING - {"gyro"},
            needs={"gyro": 5.0, "steering": 1.0},
            own_twin=False,
        ),
        Form("no wheel speeds", without=WHEELS, needs={"wheel_speeds": 1.0}, own_twin=False),
        Form("stamps of 0.2 s", frames=handed_over_every(0.2)),
        Form("stamps of 1 s", frames=whole_seconds),
        Form("jitter 20 ms", frames=jitter(0.02)),
        Form(
            "one axis a frame",
            layout=Layout(imu=ONE_AXIS_A_FRAME),
            needs={"accel": 30.0, "gyro": 30.0},
        ),
        Form("axes in two messages", layout=Layout(imu=TWO_MESSAGES), needs={"gyro": 5.0}),
        Form(
            "sign bits, no gyroscope",
            layout=Layout(sign_bits=frozenset({"yaw_rate", "steering"})),
            without=frozenset({"gyro", "wheel_speeds"}),
            needs={"yaw_rate": 10.0, "steering": 10.0},
        ),
    ]
    return found


FORMS = _all()
