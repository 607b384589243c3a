"""Convert numbers to texts for people: significant digits, 95 % interval, units."""

from __future__ import annotations

import math
from collections.abc import Mapping

from imucald.core.angles import DEG_PER_RAD
from imucald.core.samples import GRAVITY
from imucald.diagnosis.result import Estimated
from imucald.mount.mount_words import SD_95

HUMAN_UNITS: Mapping[str, tuple[float, str]] = {
    "rad": (DEG_PER_RAD, "deg"),
    "rad/s": (DEG_PER_RAD, "deg/s"),
    "rad/s/K": (DEG_PER_RAD, "deg/s/K"),
    "rad/(m/s^2)": (DEG_PER_RAD * GRAVITY, "deg/g"),
    "(rad/s)/(m/s^2)": (DEG_PER_RAD * GRAVITY, "(deg/s)/g"),
    "m/s^2": (1000.0 / GRAVITY, "mg"),
    "m/s^2/K": (1000.0 / GRAVITY, "mg/K"),
    "s": (1000.0, "ms"),
    "1": (100.0, "%"),
    "": (100.0, "%"),
}
"""For each unit of the model file: factor and name of a familiar unit."""
TIMES = ("mount.shifts.t_s",)
"""Keys of times within a drive [s]. Other times are delays and are shown in milliseconds."""
LONG_S = 1.0
"""Times above this value are shown in seconds, shorter times in milliseconds [s]. Such a time
belongs to a stuck signal, not to a delay."""


def number(x: float, digits: int = 3) -> str:
    """Return a number with `digits` significant digits, without a power of ten if the text is
    short."""
    if not math.isfinite(x):
        return "-"
    if x == 0.0:
        return "0"
    size = math.floor(math.log10(abs(x)))
    if not -5 < size < 6:
        return f"{x:.{digits - 1}e}"
    return f"{x:.{max(0, digits - 1 - size)}f}"


def with_spread(value: float, std: float) -> str:
    """Return `value ± 95 %`, rounded to two digits of the interval's half width."""
    if not math.isfinite(value):
        return "-"
    if not math.isfinite(std) or std <= 0.0:
        return number(value, 4)
    half = SD_95 * std
    places = _places(half)
    if places is None:
        return f"{number(value, 3)} ± {number(half, 2)}"
    return f"{value:.{places}f} ± {half:.{places}f}"


def _places(half: float) -> int | None:
    """Return the number of decimals that show two digits of `half`; None if a power of ten is
    needed."""
    size = math.floor(math.log10(half)) if half > 0.0 else -99
    return max(0, 1 - size) if -7 < size < 6 else None


def for_people(key: str, p: Estimated) -> tuple[str, str]:
    """Return two texts in a familiar unit: the estimated value with its 95 % interval, and the
    value in the model file."""
    factor, unit = _familiar(key, p)
    shown = f"{with_spread(factor * p.value, factor * p.std)} {unit}".strip()
    return shown, f"{number(factor * p.stated)} {unit}".strip()


def size_text(key: str, p: Estimated) -> str:
    """Return the value in a familiar unit for a headline. A value of the model file that is not 0
    follows: `103 instead of 10.0 ms`."""
    factor, unit = _familiar(key, p)
    is_stated = bool(p.stated) and math.isfinite(p.stated)
    stated = f" instead of {number(factor * p.stated)}" if is_stated else ""
    return f"{number(factor * p.value)}{stated} {unit}".strip()


def _familiar(key: str, p: Estimated) -> tuple[float, str]:
    if key == "chassis.steering_ratio":  # not in per cent
        return 1.0, ""
    if key in TIMES or (p.unit == "s" and abs(p.value) >= LONG_S):
        return 1.0, "s"
    if key == "speed.delay_rate":
        return 1e6, "ppm"
    return HUMAN_UNITS.get(p.unit, (1.0, unit_text(p.unit)))


def in_file(p: Estimated) -> str:
    """Return the estimated value with its 95 % interval, in the unit of the model file."""
    return f"{with_spread(p.value, p.std)} {unit_text(p.unit)}".strip()


def unit_text(unit: str) -> str:
    """Return a unit in printed form, such as `m/s²` for `m/s^2`; "" for a number without a unit."""
    if unit == "1":
        return ""
    return unit.replace("^2", "²").replace("^3", "³").replace("*", "·")


def typographic(text: str) -> str:
    """Return a sentence with typographic characters instead of ASCII characters."""
    return text.replace("+-", "±").replace("^2", "²").replace("^3", "³")
