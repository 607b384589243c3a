"""Choices from units and names alone, for quantities that the recording does not show. No such
choice is sure."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

from imucald.discovery.candidates import SeenSignal
from imucald.discovery.names import WHEELS, axes_by_name, wheel_by_name
from imucald.discovery.proposal import Choice, source_of
from imucald.discovery.scalars import by_unit_and_name

WHY = "chosen by unit and names only: the recording does not confirm it, or contradicts its size"
_SENSORS = {
    "accelerometer": "acceleration",
    "gyroscope": "angular_rate",
    "magnetometer": "magnetic_field",
}


def by_names(candidates: Sequence[SeenSignal], found: set[str]) -> Iterator[Choice]:
    """Yield choices for quantities that are not `found` yet."""
    for quantity, dimension in _SENSORS.items():
        if quantity not in found:
            three = _three(candidates, dimension)
            if three is not None:
                text = f"three signals named x, y, z, in {three[0].unit}"
                sources = {a: source_of(c) for a, c in zip("xyz", three, strict=True)}
                yield Choice(quantity, sources, text, WHY)
    wheels = {
        wheel_by_name(c.signal.name): c
        for c in candidates
        if c.states("speed") and wheel_by_name(c.signal.name)
    }
    if "wheel_speeds" not in found and set(wheels) == set(WHEELS):
        sources = {wheel: source_of(wheels[wheel]) for wheel in WHEELS}
        yield Choice("wheel_speeds", sources, "four speeds with names of wheels", WHY)
    if "speed" not in found:
        used = {c.path for c in wheels.values()}
        others = [c for c in candidates if c.path not in used]
        choice = by_unit_and_name("speed", "speed", others, WHY)
        if choice is not None:
            yield choice


def _three(
    candidates: Sequence[SeenSignal], dimension: str
) -> tuple[SeenSignal, SeenSignal, SeenSignal] | None:
    """Return the first three signals of a message whose names are those of the axes x, y and z, in
    this order."""
    groups: dict[str, list[SeenSignal]] = {}
    for c in candidates:
        if c.states(dimension):
            groups.setdefault(c.message.name, []).append(c)
    for group in groups.values():
        for three in itertools.combinations(group[:12], 3):
            order = axes_by_name(three)
            if order is not None:
                x, y, z = (three[i] for i in order)
                return x, y, z
    return None
