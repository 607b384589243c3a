"""A bus, its configurations and a scripted estimator, for tests of router, engine and daemon."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from imucald.can.columns import CAN_EFF_FLAG, FrameColumns
from imucald.can.dbc.database import load_database_text
from imucald.can.dbc.encode import compile_encode
from imucald.can.e2e.protector import MessageProtector
from imucald.config import LoadedConfig, parse_config
from imucald.core.rotations import rotation_from_angles
from imucald.inputs.settings_of_signals import checker_for
from imucald.inputs.wiring import compile_router
from imucald.mount.estimate import Correction, MountEstimate, MountState
from imucald.runtime.consumers import consumers_for
from imucald.runtime.engine import Engine
from imucald.runtime.output.output_frames import OutputFrames

Frame = tuple[float, int, bytes]
"""Stamp [s], id with the 29-bit flag, payload."""

DBC = """VERSION ""
NS_ :
BS_:
BU_: CAR

BO_ 256 ACC: 8 CAR
 SG_ AX : 0|16@1- (0.002,0) [-60|60] "m/s^2" CAR
 SG_ AY : 16|16@1- (0.002,0) [-60|60] "m/s^2" CAR
 SG_ AZ : 32|16@1- (0.002,0) [-60|60] "m/s^2" CAR
 SG_ ACNT : 48|4@1+ (1,0) [0|15] "" CAR
 SG_ ACRC : 56|8@1+ (1,0) [0|255] "" CAR

BO_ 272 ACC_XY: 4 CAR
 SG_ BX : 7|16@0- (0.0005,0) [0|0] "g" CAR
 SG_ BY : 23|16@0- (0.0005,0) [0|0] "g" CAR

BO_ 273 ACC_Z: 2 CAR
 SG_ BZ : 7|16@0- (0.0005,0) [0|0] "g" CAR

BO_ 2566844672 GYR: 8 CAR
 SG_ GX : 0|16@1- (0.01,0) [0|0] "deg/s" CAR
 SG_ GY : 16|16@1- (0.01,0) [0|0] "deg/s" CAR
 SG_ GZ : 32|16@1- (0.01,0) [0|0] "deg/s" CAR
 SG_ GCNT : 48|8@1+ (1,0) [0|255] "" CAR

BO_ 304 SPD: 4 CAR
 SG_ V : 0|16@1- (0.01,0) [0|0] "km/h" CAR
 SG_ VCNT : 16|4@1+ (1,0) [0|13] "" CAR

BO_ 305 SPD2: 2 CAR
 SG_ V2 : 0|16@1+ (0.1,0) [0|0] "mph" CAR

BO_ 320 MUX: 8 CAR
 SG_ SEL M : 0|8@1+ (1,0) [0|0] "" CAR
 SG_ YAW m0 : 8|32@1- (1,0) [0|0] "rad/s" CAR
 SG_ STEER m1 : 8|16@1- (0.1,0) [0|0] "deg" CAR
 SG_ LAT m1 : 24|16@1- (0.01,0) [0|0] "m/s^2" CAR
 SG_ ON m2 : 8|1@1+ (1,0) [0|0] "" CAR

BO_ 336 WHL: 8 CAR
 SG_ FL : 0|16@1+ (0.01,0) [0|0] "km/h" CAR
 SG_ FR : 16|16@1+ (0.01,0) [0|0] "km/h" CAR
 SG_ RL : 32|16@1+ (0.01,0) [0|0] "km/h" CAR
 SG_ RR : 48|16@1+ (0.01,0) [0|0] "km/h" CAR

BO_ 352 GEAR: 1 CAR
 SG_ G : 0|4@1+ (1,0) [0|0] "" CAR
 SG_ BRK : 4|4@1+ (1,0) [0|0] "" CAR

BO_ 368 MAG: 8 CAR
 SG_ MX : 0|16@1- (0.05,0) [0|0] "uT" CAR
 SG_ MY : 16|16@1- (0.05,0) [0|0] "uT" CAR
 SG_ MZ : 32|16@1- (0.05,0) [0|0] "uT" CAR

BO_ 384 PAR: 20 CAR
 SG_ PX : 0|32@1- (1,0) [0|0] "m/s^2" CAR
 SG_ PY : 32|32@1- (1,0) [0|0] "m/s^2" CAR
 SG_ PZ : 64|64@1- (1,0) [0|0] "m/s^2" CAR
 SG_ PCNT : 128|8@1+ (1,0) [0|255] "" CAR

BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","StandardCAN_FD","ExtendedCAN_FD";
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "GenMsgCycleTime" BO_ 256 10;
BA_ "VFrameFormat" BO_ 384 2;
SIG_VALTYPE_ 320 YAW : 1;
SIG_VALTYPE_ 384 PX : 1;
SIG_VALTYPE_ 384 PY : 1;
SIG_VALTYPE_ 384 PZ : 2;
"""
"""Everything that a configuration can ask of a message: protected, split, multiplexed, float, FD,
29-bit id, two byte orders."""

RICH = """
database: bus.dbc
signals:
  accelerometer:
    - {x: ACC.AX, y: ACC.AY, z: ACC.AZ}
    - {x: ACC_XY.BX, y: ACC_XY.BY, z: {signal: ACC_Z.BZ, not_available: [-32768]}}
  gyroscope: {x: GYR.GX, y: {signal: GYR.GY, sign: -1}, z: {signal: GYR.GZ, offset: 0.25}}
  magnetometer: {x: MAG.MX, y: MAG.MY, z: MAG.MZ}
  speed:
    - {signal: SPD.V, range: [-300, 300]}
    - SPD2.V2
    - raw: {id: 0x7E8, when: "data[1] == 0x41 and data[2] == 0x0D", value: "data[3]"}
      unit: km/h
  wheel_speeds: {front_left: WHL.FL, front_right: WHL.FR, rear_left: WHL.RL, rear_right: WHL.RR}
  steering_wheel_angle: MUX.STEER
  yaw_rate: MUX.YAW
  lateral_acceleration: {signal: MUX.LAT, range: [-20, 20]}
  brake: {signal: GEAR.BRK, above: 2}
  parallel:
    - {name: second, kind: acceleration, x: PAR.PX, y: PAR.PY, z: PAR.PZ, id: 0x1ABCDE}
messages:
  ACC:
    counter: {signal: ACNT, max_step: 2}
    checksum: {kind: crc8_j1850, signal: ACRC, id_bytes: 2}
  GYR: {counter: {signal: GCNT}, cycle_time: 0.01, timeout_cycles: 20, recover_after: 1}
  SPD: {counter: {signal: VCNT, modulus: 14}, recover_after: 0}
output: {status_rate: 5}
"""

PLANAR = """
database: bus.dbc
signals:
  accelerometer: {x: ACC_XY.BX, y: ACC_XY.BY}
  wheel_speeds: {front_left: WHL.FL, front_right: WHL.FR, rear_left: WHL.RL, rear_right: WHL.RR}
  reverse: {signal: GEAR.G, equals: [1, 9]}
  brake: MUX.ON
  yaw_rate:
    - MUX.YAW
    - {signal: GYR.GZ}
  parallel: [{name: flat, kind: angular_rate, x: GYR.GX, y: GYR.GY, id: 0x700}]
messages:
  ACC_XY: {cycle_time: 0.02}
output: {status_rate: 10, checksum: xor}
"""

SPLIT = """
database: bus.dbc
signals:
  accelerometer:
    x: {raw: {id: 0x111, value: "(data[0] << 8 | data[1]) / 1000"}, unit: g}
    y: {raw: {id: 0x110, value: "data[1] - 128"}, unit: m/s^2, range: [-90, 90]}
    z: {raw: {id: 0x110, value: "data[3]", when: "data[0] != 7"}, unit: m/s^2}
  gyroscope:
    - {x: GYR.GX, y: GYR.GY, z: GYR.GZ}
    - {x: MUX.YAW, y: {signal: MAG.MY, unit: deg/s}, z: {signal: MAG.MZ, unit: deg/s}}
  speed:
    - {raw: {id: 0x131, value: "data[0]"}, unit: km/h}
    - SPD.V
output: {status_rate: 1, ids: {acceleration: 0x650, angular_rate: 0x1640000}}
"""

CLASH = """
database: bus.dbc
signals:
  accelerometer:
    - {x: ACC.AX, y: ACC.AY, z: ACC.AZ}
    - x: {raw: {id: 0x100, value: "data[0] - 100"}, unit: m/s^2}
      y: {raw: {id: 0x100, value: "data[2] - 100"}, unit: m/s^2}
      z: {raw: {id: 0x110, value: "data[3] - 100"}, unit: m/s^2}
    - {x: MUX.LAT, y: ACC.AX, z: {raw: {id: 0x140, value: "data[7]"}, unit: m/s^2}}
  speed:
    - {signal: SPD.V, range: [-100, 100]}
    - {raw: {id: 0x130, value: "data[0]"}, unit: km/h}
    - WHL.FL
  wheel_speeds: {front_left: WHL.FL, front_right: WHL.FR, rear_left: SPD.V, rear_right: WHL.RR}
  brake: [GEAR.BRK, {raw: {id: 0x160, value: "data[0] == 4 or length > 3"}}, GEAR.G]
messages:
  ACC: {counter: {signal: ACNT}, checksum: {kind: xor, signal: ACRC}, recover_after: 2}
"""

AIDED = """
database: bus.dbc
signals:
  accelerometer: {x: ACC.AX, y: ACC.AY, z: ACC.AZ}
  gyroscope: {x: GYR.GX, y: GYR.GY, z: GYR.GZ}
  magnetometer: {x: MAG.MX, y: MAG.MY, z: MAG.MZ}
  speed: [SPD.V, SPD2.V2]
  heading: {signal: MUX.STEER}
attitude: {enabled: true, filter: {heading: signal}}
travel_direction: {enabled: true}
"""

CONFIGS = {"aided": AIDED, "clash": CLASH, "rich": RICH, "planar": PLANAR, "split": SPLIT}


def load(text: str, folder: Path, dbc: str = DBC) -> LoadedConfig:
    """Parse a configuration whose database is `bus.dbc` in `folder`, which is written."""
    (folder / "bus.dbc").write_text(dbc, encoding="ascii")
    return parse_config(text, folder / "config.yaml")


@dataclass
class ScriptedEstimator:
    """Records what it is told; its corrections change with every tick, and come and go."""

    rows: list[bytes] = field(default_factory=list)
    """Bytes of every tick, `b"gap"` where time was said to jump."""
    steps: int = 0
    usable_from: int = 3

    @property
    def correction(self) -> Correction | None:
        k = self.steps
        if k < self.usable_from or k % 17 == 16:
            return None
        return Correction.turning(self._rotation())

    @property
    def state(self) -> MountState:
        return MountState(self.steps % 6)

    def _rotation(self) -> np.ndarray:
        k = self.steps
        return rotation_from_angles(0.01 * k, 0.3 - 0.02 * k, 2.0 + 0.1 * k)

    def step(self, tick: Sequence[float]) -> None:
        self.rows.append(np.array(tick).tobytes())
        self.steps += 1

    def gap(self) -> None:
        self.rows.append(b"gap")

    def estimate(self) -> MountEstimate:
        covariance = np.diag([1e-4, 2e-4, 1e-6 * (1 + self.steps)])
        return MountEstimate(self.state, self._rotation(), covariance)


class Fine(ScriptedEstimator):
    """Always has the same correction, and is sure of it."""

    @property
    def correction(self) -> Correction:
        return Correction.turning(np.eye(3))

    @property
    def state(self) -> MountState:
        return MountState.FINE


def engine_of(
    loaded: LoadedConfig,
    estimator: object | None = None,
    new_estimator: Callable[[], object] = ScriptedEstimator,
    **options: object,
) -> Engine:
    """An engine with a scripted estimator. new_estimator: makes the next ones."""
    output = OutputFrames(loaded.config)
    firsts = [] if estimator is None else [estimator]
    return Engine(
        compile_router(loaded),
        lambda: firsts.pop() if firsts else new_estimator(),
        output,
        loaded.config.output.status_rate,
        consumers=consumers_for(loaded, output),
        **options,
    )


def columns_of(frames: Iterable[Frame], channel: str = "can0") -> FrameColumns:
    """The same frames as columns."""
    frames = list(frames)
    width = 8 if all(len(data) <= 8 for _, _, data in frames) else 64
    data = np.zeros((len(frames), width), np.uint8)
    for i, (_, _, payload) in enumerate(frames):
        data[i, : len(payload)] = np.frombuffer(payload, np.uint8)
    return FrameColumns(
        np.array([t for t, _, _ in frames], np.float64),
        np.array([can_id for _, can_id, _ in frames], np.uint32),
        np.array([len(payload) for _, _, payload in frames], np.uint8),
        data,
        np.zeros(len(frames), np.uint8),
        (channel,),
    )


def frames_of(columns: FrameColumns | None) -> list[tuple[int, bytes]]:
    """Ids and payloads of columns."""
    if columns is None:
        return []
    return [
        (can_id, data[:length].tobytes())
        for can_id, length, data in zip(
            columns.can_id.tolist(), columns.length.tolist(), columns.data, strict=True
        )
    ]


MESSAGES = {m.name: m for m in load_database_text(DBC, "dbc").messages.values()}
OBD_ANSWER = 0x7E8


class Sender:
    """Encodes frames of the test bus, with the protection that a configuration asks for."""

    def __init__(self, loaded: LoadedConfig | None = None) -> None:
        self._protectors: dict[str, MessageProtector] = {}
        for name in loaded.config.messages if loaded is not None else ():
            spec = checker_for(MESSAGES[name], loaded.config.messages[name]).spec
            self._protectors[name] = MessageProtector(spec)

    def frame(self, t: float, message: str, **values: float) -> Frame:
        """One frame; signals not named are zero."""
        found = MESSAGES[message]
        select = {n: int(values.pop(n)) for n in list(values) if found.signals[n].is_multiplexer}
        plan = compile_encode(found, list(values), multiplexer=select)
        payload = plan.encode(list(values.values()))
        if message in self._protectors:
            payload = self._protectors[message].protect(payload)
        return t, found.can_id, payload


class Traffic:
    """Random frames of the test bus: most good, some damaged in every way there is."""

    def __init__(self, rng: random.Random, loaded: LoadedConfig, damage: float = 0.06) -> None:
        self._rng = rng
        self._damage = damage
        self._sender = Sender(loaded)
        self._t = 1.6e9 + rng.random() * 1e6
        self._names = rng.sample(sorted(MESSAGES), rng.randint(2, len(MESSAGES)))
        self._last: Frame | None = None

    def frames(self, n: int) -> list[Frame]:
        """The next n frames."""
        return [self._next() for _ in range(n)]

    def _next(self) -> Frame:
        rng = self._rng
        self._t += self._pause()
        kind = rng.random()
        if kind < 0.04:
            frame: Frame = (self._t, OBD_ANSWER, self._obd())
        elif kind < 0.06:
            can_id = rng.choice([0x7FF, 0x111, 0x110 | CAN_EFF_FLAG, 0x131])
            frame = (self._t, can_id, rng.randbytes(rng.randint(0, 8)))
        else:
            frame = self._of_message(rng.choice(self._names))
        if rng.random() < self._damage:
            frame = self._damaged(frame)
        self._last = frame
        return frame

    def _pause(self) -> float:
        rng = self._rng
        kind = rng.random()
        if kind < 0.90:
            return rng.choice([0.0, 0.0002, 0.001, 0.004, 0.01, 0.013])
        if kind < 0.97:
            return rng.uniform(0.0, 0.3)
        if kind < 0.985:
            return -rng.uniform(0.0, 0.9)
        if kind < 0.993:
            return rng.uniform(0.5, 4.0)
        return rng.choice([11.0, 40.0, -1.2, -3600.0])

    def _obd(self) -> bytes:
        rng = self._rng
        pid = rng.choice([0x0D, 0x0D, 0x0C])
        return bytes([3, rng.choice([0x41, 0x41, 0x7F]), pid, rng.randrange(256), 0, 0, 0, 0])

    def _of_message(self, name: str) -> Frame:
        rng = self._rng
        found = MESSAGES[name]
        if rng.random() < 0.1:  # any bits: not available, saturated, NaN, foreign multiplexer
            payload = rng.randbytes(found.length)
            return self._t, found.can_id, payload
        values: dict[str, float] = {}
        select = rng.choice([0, 0, 1, 1, 2])
        for signal in found.signals.values():
            if signal.name.endswith(("CNT", "CRC")):
                continue
            if signal.is_multiplexer:
                values[signal.name] = float(select)
            elif not signal.selectors or select in signal.selectors[0][1]:
                values[signal.name] = self._value(signal)
        return self._sender.frame(self._t, name, **values)

    def _value(self, signal: object) -> float:
        rng = self._rng
        if signal.is_float:
            return rng.choice([0.0, -1.5, rng.gauss(0.0, 3.0), 1e5])
        ends = 1 << (signal.length - signal.is_signed)
        raw = rng.randrange(-ends if signal.is_signed else 0, ends)
        if rng.random() < 0.7:
            raw = raw // 16
        value = raw * signal.scale + signal.offset
        if signal.minimum is not None:
            value = min(max(value, signal.minimum), signal.maximum)
        return value

    def _damaged(self, frame: Frame) -> Frame:
        rng = self._rng
        t, can_id, data = frame
        kind = rng.randrange(5)
        if kind == 0 and self._last is not None:  # sent again
            return t, self._last[1], self._last[2]
        if kind == 1:
            return t, can_id, data[: rng.randint(0, len(data))]
        if kind == 2:  # longer than it should be: no fault
            return t, can_id, data + rng.randbytes(max(0, 8 - len(data)))
        if kind == 3 and data:
            bits = bytearray(data)
            bits[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
            return t, can_id, bytes(bits)
        return t, can_id, b"\xff" * len(data)
