"""List all numbers that the section `signals` of a configuration requests, with channel, quantity
and axis."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec import Struct

from imucald import config as cfg
from imucald.core.samples import QUANTITIES

Place = tuple[str | int, ...]

_WHEELS = ("front_left", "front_right", "rear_left", "rear_right")


class Wanted(Struct, frozen=True):
    """One number that the configuration requests."""

    channel: str
    dimension: str
    rank: int
    slot: int
    width: int
    planar: bool
    source: cfg.SourceSettings
    place: Place
    source_address: int | None = None


def wanted_numbers(signals: cfg.Signals) -> Iterator[Wanted]:
    """Yield every number that the section `signals` of the configuration requests."""
    for row in QUANTITIES.values():
        if row.width != 3:
            continue
        triads: Sequence[cfg.TriadSettings] | None = getattr(signals, row.key)
        for rank, triad in enumerate(triads or ()):
            place: Place = ("signals", row.key, rank)
            yield from _axes(row.channel, row.dimension, rank, triad, place)
    for sensor_index, sensor in enumerate(signals.parallel):
        address = sensor.source_address
        triad = cfg.TriadSettings(x=sensor.x, y=sensor.y, z=sensor.z, source_address=address)
        place = ("signals", "parallel", sensor_index)
        yield from _axes(f"parallel/{sensor.name}", sensor.kind, 0, triad, place)
    for row in QUANTITIES.values():
        if row.width != 1:
            continue
        sources: Sequence[cfg.SourceSettings] | None = getattr(signals, row.key)
        for rank, source in enumerate(sources or ()):
            place = ("signals", row.key, rank)
            address = source.source_address
            yield Wanted(row.channel, row.dimension, rank, 0, 1, False, source, place, address)
    if signals.wheel_speeds is not None:
        for slot, key in enumerate(_WHEELS):
            source = getattr(signals.wheel_speeds, key)
            place = ("signals", "wheel_speeds", key)
            address = source.source_address
            yield Wanted("wheel_speeds", "speed", 0, slot, 4, False, source, place, address)


def _axes(
    channel: str, dimension: str, rank: int, triad: cfg.TriadSettings, place: Place
) -> Iterator[Wanted]:
    planar = triad.z is None
    for slot, axis in enumerate("xyz"):
        source: cfg.SourceSettings | None = getattr(triad, axis)
        if source is not None:
            here = (*place, axis)
            own = source.source_address
            address = triad.source_address if own is None else own
            yield Wanted(channel, dimension, rank, slot, 3, planar, source, here, address)
