"""Find axes, wheels and sides in signal names. Names decide only if the data do not decide.

Choices from units and names alone, for quantities that the recording does not show, are never sure.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence

from imucald.config import Wheels
from imucald.discovery.candidates import SeenSignal, words
from imucald.discovery.proposal import MAX_ALTERNATIVES, Alternative, Choice, source_of

WHEELS = Wheels.__struct_fields__
_FRONT = ("front", "vorn", "vorne", "vorder", "av")
_REAR = ("rear", "back", "hinten", "hinter", "ar")
_LEFT, _RIGHT = ("left", "links"), ("right", "rechts")
_CORNERS = {
    name: wheel
    for wheel, names in zip(
        WHEELS, ("fl vl lf", "fr vr rf", "rl hl bl lr lh", "rr hr br rh"), strict=True
    )
    for name in names.split()
}
_AXES = {
    "x": ("longitudinal", "long", "lon", "laengs", "längs", "surge", "roll", "wank"),
    "y": ("lateral", "lat", "quer", "sway", "pitch", "nick"),
    "z": ("vertical", "vert", "hoch", "heave", "yaw", "gier"),
}
"""Beginnings of the words for a direction, or for a rotation about this direction (ISO 8855, DIN
70000)."""
_AXIS_LETTER = re.compile("(?:a|acc|accel|g|gyr|gyro|w|omega|r|rate|m|mag|b)?([xyz])")


def axes_by_name(candidates: Sequence[SeenSignal]) -> tuple[int, int, int] | None:
    """Return which of three signals are x, y and z, from a letter or a word for the direction in
    the names.

    A letter counts if the names differ only in this letter, as in AccX, AccY, AccZ. A word must be
    in each name: longitudinal, lateral, vertical, or roll, pitch, yaw, in English or German.
    """
    names = [c.signal.name for c in candidates]
    for place in range(min(map(len, names))):
        letters = "".join(n[place] for n in names).lower()
        rest = {n[:place] + n[place + 1 :] for n in names}
        if len(rest) == 1 and sorted(letters) == ["x", "y", "z"]:
            return letters.index("x"), letters.index("y"), letters.index("z")
    shared = next((i for i, cs in enumerate(zip(*names, strict=False)) if len(set(cs)) > 1), 0)
    for parts in ([words(n) for n in names], [words(n[shared:]) for n in names]):
        common = set.intersection(*map(set, parts))
        axes = [_axis_of([w for w in part if w not in common]) for part in parts]
        if sorted(axes) == ["x", "y", "z"]:
            return axes.index("x"), axes.index("y"), axes.index("z")
    return None


def _axis_of(parts: Sequence[str]) -> str:
    """Return the axis that the words of a name show; empty if they show no axis or several axes."""
    found = set()
    for word in parts:
        letter = _AXIS_LETTER.fullmatch(word)
        found |= {letter[1]} if letter else set()
        found |= {axis for axis, stems in _AXES.items() if word.startswith(stems)}
    return found.pop() if len(found) == 1 else ""


def wheel_by_name(name: str) -> str | None:
    """Return the wheel that a signal's name shows, or None."""
    parts = words(name)
    for part in reversed(parts):
        if part in _CORNERS:
            return _CORNERS[part]
    front, rear, left, right = (
        any(p in known for p in parts) for known in (_FRONT, _REAR, _LEFT, _RIGHT)
    )
    if front == rear or left == right:
        return None
    return f"{'front' if front else 'rear'}_{'left' if left else 'right'}"


_HINTS = {
    "gyroscope": ("gyro", "gyr", "rate", "gx", "omega", "roll", "pitch", "wank", "nick"),
    "wheel_speeds": ("wheel", "rad", "wheelspeed", "radgeschwindigkeit"),
    "accelerometer": ("accel", "acceleration", "acc", "ax", "beschl", "beschleunigung"),
    "speed": ("speed", "velocity", "geschwindigkeit", "vehspd", "vspd", "speedo", "v", "spd"),
    "steering_wheel_angle": ("steering", "steer", "lenkwinkel", "lws", "sas", "winkel"),
    "yaw_rate": ("yaw", "gierrate", "gier"),
    "lateral_acceleration": ("lateral", "lat", "querbeschl", "quer", "ay"),
    "longitudinal_acceleration": ("longitudinal", "long", "laengs", "längs", "ax"),
    "reverse": ("reverse", "rueckwaerts", "ruecklicht", "rückwärts", "backward", "gear", "gang"),
    "brake": ("brake", "bremse", "bremslicht", "brk", "stoplamp"),
    "temperature": ("temp", "temperature", "temperatur"),
    "heading": (
        "heading", "course", "bearing", "azimuth", "cog", "direction", "kurs", "richtung", "corso",
    ),
}  # fmt: skip


_OF_ANOTHER = frozenset((
    "set", "setpoint", "limit", "target", "desired", "soll", "max", "min", "cruise", "acc", "obj",
    "object", "rel", "lead", "setspeed", "tempomat", "wunsch",
))  # fmt: skip
"""Words in the names of a requested or allowed speed, or of another vehicle's speed."""


def is_of_another(name: str) -> bool:
    """True if a name is that of a requested or allowed value, or of another vehicle's value."""
    return not _OF_ANOTHER.isdisjoint(words(name))


def hint(quantity: str, candidate: SeenSignal) -> str | None:
    """Return the word in a signal's name that indicates a quantity, or None."""
    return named_so(quantity, candidate.signal.name)


def named_so(quantity: str, name: str) -> str | None:
    """Return the word in a name that indicates a quantity, or None."""
    known = _HINTS.get(quantity, ())
    for part in words(name):
        if part in known or any(len(k) > 4 and part.startswith(k) for k in known):
            return part
    return None


def same_family(a: str, b: str) -> bool:
    """True if two message names begin with the same word, such as INS_Acc_02 and INS_Temp."""
    first, second = words(a), words(b)
    return bool(first and second) and first[0] == second[0] and len(first[0]) > 1


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


def by_unit_and_name(
    name: str, dimension: str, candidates: Sequence[SeenSignal], why: str = ""
) -> Choice | None:
    """Return the choice from unit and name alone; None if there is none. Such a choice is never
    sure."""
    named = [
        c
        for c in candidates
        if c.states(dimension) and hint(name, c) and not is_of_another(c.signal.name)
    ]
    if not named:
        return None
    named.sort(key=lambda c: c.cycle)
    why = why or "chosen by unit and name only: the recording shows no motion to compare it with"
    others = [Alternative({"": source_of(c)}, "the same") for c in named[1 : 1 + MAX_ALTERNATIVES]]
    return Choice(name, {"": source_of(named[0])}, f"named {hint(name, named[0])!r}", why, others)
