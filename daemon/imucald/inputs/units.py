"""Units of signals as written in databases and by users, and their conversion to SI."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import TypeVar
from unicodedata import normalize

from msgspec import Struct

from imucald.core.angles import RAD_PER_DEG
from imucald.core.errors import ConfigError
from imucald.core.samples import DIMENSIONS, GRAVITY


class Unit(Struct, frozen=True):
    """A unit of one dimension: ``si = factor * value + offset``."""

    dimension: str
    factor: float
    offset: float = 0.0


_TABLE: tuple[tuple[Unit, tuple[str, ...]], ...] = (
    (Unit("acceleration", 1.0), ("m/s^2", "m/s²", "m/s2", "m/s/s", "m/ss", "m/s**2", "mps2")),
    (Unit("acceleration", 1.0), ("mps^2", "meter/s^2", "m/sec^2", "ms-2", "ms2")),
    (Unit("acceleration", GRAVITY), ("g", "g0", "gn", "G", "G-force")),
    (Unit("acceleration", GRAVITY * 1e-3), ("mg", "milli-g")),
    (Unit("acceleration", 1e-3), ("mm/s^2", "mm/s²")),
    (Unit("acceleration", 0.3048), ("ft/s^2", "ft/s²")),
    (Unit("angular_rate", 1.0), ("rad/s", "rad/sec", "1/s")),
    (Unit("angular_rate", RAD_PER_DEG), ("deg/s", "°/s", "degree/s", "degrees/s", "deg/sec")),
    (Unit("angular_rate", RAD_PER_DEG), ("º/s", "dps", "grad/s", "degs")),
    (Unit("angular_rate", RAD_PER_DEG * 1e-3), ("mdeg/s", "mdps")),
    (Unit("angular_rate", RAD_PER_DEG / 3600.0), ("deg/h", "°/h")),
    (Unit("angle", 1.0), ("rad",)),
    (Unit("angle", RAD_PER_DEG), ("deg", "°", "degree", "degrees", "º", "grad", "degs")),
    (Unit("speed", 1.0), ("m/s", "mps", "m/sec", "meter/s", "ms-1")),
    (Unit("speed", 1.0 / 3.6), ("km/h", "kph", "kmh", "kmph", "km/hr", "KPH")),
    (Unit("speed", 1.0 / 3.6), ("km/u", "km/t", "km/st")),  # Dutch, Danish, Norwegian, Swedish
    (Unit("speed", 0.44704), ("mph", "mi/h", "miles/h")),
    (Unit("speed", 1852.0 / 3600.0), ("kn", "kt", "kts", "knot", "knots")),
    (Unit("speed", 0.3048), ("ft/s",)),
    (Unit("magnetic_field", 1.0), ("T",)),
    (Unit("magnetic_field", 1e-6), ("uT", "µT", "μT", "microtesla")),
    (Unit("magnetic_field", 1e-7), ("mG", "mGauss", "milligauss")),
    (Unit("magnetic_field", 1e-4), ("Gs", "Gauss", "gauss")),
    (Unit("magnetic_field", 1e-9), ("nT",)),
    (Unit("temperature", 1.0), ("degC", "°C", "C", "Celsius", "deg C", "ºC")),
    (Unit("temperature", 1.0, -273.15), ("K", "kelvin", "Kelvin")),
    (Unit("temperature", 5.0 / 9.0, -160.0 / 9.0), ("degF", "°F", "F")),
    (Unit("flag", 1.0), ("", "bool", "-", "%", "bit", "bar", "kPa")),
)  # fmt: skip

_EXACT: Mapping[tuple[str, str], Unit] = {
    (unit.dimension, name): unit for unit, names in _TABLE for name in names
}
_FOLDED: Mapping[tuple[str, str], Unit] = {
    (unit.dimension, name.casefold()): unit for unit, names in _TABLE for name in names
}

T = TypeVar("T")
_Part = tuple[float, tuple[tuple[str, int], ...]]
"""A part of a compound unit: the SI value of 1, and the base dimensions with their exponents."""


def _parts(dimension: tuple[tuple[str, int], ...], sizes: Mapping[str, float]) -> dict[str, _Part]:
    return {word: (size, dimension) for words, size in sizes.items() for word in words.split()}


_LENGTH, _TIME, _ANGLE = (("length", 1),), (("time", 1),), (("angle", 1),)
_SPEED = (("length", 1), ("time", -1))
_WORDS: Mapping[str, _Part] = {
    **_parts(_LENGTH, {"m meter metre": 1.0, "km kms": 1e3, "cm": 1e-2, "mm": 1e-3}),
    **_parts(_LENGTH, {"mile mi": 1609.344}),
    **_parts(_LENGTH, {"foot feet ft": 0.3048, "yard yd": 0.9144, "inch inches": 0.0254}),
    **_parts(_TIME, {"s sec second sek sekunde": 1.0, "ms msec": 1e-3, "us usec": 1e-6}),
    **_parts(_TIME, {"min minute": 60.0, "h hr hrs hour std stunde heure hora ora uur": 3600.0}),
    **_parts(_ANGLE, {"rad rads radian radiant": 1.0, "mrad": 1e-3, "mdeg": 1e-3 * RAD_PER_DEG}),
    **_parts(_ANGLE, {"deg degree grad °": RAD_PER_DEG, "arcsecond": RAD_PER_DEG / 3600.0}),
    **_parts(_SPEED, {"mps": 1.0, "kph kmh kmph": 1.0 / 3.6, "mph": 0.44704}),
    **_parts(_SPEED, {"knot knots kn kts": 1852.0 / 3600.0}),
    **_parts((("angle", 1), ("time", -1)), {"dps": RAD_PER_DEG}),
    **_parts((("length", 1), ("time", -2)), {"g gravity": GRAVITY, "mg": 1e-3 * GRAVITY}),
    **_parts((("warmth", 1),), {"c celsius kelvin k fahrenheit f": 1.0}),
    **_parts((("more", 1),), {  # not of motion: only recognised as units
        "v volt volts mv kv a amp amps ampere ma w watt watts kw n newton kn nm": 1.0,
        "j joule mj kj wh": 1.0,
        "pa pascal kpa hpa mpa bar mbar psi hz hertz khz rpm ohm l liter litre ml ul kg gram": 1.0,
        "db dbm lux day month year ah kwh mmhg pixel": 1.0,
    }),
    **_parts((("more", 1),), {"u r rev % percent": 1.0}),
    **_parts((), {"1 force of arc": 1.0, "kilo": 1e3, "milli": 1e-3, "centi": 1e-2, "micro": 1e-6}),
}  # fmt: skip
_POWERS = {"2": 2, "3": 3, "-1": -1, "-2": -2, "square": 2, "squared": 2, "cubic": 3, "inverse": -1}
_OF_BASE: Mapping[tuple[tuple[str, int], ...], str] = {
    _SPEED: "speed",
    _ANGLE: "angle",
    (("angle", 1), ("time", -1)): "angular_rate",
    (("length", 1), ("time", -2)): "acceleration",
}
LEAST_COUNTS = 4.0
"""In the text of a unit, a number of at least this value is a factor; a smaller number is an
exponent."""
_SHORTEST_CUT, _LONGEST_ENDING = 4, 2
"""Smallest length of a shortened word ("squar"), and largest length of an ending."""


def unit_names(dimension: str) -> tuple[str, ...]:
    """Return one accepted spelling for each unit of a dimension, for messages."""
    return tuple(names[0] for unit, names in _TABLE if unit.dimension == dimension)


def find_unit(text: str, dimension: str) -> Unit:
    """Return the unit of a dimension that `text` names.

    Raises ConfigError with a list of known units if the text is not a unit of this dimension.
    """
    name = text.strip()
    unit = (
        _EXACT.get((dimension, name))
        or _FOLDED.get((dimension, name.casefold()))
        or _in_words(name, dimension)
    )
    if unit is None and dimension == "flag":
        return Unit("flag", 1.0)
    if unit is None:
        known = ", ".join(unit_names(dimension))
        kind = dimension.replace("_", " ")
        raise ConfigError(f"{text!r} is not a unit of {kind} (known: {known})")
    return unit


def is_unit(text: str) -> bool:
    """True if a text is a known unit of any dimension. "counts" and "" are not units."""
    name = text.strip()
    return bool(name) and (
        any((d, name.casefold()) in _FOLDED for d in DIMENSIONS if d != "flag")
        or _of_words(name) is not None
    )


def _in_words(text: str, dimension: str) -> Unit | None:
    """Return the unit written in words ("Unit_KiloMeterPerHour", "kph / km/h"), if it is one."""
    ways = {_of_words(text)} - {None}
    if not any(way is not None and way[1] == dimension for way in ways):
        ways = {_of_words(_divided(text))}
    if not any(way is not None and way[1] == dimension for way in ways):
        ways = {_of_words(part) for part in re.split(r"\s/\s|\bor\b|\boder\b|[,;|]", text)}
    sizes = [way[0] for way in ways if way is not None and way[1] == dimension]
    agree = bool(sizes) and max(sizes) - min(sizes) <= 1e-9 * max(sizes)
    return Unit(dimension, sizes[0]) if agree else None


def _divided(text: str) -> str:
    """Replace the first separator between words by a fraction stroke ("km_h", "m_s2"). Some names
    and tools allow only an underscore.
    """
    return re.sub(r"(?<=[^\W\d_]|°)[_.\\-](?=[^\W\d_])", "/", text, count=1)


def _of_words(text: str) -> tuple[float, str] | None:
    """Return SI value and dimension of a unit in words or symbols. The dimension is "" if imucald
    has no quantity of this dimension. None if the text is not a unit."""
    tokens = list(_tokens(text))
    size, exponents, sign = 1.0, Counter[str](), 1
    last: tuple[_Part, int] | None = None
    waiting = 1
    for token in tokens:
        if token in ("/", "per", "pro"):
            sign, last = -1, None
            continue
        if token[0].isdigit() and float(token) >= LEAST_COUNTS:  # g/16384: 16384 counts are 1 g
            size *= float(token) ** sign
            continue
        power = _meant(token, _POWERS)
        if power is not None and last is None:
            waiting = power  # "per square second"
            continue
        part, times = (last[0], last[1] * (power - 1)) if last and power else (None, 0)
        if part is None:
            part, times = _meant(token, _WORDS), sign * waiting
            waiting = 1
        if part is None:
            return None
        size *= part[0] ** times
        exponents.update({base: n * times for base, n in part[1]})
        last = part, times
    base = tuple(sorted((name, n) for name, n in exponents.items() if n))
    return (size, _OF_BASE.get(base, "")) if base else None


def _tokens(text: str) -> Iterator[str]:
    """Yield words, signs and exponents of a unit in lower case, without accents."""
    plain = re.sub("[\u0300-\u036f]", "", normalize("NFKD", text.replace("º", "°")))
    plain = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", plain.replace("_", " ")).casefold()
    plain = re.sub(r"\bmps[ ^*-]*2\b", "m/s2", plain)  # the exponent belongs to the second
    plain = re.sub(r"^ *unit\b|'s\b", "", re.sub(r"\bper cent", "percent", plain))
    plain = re.sub(r"\^(?=[a-z])", "/", plain.replace("\u2212", "-"))
    for token in re.findall(r"[^\W\d]+|[°%/]|-?\d+(?:\.\d+)?", plain):
        prefix = re.match("kilo|milli|centi|micro", token)
        if prefix and prefix[0] != token:
            yield prefix[0]
        rest = token[prefix.end() :] if prefix and prefix[0] != token else token
        is_ratio = _meant(rest, _WORDS) is None and re.fullmatch(r"\w{3,}per\w{4,}", rest)
        yield from rest.partition("per") if is_ratio else (rest,)


def _meant(token: str, known: Mapping[str, T]) -> T | None:
    """Look up a token in a table. The token may be a complete word, a shortened word, or a word
    with an ending."""
    if token in known or len(token) < _SHORTEST_CUT:
        return known.get(token)
    for word, meaning in known.items():
        goes_on = token.startswith(word) and len(token) - len(word) <= _LONGEST_ENDING
        if len(word) >= _SHORTEST_CUT and (word.startswith(token) or goes_on):
            return meaning
    return None
