"""Find axes, wheels and sides in signal names. Names decide only if the data do not decide."""

from __future__ import annotations

import re
from collections.abc import Sequence

from imucald.discovery.candidates import SeenSignal, words

WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
_FRONT, _REAR = ("f", "v", "front", "vorn", "vorne", "vorder", "av"), (
    "r", "h", "b", "rear", "back", "hinten", "hinter", "ar",
)  # fmt: skip
_LEFT, _RIGHT = ("l", "left", "links", "g"), ("r", "right", "rechts", "d")
_CORNERS = {
    **{a + b: WHEELS[0] for a in ("f", "v") for b in ("l",)},
    **{a + b: WHEELS[1] for a in ("f", "v") for b in ("r",)},
    **{a + b: WHEELS[2] for a in ("r", "h", "b") for b in ("l",)},
    **{a + b: WHEELS[3] for a in ("r", "h", "b") for b in ("r",)},
    "lf": WHEELS[0], "rf": WHEELS[1], "lr": WHEELS[2], "lh": WHEELS[2], "rh": WHEELS[3],
}  # fmt: skip
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
    front = any(p in _FRONT[2:] for p in parts)
    rear = any(p in _REAR[3:] for p in parts)
    left = any(p in _LEFT[1:3] for p in parts)
    right = any(p in _RIGHT[1:3] for p in parts)
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
