"""Measured columns as a candump log and the database that describes it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

START = 1_600_000_000.0
"""Stamp of the first frame: the recordings' own dates are left out."""
BITS = 16


@dataclass(frozen=True)
class Signal:
    """One column as the source gives it: its unit, the step it is sent with, and its values."""

    name: str
    unit: str
    step: float
    values: Array
    is_signed: bool = True


@dataclass(frozen=True)
class Message:
    """Columns with common times [s]; up to four signals of 16 bits each."""

    id: int
    name: str
    t: Array
    signals: tuple[Signal, ...]


@dataclass(frozen=True)
class BusRecording:
    """Frames as they were on the buses: times [s], channel, text of candump, and their database."""

    t: Array
    lines: list[str]
    database: str


def triad(
    id_: int, message: str, stem: str, unit: str, step: float, t: Array, values: Array,
    axes: str = "_X _Y _Z",
) -> Message:  # fmt: skip
    """Three axes (n, 3) as one message; axes: endings of their names, apart or one letter each."""
    names = axes.split() if " " in axes else list(axes)
    return Message(id_, message, t, tuple(
        Signal(f"{stem}{axis}", unit, step, values[:, i]) for i, axis in enumerate(names)
    ))  # fmt: skip


def write_log(folder: Path, recorded: list[Message] | BusRecording) -> None:
    """`drive.log` and `car.dbc`. Values are rounded to their steps and not changed otherwise."""
    folder.mkdir(parents=True, exist_ok=True)
    bus = recorded if isinstance(recorded, BusRecording) else _as_frames(recorded)
    (folder / "car.dbc").write_text(bus.database)
    stamps = bus.t - bus.t.min() + START
    order = np.argsort(stamps, kind="stable")
    with (folder / "drive.log").open("w") as file:
        file.writelines(f"({stamps[i]:.6f}) {bus.lines[i]}\n" for i in order)


def _as_frames(messages: list[Message]) -> BusRecording:
    return BusRecording(
        np.concatenate([message.t for message in messages]),
        [f"can0 {line}" for message in messages for line in _payloads(message)],
        _database(messages),
    )


def _payloads(message: Message) -> list[str]:
    """The frames' text after the interface: identifier and data."""
    columns = []
    for signal in message.signals:
        raw = np.round(np.asarray(signal.values, dtype=np.float64) / signal.step)
        low, high = _raw_range(signal)
        if not np.all((raw >= low) & (raw <= high)):
            raise ValueError(f"{message.name}.{signal.name}: a step of {signal.step} is too fine")
        columns.append(raw.astype(np.int64) & 0xFFFF)
    data = np.stack(columns, axis=1).astype("<u2")
    return [f"{message.id:03X}#{row.tobytes().hex().upper()}" for row in data]


def _raw_range(signal: Signal) -> tuple[int, int]:
    """Smallest and largest number that the field holds."""
    if signal.is_signed:
        return -(1 << (BITS - 1)), (1 << (BITS - 1)) - 1
    return 0, (1 << BITS) - 1


def _database(messages: list[Message]) -> str:
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: SENSOR GATEWAY"]
    for message in messages:
        lines.append(f"BO_ {message.id} {message.name}: {2 * len(message.signals)} SENSOR")
        for place, signal in enumerate(message.signals):
            low, high = (limit * signal.step for limit in _raw_range(signal))
            lines.append(
                f" SG_ {signal.name} : {BITS * place}|{BITS}@1{'-' if signal.is_signed else '+'}"
                f" ({signal.step:.12g},0) [{low:.12g}|{high:.12g}]"
                f' "{signal.unit}" GATEWAY'
            )
    return "\n".join(lines) + "\n"
