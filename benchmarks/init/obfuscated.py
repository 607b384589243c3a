"""Simulated buses whose names, layouts, scales, units and signs are drawn by lot.

Messages are M1, M2, ..., signals S1, S2, ...; bits, byte order, offset and scale of each signal are
drawn, its unit is one of several or none at all, its sign may be the other one. Counters and
checksums of every kind protect some messages. Other signals (engine speed, pedal, odometer, ...)
stand beside them. What is which stands in a configuration, by which the drive is written too.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from imucald.can.columns import CAN_EFF_FLAG, FrameColumns
from imucald.can.dbc.database import Database, load_database
from imucald.can.dbc.encode import compile_encode
from imucald.can.logs.candump_writer import CandumpWriter
from imucald.config import load_config
from imucald.inputs.units import find_unit
from imucald.model.model import VehicleModel
from imucald.simulation.drive import Drive, simulate
from imucald.simulation.random_model import random_model
from imucald.traffic.can_log import EPOCH_S
from imucald.traffic.drive_encoder import BusEncoder
from imucald.traffic.other_units import joined

Array = NDArray[np.float64]
UNITS = {
    "acceleration": ("m/s^2", "g", "mg", "m/s2"),
    "angular_rate": ("deg/s", "rad/s", "dps"),
    "angle": ("deg", "rad"),
    "speed": ("km/h", "m/s", "mph", "kph"),
    "temperature": ("degC", "K"),
}
RANGES = {
    "accelerometer": (-40.0, 40.0),
    "gyroscope": (-4.5, 4.5),
    "speed": (0.0, 90.0),
    "steering_wheel_angle": (-16.0, 16.0),
    "yaw_rate": (-2.5, 2.5),
    "lateral_acceleration": (-20.0, 20.0),
    "longitudinal_acceleration": (-20.0, 20.0),
    "temperature": (-40.0, 87.0),
}
"""What a signal must hold, in SI."""
NO_UNIT = 0.15
"""Part of the messages that state no unit."""
OTHER_SIGN = 0.4
OTHER_GYRO_SIGN = 0.2
PROTECTIONS = (
    "none", "counter", "xor", "crc8_j1850", "crc8_j1850_2", "e2e_p1_low", "e2e_p1_alternating",
    "e2e_p2", "e2e_p5",
)  # fmt: skip


@dataclass
class DrawnMessage:
    """A message that is being drawn."""

    name: str
    can_id: int
    size: int
    big: bool
    used: set[int] = field(default_factory=set)
    lines: list[str] = field(default_factory=list)
    protection: dict[str, Any] = field(default_factory=dict)


class ObfuscatedBus:
    """A bus drawn from a seed: `database` (DBC text), `settings` (what is which)."""

    def __init__(self, seed: int) -> None:
        self.rng = np.random.default_rng([seed, 0x0BF])
        self.messages: list[DrawnMessage] = []
        self.settings: dict[str, Any] = {"signals": {}, "messages": {}}
        self.decoys: list[tuple[DrawnMessage, list[str]]] = []
        self._names = itertools.count(1)
        self._numbers = itertools.count(1)
        ids = [i for i in range(0x20, 0x7A0) if not 0x640 <= i <= 0x64E]  # those we send
        self._ids = self.rng.permutation(ids).tolist()
        self._draw()

    @property
    def database(self) -> str:
        """The DBC."""
        text = ['VERSION ""', "NS_ :", "BS_:", "BU_: A B", ""]
        order = self.rng.permutation(len(self.messages))
        for m in (self.messages[i] for i in order):
            text += [f"BO_ {m.can_id} {m.name}: {m.size} A", *m.lines, ""]
        return "\n".join(text)

    # drawing ---------------------------------------------------------------------------------

    def _draw(self) -> None:
        signals = self.settings["signals"]
        rng = self.rng
        sensor = self._message(8, protected=True)
        turned = -1 if rng.random() < OTHER_GYRO_SIGN else 1
        signals["accelerometer"] = self._axes(sensor, "accelerometer", "acceleration", 1)
        rates = self._message(8, protected=True)
        signals["gyroscope"] = self._axes(rates, "gyroscope", "angular_rate", turned)
        dynamics = self._message(8, protected=True)
        bits = min(14, (8 * dynamics.size - len(dynamics.used)) // 3)
        unit = self._unit("acceleration")
        for name in ("lateral_acceleration", "longitudinal_acceleration"):
            signals[name] = self._signal(dynamics, name, "acceleration", unit, self._sign(), bits)
        signals["yaw_rate"] = self._signal(
            dynamics, "yaw_rate", "angular_rate", self._unit("angular_rate"), self._sign(), bits
        )
        moving = self._message(int(rng.choice([6, 8])), protected=True)
        signals["speed"] = self._signal(moving, "speed", "speed", self._unit("speed"), 1)
        wheels = self._message(8, protected=False)
        unit, bits = self._unit("speed"), int(rng.integers(13, 17))
        corners = ["front_left", "front_right", "rear_left", "rear_right"]
        signals["wheel_speeds"] = {
            corner: self._signal(wheels, "speed", "speed", unit, 1, bits) for corner in corners
        }
        steering = self._message(int(rng.choice([5, 6, 8])), protected=True)
        signals["steering_wheel_angle"] = self._signal(
            steering, "steering_wheel_angle", "angle", self._unit("angle"), self._sign()
        )
        signals["reverse"] = self._lever(self._message(2, protected=False))
        signals["brake"] = f"{(m := self._message(3, protected=False)).name}.{self._switch(m)}"
        signals["temperature"] = self._signal(
            self._message(2, protected=False), "temperature", "temperature", ("degC", "degC"), 1, 8
        )
        self._other_signals()
        self.settings["messages"] = {m.name: m.protection for m in self.messages if m.protection}

    def _axes(self, m: DrawnMessage, name: str, dimension: str, sign: int) -> dict[str, Any]:
        unit = self._unit(dimension)
        bits = min(int(self.rng.integers(14, 17)), (8 * m.size - len(m.used)) // 3)
        turn = int(self.rng.integers(3))
        axes = ["xyz"[(i + turn) % 3] for i in range(3)]
        found = {a: self._signal(m, name, dimension, unit, sign, bits) for a in axes}
        return {a: found[a] for a in "xyz"}

    def _message(self, size: int, protected: bool) -> DrawnMessage:
        can_id = int(self._ids.pop())
        if self.rng.random() < 0.2:
            can_id = CAN_EFF_FLAG | int(self.rng.integers(1 << 27)) << 2 | 1
        big = bool(self.rng.random() < 0.5)
        m = DrawnMessage(f"M{next(self._numbers)}", can_id, size, big)
        self.messages.append(m)
        if protected:
            self._protect(m)
        return m

    def _protect(self, m: DrawnMessage) -> None:
        kinds = [k for k in PROTECTIONS if k != "e2e_p5" or m.size > 7]
        kind = str(self.rng.choice(kinds))
        if kind == "none":
            return
        if kind.startswith("e2e"):
            self._e2e(m, kind)
            return
        m.protection["counter"] = {"signal": self._bits(m, 4, "", 1, 0, False)}
        if kind != "counter":
            name = self._byte(m)
            m.protection["checksum"] = {"kind": kind.removesuffix("_2"), "signal": name}
            if kind.endswith("_2"):
                m.protection["checksum"]["id_bytes"] = 2

    def _e2e(self, m: DrawnMessage, kind: str) -> None:
        bits = range(24) if kind == "e2e_p5" else range(16)
        m.used.update(bits if not m.big else (8 * (b // 8) + 7 - b % 8 for b in bits))
        rng = self.rng
        if kind == "e2e_p2":
            settings: dict[str, Any] = {"data_id": rng.integers(0, 256, 16).tolist()}
        else:
            settings = {"data_id": int(rng.integers(1, 65536))}
        if kind.startswith("e2e_p1"):
            settings["data_id_mode"] = kind.removeprefix("e2e_p1_")
        m.protection["checksum"] = {"kind": kind[:6], **settings}

    def _unit(self, dimension: str) -> tuple[str, str]:
        """Real unit, and the one that the database states."""
        unit = str(self.rng.choice(UNITS[dimension]))
        return unit, "" if self.rng.random() < NO_UNIT else unit

    def _sign(self) -> int:
        return -1 if self.rng.random() < OTHER_SIGN else 1

    def _signal(
        self, m: DrawnMessage, name: str, dimension: str, unit: tuple[str, str], sign: int,
        bits: int | None = None,
    ) -> dict[str, Any]:  # fmt: skip
        low, high = RANGES[name]
        si = find_unit(unit[0], dimension)
        low, high = (low - si.offset) / si.factor, (high - si.offset) / si.factor
        bits = bits or int(self.rng.integers(12, 17))
        scale = float(f"{(high - low) / (2**bits - 2):.3g}") * 1.01
        signed = bool(low < 0.0 and self.rng.random() < 0.5)
        offset = 0.0 if signed else float(f"{low:.6g}")
        path = f"{m.name}.{self._bits(m, bits, unit[1], scale, offset, signed)}"
        found: dict[str, Any] = {"signal": path}
        if unit[1] != unit[0]:
            found["unit"] = unit[0]
        if sign < 0:
            found["sign"] = -1
        return found

    def _bits(
        self, m: DrawnMessage, bits: int, unit: str, scale: float, offset: float, signed: bool
    ) -> str:
        """Put a signal at the first place that is free; return its name."""
        at = next(b for b in range(8 * m.size - bits + 1) if not m.used & set(range(b, b + bits)))
        return self._put(m, at, bits, unit, scale, offset, signed)

    def _byte(self, m: DrawnMessage) -> str:
        free = [b for b in range(0, 8 * m.size, 8) if not m.used & set(range(b, b + 8))]
        at = free[0] if self.rng.random() < 0.5 else free[-1]
        return self._put(m, at, 8, "", 1, 0, False)

    def _put(
        self, m: DrawnMessage, at: int, bits: int, unit: str, scale: float, offset: float,
        signed: bool,
    ) -> str:  # fmt: skip
        """A signal at a bit counted in the message's own order."""
        m.used.update(range(at, at + bits))
        start = 8 * (at // 8) + 7 - at % 8 if m.big else at
        name = f"S{next(self._names)}"
        raw = (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) if signed else (0, 2**bits - 1)
        ends = sorted(r * scale + offset for r in raw)
        m.lines.append(
            f" SG_ {name} : {start}|{bits}@{0 if m.big else 1}{'-' if signed else '+'} "
            f'({scale!r},{offset!r}) [{ends[0]!r}|{ends[1]!r}] "{unit}" B'
        )
        return name

    def _switch(self, m: DrawnMessage) -> str:
        return self._bits(m, 1, "", 1, 0, False)

    def _lever(self, m: DrawnMessage) -> dict[str, Any]:
        name = self._bits(m, 4, "", 1, 0, False)
        return {"signal": f"{m.name}.{name}", "equals": int(self.rng.integers(1, 8))}

    def _other_signals(self) -> None:
        """What a bus has besides, two messages of it, written from the drive's motion."""
        first, second = self._message(8, False), self._message(8, False)
        rpm = self._bits(first, 14, "rpm" if self.rng.random() < 0.7 else "", 1, 0, False)
        pedal = self._bits(first, 8, "%", 0.4, 0, False)
        torque = self._bits(first, 12, "Nm" if self.rng.random() < 0.7 else "", 0.5, -500, False)
        shown = self._bits(second, 12, "km/h", 0.1, 0, False)
        way = self._bits(second, 20, "km", 0.01, 0, False)
        coolant = self._bits(second, 8, "degC", 1, -40, False)
        volt = self._bits(second, 8, "V", 0.1, 0, False)
        self.decoys = [(first, [rpm, pedal, torque]), (second, [shown, way, coolant, volt])]


def drawn_model(seed: int) -> VehicleModel:
    """The model of a simulated drive, with every signal that such a bus has."""
    return random_model(seed)


def write_bus(seed: int, folder: Path, minutes: float) -> tuple[Path, Path, Path]:
    """Simulate a drive and write it; returns database, log and the configuration of the truth."""
    bus = ObfuscatedBus(seed)
    folder.mkdir(parents=True, exist_ok=True)
    database, log, config = folder / "bus.dbc", folder / "drive.log", folder / "truth.yaml"
    database.write_text(bus.database)
    config.write_text(yaml.safe_dump({"database": "bus.dbc", **bus.settings}))
    drive = simulate(drawn_model(seed), seed, minutes)
    frames = list(BusEncoder(load_config(config)).frames(drive))
    frames += _other_frames(bus, load_database(database), drive)
    whole = joined(frames)
    whole = whole.take(np.argsort(whole.t, kind="stable"))
    with CandumpWriter(log) as writer:
        writer.write_columns(
            FrameColumns(
                whole.t + EPOCH_S, whole.can_id, whole.length, whole.data, whole.channel,
                whole.channels, whole.fd,
            )
        )  # fmt: skip
    return database, log, config


def _other_frames(bus: ObfuscatedBus, database: Database, drive: Drive) -> list[FrameColumns]:
    """Engine speed with five gears, pedal, torque; shown speed, way, coolant, voltage."""
    truth = drive.truth
    found = []
    for number, ((message, names), cycle) in enumerate(zip(bus.decoys, (0.02, 0.1), strict=True)):
        t = np.arange(0.003, drive.duration_s - 0.01, cycle)
        v = np.abs(np.interp(t, truth.t, truth.speed))
        a = np.interp(t, truth.t, truth.acceleration)
        noise = np.random.default_rng([drive.seed, number]).standard_normal(len(t))
        columns: list[Array]
        if number == 0:
            gear = np.searchsorted([5.0, 10.0, 16.0, 23.0], v)
            ratio = np.array([120.0, 72.0, 50.0, 37.0, 30.0])[gear]
            pedal = np.clip(12.0 * (a + 0.3) + 0.6 * v, 0.0, 100.0)
            columns = [np.maximum(v * ratio, 800.0) + 8.0 * noise, pedal, 60.0 * a + 3.0 * v]
        else:
            way = 12_345.0 % 9000.0 + np.cumsum(v) * cycle / 1000.0
            warm = 90.0 - 60.0 * np.exp(-t / 200.0)
            columns = [3.6 * v * 1.06 + 1.0, way, warm, 14.0 + 0.1 * noise]
        description = database.message(message.name)
        data = compile_encode(description, names).encode_columns(columns)
        padded = np.zeros((len(t), 8), np.uint8)
        padded[:, : data.shape[1]] = data
        n = len(t)
        found.append(
            FrameColumns(
                t, np.full(n, description.can_id, np.uint32),
                np.full(n, description.length, np.uint8), padded, np.zeros(n, np.uint8), ("can0",),
            )
        )  # fmt: skip
    return found
