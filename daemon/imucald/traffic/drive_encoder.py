"""Encode samples to frames with the configuration that is used to decode the frames.

The routes of `inputs.wiring` define the signal, unit, counter and checksum of each quantity. This
module uses the same routes in the reverse direction. Therefore a simulated log can be written in
the frames of any vehicle that has a configuration.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import CLASSIC_BYTES, FD_BYTES, FrameColumns
from imucald.can.dbc.encode import compile_encode
from imucald.can.dbc.message import Signal
from imucald.can.dbc.resolved_signal import raw_limits
from imucald.can.e2e.protector import MessageProtector
from imucald.config import LoadedConfig, load_config
from imucald.config.root import example_path
from imucald.core.errors import ConfigError
from imucald.core.samples import direction_at
from imucald.inputs.conversion import Conversion
from imucald.inputs.routes import MessageRoute
from imucald.inputs.taps import Tap
from imucald.inputs.wiring import compile_router
from imucald.simulation.drive import Drive
from imucald.simulation.timing import frame_timing

CHANNEL = "can0"
"""Name of the recorded channel if the configuration names no channel."""


def example_config() -> LoadedConfig:
    """Return the configuration of the example bus (``imucald_example.dbc``)."""
    return load_config(example_path())


class BusEncoder:
    """Encodes drives to the frames of a vehicle.

    Raises ConfigError if the configuration names no message with simulated signals. Quantities of
    raw expressions, and messages whose signs are in other messages, cannot be written and are left
    out (`left_out`).
    """

    def __init__(self, loaded: LoadedConfig) -> None:
        routes = compile_router(loaded).routes
        messages = [r for r in routes if isinstance(r, MessageRoute) and not r.takes_signs]
        self._routes = [route for route in messages if route.taps]
        self.left_out = [route.name for route in routes if route not in messages]
        """Names of the routes that cannot be written."""
        if not self._routes:
            raise ConfigError(
                "no frame can be written: every signal of the configuration is a raw source, or "
                "has its sign in another message"
            )

    @property
    def ids(self) -> frozenset[int]:
        """The identifiers of the frames, with the flag for 29 bits."""
        return frozenset(route.plan.message.can_id for route in self._routes)

    def frames(self, drive: Drive) -> Iterator[FrameColumns]:
        """Yield the frames of each message in time order; t is in seconds since the drive's start.

        A value outside a signal's range is written as the nearest limit, as in a saturated sensor.
        """
        for route in self._routes:
            found = _message_frames(route, drive)
            if found is not None:
                yield found


def _message_frames(route: MessageRoute, drive: Drive) -> FrameColumns | None:
    taps = [tap for tap in route.taps if tap.channel in drive.samples]
    if not taps:
        return None
    leader = max(taps, key=lambda tap: len(drive.samples[tap.channel].t)).channel
    t = drive.samples[leader].t
    message = route.plan.message
    columns: dict[str, NDArray[np.float64]] = {}
    for tap in taps:
        rows = np.maximum(np.searchsorted(drive.samples[tap.channel].t, t, side="right") - 1, 0)
        for name, values in _tap_columns(route, tap, drive):
            columns.setdefault(name, values[rows])
    data = compile_encode(message, list(columns)).encode_columns(list(columns.values()))
    data = _protected(route, drive, leader, data)
    width = CLASSIC_BYTES if message.length <= CLASSIC_BYTES else FD_BYTES
    padded = np.zeros((len(t), width), np.uint8)
    padded[:, : data.shape[1]] = data
    return FrameColumns(
        t=t,
        can_id=np.full(len(t), message.can_id, np.uint32),
        length=np.full(len(t), message.length, np.uint8),
        data=padded,
        channel=np.zeros(len(t), np.uint8),
        channels=(route.match.channel or CHANNEL,),
        fd=np.ones(len(t), dtype=bool) if message.is_fd else None,
    )


def _tap_columns(
    route: MessageRoute, tap: Tap, drive: Drive
) -> Iterator[tuple[str, NDArray[np.float64]]]:
    """Yield name and physical values of each signal of a tap. There is one value for each sample of
    the channel."""
    series = drive.samples[tap.channel]
    for component, slot in zip(tap.components, tap.slots, strict=True):
        name = route.plan.signal_names[component.index]
        signal = route.plan.message.signal(name)
        values = series.values if series.values.ndim == 1 else series.values[:, slot]
        sign = route.signs.get(component.index)
        if tap.channel == "speed" and (signal.is_signed or sign is not None):
            # a speed signal that is negative in reverse
            values = values * direction_at(drive.samples.get("reverse"), series.t)
        physical = _physical(component.conversion, values)
        if isinstance(sign, int):
            bits = route.plan.message.signal(route.plan.signal_names[sign])
            yield bits.name, np.where(physical < 0.0, bits.scale + bits.offset, bits.offset)
            physical = np.abs(physical)
        yield name, _clipped(signal, physical)


def _physical(conversion: Conversion, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Convert values in SI to physical values of the database. The function is the inverse of
    `conversion.Conversion`."""
    if conversion.unit.dimension == "flag":
        return _flag_values(conversion, values)
    unit = conversion.unit
    result: NDArray[np.float64] = (
        values * conversion.sign - unit.offset
    ) / unit.factor - conversion.offset
    return result


def _flag_values(conversion: Conversion, values: NDArray[np.float64]) -> NDArray[np.float64]:
    on, off = 1.0, 0.0
    if conversion.on_values is not None:
        on = conversion.on_values[0]
        off = next(float(x) for x in range(len(conversion.on_values) + 1)
                   if x not in conversion.on_values)  # fmt: skip
    elif conversion.on_above is not None:
        on, off = conversion.on_above + 1.0, conversion.on_above
    return np.where(values > 0.5, on, off)


def _clipped(signal: Signal, values: NDArray[np.float64]) -> NDArray[np.float64]:
    if signal.is_float:
        return values
    ends = [raw * signal.scale + signal.offset for raw in raw_limits(signal)]
    low, high = float(min(ends)), float(max(ends))
    if signal.minimum is not None:
        low = max(low, signal.minimum)
    if signal.maximum is not None:
        high = min(high, signal.maximum)
    return np.clip(values, low, high)


def _protected(
    route: MessageRoute, drive: Drive, leader: str, data: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Add counter and checksum to frames. The counter also increases for lost frames, because the
    sender does not know that they are lost."""
    spec = route.checker.spec
    if spec.counter is None and spec.checksum is None:
        return data
    timing = frame_timing(getattr(drive.model, leader), leader, drive.seed, drive.duration_s)
    sent = np.flatnonzero(timing.kept)
    if len(sent) != len(data):
        return MessageProtector(spec).protect_columns(data)
    every = np.zeros((len(timing.kept), data.shape[1]), np.uint8)
    every[sent] = data
    return MessageProtector(spec).protect_columns(every)[sent]
