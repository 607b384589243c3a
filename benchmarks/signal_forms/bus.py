"""A bus for each form of signals: its database, its configuration, and frames of samples.

The database is generated, because a form often is one of the database (a step, a multiplexer, a
sign in a bit of its own). Fields are packed here and not by the product's encoder, so that an error
that encoder and decoder share does not go unseen. Counter and checksum are the product's.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.integrity.bus import SIGNALS
from imucald.can.columns import FrameColumns
from imucald.can.e2e.protection_spec import ProtectionSpec
from imucald.can.e2e.protector import MessageProtector
from imucald.config import parse_config
from imucald.core.samples import Samples, Series
from imucald.inputs.routes import MessageRoute
from imucald.inputs.wiring import compile_router
from imucald.traffic.can_log import EPOCH_S
from imucald.traffic.other_units import joined

Array = NDArray[np.float64]

BYTES = 8
COUNTER_BIT, CHECKSUM_BIT = 52, 56
OBD_ID = 0x7E8
"""Answers of the engine's unit to OBD-II requests."""
OBD_HEAD = (3, 0x41, 0x0D)
"""Length, answer to service 01, PID of the speed."""
KMH = 3.6
DEG = float(np.degrees(1.0))
STEPS = {
    "accel": 0.002,
    "gyro": 0.01,
    "speed": 0.01,
    "wheel_speeds": 0.01,
    "steering": 0.1,
    "yaw_rate": 0.01,
    "lateral_accel": 0.005,
    "longitudinal_accel": 0.005,
}
"""Steps of a database that spoils nothing, in the units of `UNITS`."""
UNITS = {
    "accel": ("m/s^2", 1.0),
    "gyro": ("deg/s", DEG),
    "speed": ("km/h", KMH),
    "wheel_speeds": ("km/h", KMH),
    "steering": ("deg", DEG),
    "yaw_rate": ("deg/s", DEG),
    "lateral_accel": ("m/s^2", 1.0),
    "longitudinal_accel": ("m/s^2", 1.0),
    "reverse": ("", 1.0),
    "brake": ("", 1.0),
    "temperature": ("degC", 1.0),
}
"""The database's unit of a channel, and what SI is multiplied by."""
UNSIGNED = frozenset({"speed", "wheel_speeds", "reverse", "brake"})


@dataclass(frozen=True)
class Field:
    """A signal at a byte's beginning: slot of its channel's values, None of a scalar."""

    name: str
    channel: str
    byte: int
    slot: int | None = None
    mux: int | None = None
    bits: int = 16


@dataclass(frozen=True)
class Message:
    """A message of fields, all sent when the first field's channel has a sample."""

    name: str
    can_id: int
    fields: tuple[Field, ...]
    protected: bool = True


def _triad(name: str, channel: str, axes: str, can_id: int) -> Message:
    return Message(
        name, can_id, tuple(Field(f"{axes}{a}", channel, 2 * i, i) for i, a in enumerate("XYZ"))
    )


PLAIN_IMU = (
    _triad("IMU_Accel", "accel", "Accel", 0x200),
    _triad("IMU_Gyro", "gyro", "Rate", 0x201),
)
ONE_AXIS_A_FRAME = tuple(
    Message("IMU_Axis", 0x200, (Field(f"{stem}{a}", channel, 1, i, mux=1 + 3 * k + i),))
    for k, (channel, stem) in enumerate((("accel", "Accel"), ("gyro", "Rate")))
    for i, a in enumerate("XYZ")
)
TWO_MESSAGES = tuple(
    Message(
        f"IMU_{2 * k + part}",
        0x200 + 2 * k + part,
        tuple(Field(f"{stem}{'XYZ'[i]}", channel, 2 * j, i) for j, i in enumerate(slots)),
    )
    for k, (channel, stem) in enumerate((("accel", "Accel"), ("gyro", "Rate")))
    for part, slots in enumerate(((0, 1), (2,)))
)
"""x and y in one message, z in the next."""
VEHICLE = (
    Message("ESC_Speed", 0x1A0, (Field("VehicleSpeed", "speed", 0),)),
    Message(
        "ESC_WheelSpeeds",
        0x1B0,
        tuple(
            Field(f"Wheel{place}", "wheel_speeds", 2 * i, i)
            for i, place in enumerate(("FrontLeft", "FrontRight", "RearLeft", "RearRight"))
        ),
        protected=False,
    ),
    Message("EPS_SteeringAngle", 0xC2, (Field("SteeringWheelAngle", "steering", 0),)),
    Message(
        "ESC_Dynamics",
        0x130,
        (
            Field("YawRate", "yaw_rate", 0),
            Field("LateralAccel", "lateral_accel", 2),
            Field("LongitudinalAccel", "longitudinal_accel", 4),
        ),
    ),
    Message("TCU_Gear", 0x1C0, (Field("GearPosition", "reverse", 0, bits=8),), protected=False),
    Message("ESC_Brake", 0x1C1, (Field("BrakePressed", "brake", 0, bits=8),), protected=False),
    Message(
        "IMU_Temperature", 0x210, (Field("SensorTemperature", "temperature", 0),), protected=False
    ),
)


@dataclass(frozen=True)
class Layout:
    """How signals are written.

    steps: of a channel [its database unit], others as in STEPS. sign_bits: channels that are
    written as a magnitude and a bit of its sign. obd_speed: the speed is an OBD-II answer in whole
    km/h, and no database has it.
    """

    imu: tuple[Message, ...] = PLAIN_IMU
    steps: Mapping[str, float] = field(default_factory=dict)
    sign_bits: frozenset[str] = frozenset()
    obd_speed: bool = False

    def with_steps(self, steps: Mapping[str, float]) -> Layout:
        """The same, coarser steps for what it says nothing of."""
        return Layout(self.imu, {**steps, **self.steps}, self.sign_bits, self.obd_speed)


class Bus:
    """The bus of a drive with these channels, in a folder of its own."""

    def __init__(self, layout: Layout, channels: Collection[str], side: str, folder: Path) -> None:
        self.layout, self.channels, self._side = layout, frozenset(channels), side
        self.folder = folder

    @cached_property
    def messages(self) -> list[Message]:
        """Those that carry one of the channels, with what of them does."""
        found = []
        for message in (*self.layout.imu, *VEHICLE):
            if message.name == "ESC_Speed" and self.layout.obd_speed:
                continue
            there = tuple(f for f in message.fields if f.channel in self.channels)
            if there:
                found.append(Message(message.name, message.can_id, there, message.protected))
        return found

    def step(self, channel: str) -> float:
        """The database's step of a channel, in the database's unit."""
        usual = 1.0 if channel in ("reverse", "brake") else STEPS.get(channel, 0.5)
        return self.layout.steps.get(channel, usual)

    # database and configuration ----------------------------------------------------------------

    def write_database(self, cycles_ms: Mapping[str, int]) -> None:
        """Write bus.dbc; cycles_ms: the cycle of a message, where it is stated."""
        lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: CAR GATEWAY", ""]
        by_name: dict[str, list[Message]] = {}
        for message in self.messages:
            by_name.setdefault(message.name, []).append(message)
        for name, parts in by_name.items():
            lines.append(f"BO_ {parts[0].can_id} {name}: {BYTES} CAR")
            fields = [f for part in parts for f in part.fields]
            if any(f.mux is not None for f in fields):
                lines.append(' SG_ Axis M : 0|8@1+ (1,0) [0|255] "" GATEWAY')
            lines += [self._signal(f) for f in fields]
            lines += [
                f' SG_ {f.name}Sign : {self._sign_bit(f)}|1@1+ (1,0) [0|1] "" GATEWAY'
                for f in fields
                if f.channel in self.layout.sign_bits
            ]
            if parts[0].protected:
                lines.append(f' SG_ {name}_AC : {COUNTER_BIT}|4@1+ (1,0) [0|15] "" GATEWAY')
                lines.append(f' SG_ {name}_CRC : {CHECKSUM_BIT}|8@1+ (1,0) [0|255] "" GATEWAY')
            lines.append("")
        lines += ['BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;']
        lines += ['BA_DEF_DEF_ "GenMsgCycleTime" 0;']
        lines += [
            f'BA_ "GenMsgCycleTime" BO_ {parts[0].can_id} {cycles_ms[name]};'
            for name, parts in by_name.items()
            if name in cycles_ms
        ]
        (self.folder / "bus.dbc").write_text("\n".join(lines) + "\n", "utf-8")

    def _signal(self, f: Field) -> str:
        is_magnitude = f.channel in self.layout.sign_bits
        sign = "+" if f.channel in UNSIGNED or is_magnitude else "-"
        bits = f.bits - 1 if is_magnitude else f.bits
        step, mux = self.step(f.channel), "" if f.mux is None else f" m{f.mux}"
        low = -(2 ** (bits - 1)) * step if sign == "-" else 0.0
        high = (2 ** (bits - 1) - 1 if sign == "-" else 2**bits - 1) * step
        unit = UNITS[f.channel][0]
        place = f"{8 * f.byte}|{bits}@1{sign} ({step:g},0) [{low:.9g}|{high:.9g}]"
        return f' SG_ {f.name}{mux} : {place} "{unit}" GATEWAY'

    @staticmethod
    def _sign_bit(f: Field) -> int:
        return 8 * f.byte + f.bits - 1

    def configuration(self, counters: bool, sign_signals: bool = True) -> str:
        """The YAML text that reads this bus. counters: whether they are configured."""
        lines = ["database: bus.dbc", f"vehicle: {{driving_side: {self._side}}}", "signals:"]
        lines += [
            f"  {self._source(channel, text, sign_signals)}"
            for channel, text in SIGNALS.items()
            if channel in self.channels
        ]
        protected = dict.fromkeys(m.name for m in self.messages if m.protected)
        if counters and protected:
            lines.append("messages:")
            for name in protected:
                checksum = f"{{kind: crc8_j1850, signal: {name}_CRC, id_bytes: 2}}"
                lines.append(f"  {name}: {{counter: {{signal: {name}_AC}}, checksum: {checksum}}}")
        return "\n".join(lines) + "\n"

    def _source(self, channel: str, text: str, sign_signals: bool) -> str:
        """The line of a channel: the judge's bus has it for plain messages."""
        if channel == "speed" and self.layout.obd_speed:
            when = "data[1] == 0x41 and data[2] == 0x0D"
            return (
                f'speed: {{raw: {{id: {OBD_ID:#x}, when: "{when}", value: "data[3]"}}, unit: km/h}}'
            )
        for message in self.layout.imu:
            for f in message.fields:
                if f.channel == channel:
                    old = {"accel": "IMU_Accel", "gyro": "IMU_Gyro"}[channel]
                    text = text.replace(f"{old}.{f.name}", f"{message.name}.{f.name}")
        if channel in self.layout.sign_bits and sign_signals:
            key, source = text.split(": ")
            text = f"{key}: {{signal: {source}, sign_signal: {source}Sign}}"
        return text

    # frames ------------------------------------------------------------------------------------

    def frames(self, samples: Samples) -> FrameColumns:
        """Frames of samples in order of time, with counters and checksums; writes the database."""
        parts: dict[str, list[tuple[Array, NDArray[np.uint8]]]] = {}
        for number, message in enumerate(self.messages):
            t, data = self._packed(message, samples, number)
            parts.setdefault(message.name, []).append((t, data))
        cycles = {}
        ordered = {}
        for name, found in parts.items():
            t = np.concatenate([one[0] for one in found])
            order = np.argsort(t, kind="stable")
            ordered[name] = t[order], np.concatenate([one[1] for one in found])[order]
            if len(t) > 1:
                cycles[name] = max(round(1000.0 * float(np.median(np.diff(t[order])))), 1)
        self.write_database(cycles)
        specs = self._protection()
        ids = {message.name: message.can_id for message in self.messages}
        columns = []
        for name, (t, data) in ordered.items():
            spec = specs.get(ids[name])
            payloads = data if spec is None else MessageProtector(spec).protect_columns(data)
            columns.append(_columns(t, ids[name], payloads))
        if self.layout.obd_speed and "speed" in self.channels:
            columns.append(_obd_answers(samples["speed"]))
        whole = joined(columns)
        return whole.take(np.argsort(whole.t, kind="stable"))

    def _packed(
        self, message: Message, samples: Samples, number: int
    ) -> tuple[Array, NDArray[np.uint8]]:
        """Times (N,) and payloads (N, 8) of a message, all but counter and checksum."""
        leader = samples[message.fields[0].channel]
        mux = message.fields[0].mux
        rows = np.arange(len(leader.t))
        if mux is not None:  # the axes take turns
            rows = rows[rows % 3 == (mux - 1) % 3]
        t = leader.t[rows]
        if message.name.startswith("IMU_") and message.can_id % 2:
            t = t + 0.0003  # behind the frame before it, on one bus
        data = np.zeros((len(t), BYTES), np.uint8)
        if mux is not None:
            data[:, 0] = mux
        for f in message.fields:
            series = samples[f.channel]
            at = rows
            if series is not leader:
                at = np.maximum(np.searchsorted(series.t, leader.t[rows], side="right") - 1, 0)
            values = series.values if f.slot is None else series.values[:, f.slot]
            raw = np.rint(values[at] * UNITS[f.channel][1] / self.step(f.channel)).astype(np.int64)
            if f.channel in self.layout.sign_bits:
                raw = np.minimum(np.abs(raw), 2 ** (f.bits - 1) - 1) + (raw < 0) * 2 ** (f.bits - 1)
            elif f.channel in UNSIGNED:
                raw = np.clip(raw, 0, 2**f.bits - 1)
            else:
                raw = np.clip(raw, -(2 ** (f.bits - 1)), 2 ** (f.bits - 1) - 1)
            for k in range(f.bits // 8):
                data[:, f.byte + k] = (raw >> (8 * k)) & 0xFF
        return t, data

    def _protection(self) -> dict[int, ProtectionSpec]:
        text = self.configuration(counters=True, sign_signals=False)
        loaded = parse_config(text, self.folder / "writer.yaml")
        return {
            route.plan.message.can_id: route.checker.spec
            for route in compile_router(loaded).routes
            if isinstance(route, MessageRoute) and route.checker.spec.counter is not None
        }


def _columns(t: Array, can_id: int, data: NDArray[np.uint8]) -> FrameColumns:
    n = len(t)
    return FrameColumns(
        t + EPOCH_S,
        np.full(n, can_id, np.uint32),
        np.full(n, BYTES, np.uint8),
        data,
        np.zeros(n, np.uint8),
        ("can0",),
    )


def _obd_answers(speed: Series) -> FrameColumns:
    data = np.full((len(speed.t), BYTES), 0xAA, np.uint8)
    data[:, : len(OBD_HEAD)] = OBD_HEAD
    data[:, len(OBD_HEAD)] = np.clip(np.rint(KMH * speed.values), 0, 255)
    return _columns(speed.t, OBD_ID, data)


def pieces(frames: FrameColumns, seconds: float) -> Iterator[FrameColumns]:
    """Frames in pieces of about so many seconds."""
    edges = np.arange(frames.t[0], frames.t[-1] + seconds, seconds)
    for first, stop in zip(edges, [*edges[1:], np.inf], strict=True):
        low, high = np.searchsorted(frames.t, [first, stop])
        if high > low:
            yield frames.take(slice(int(low), int(high)))
