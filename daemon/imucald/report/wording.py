"""A diagnosis in words, for terminal and page alike: verdicts, names, numbers with spread."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from imucald.diagnosis.result import (
    GOES_AGAINST,
    NOT_PLAUSIBLE,
    Candidate,
    Diagnosis,
    Estimated,
    FoundCause,
    Gain,
    SignalGain,
)
from imucald.mount.mount_words import SD_95

CAUSES: Mapping[str, str] = {
    "accel_bias": "accelerometer bias",
    "accel_scale": "accelerometer scale",
    "accel_cross_axis": "accelerometer cross-axis",
    "accel_bias_temperature": "accelerometer drift with temperature",
    "accel_bias_drift": "accelerometer drift",
    "gyro_bias": "gyroscope bias",
    "gyro_scale": "gyroscope scale",
    "gyro_bias_temperature": "gyroscope drift with temperature",
    "g_sensitivity": "gyroscope g-sensitivity",
    "squat_dive": "squat and dive",
    "wheel_speed_scale": "speed scale (tyre radius)",
    "wheels_against_speed": "wheel speeds against vehicle speed",
    "yaw_rate_scale": "yaw-rate scale",
    "yaw_rate_offset": "yaw-rate offset",
    "steering_offset": "steering-angle offset",
    "delay_rate": "clocks that run apart",
    "dropouts": "drop-outs",
    "duplicated_frames": "doubled frames",
}
"""Titles that are more than the name with blanks; a new cause needs none."""

SIGNALS: Mapping[str, str] = {
    "accel": "accelerometer",
    "gyro": "gyroscope",
    "yaw_rate": "vehicle yaw rate",
    "lateral_accel": "vehicle lateral acceleration",
    "longitudinal_accel": "vehicle longitudinal acceleration",
    "speed": "speed beside the wheels",
}
PARTS: Mapping[str, str] = {
    **SIGNALS, "speed": "speed", "steering": "steering", "mount": "mount", "chassis": "chassis",
    "suspension": "suspension", "wheel_speeds": "wheel speeds",
}  # fmt: skip
AXES: Mapping[str, Mapping[str, str]] = {
    "vector": {"x": "forward", "y": "left", "z": "up"},
    "sensor": {"0": "sensor x", "1": "sensor y", "2": "sensor z"},
    "turn": {"x": "roll", "y": "pitch", "z": "yaw"},
    "lever_arm_m": {"0": "forward", "1": "left", "2": "up"},
    "cross_axis": {"0": "y in x", "1": "z in x", "2": "x in y", "3": "z in y", "4": "x in z",
                   "5": "y in z"},
}  # fmt: skip
QUANTITIES: Mapping[str, str] = {
    "lever_arm_m": "lever arm", "delay_s": "age", "delay_rate": "growth of age",
    "scale": "gain error", "offset": "offset", "turn": "turn", "bias": "zero error",
    "full_scale": "rail", "loss": "lost frames", "stuck_s": "stuck for", "doubled": "doubled",
    "clock_drift_ppm": "clock error", "steering_ratio": "steering ratio", "t_s": "time",
}  # fmt: skip

WORD = re.compile(r"\w+")
Z95 = 1.959964
"""Half width of a 95 % interval in standard deviations."""
G = 9.80665
DEG = math.degrees(1.0)
HUMAN_UNITS: Mapping[str, tuple[float, str]] = {
    "rad": (DEG, "deg"),
    "rad/s": (DEG, "deg/s"),
    "rad/s/K": (DEG, "deg/s/K"),
    "rad/(m/s^2)": (DEG * G, "deg/g"),
    "(rad/s)/(m/s^2)": (DEG * G, "(deg/s)/g"),
    "m/s^2": (1000.0 / G, "mg"),
    "m/s^2/K": (1000.0 / G, "mg/K"),
    "s": (1000.0, "ms"),
    "1": (100.0, "%"),
    "": (100.0, "%"),
}
"""Units in which people think, for those of the model file."""
PLAIN_KEYS = ("chassis.steering_ratio",)
"""Numbers without a unit that are no shares."""
RATES = ("speed.delay_rate",)


@dataclass(frozen=True)
class Words:
    """The verdict in words."""

    headline: str
    explanation: str


def cause_title(name: str) -> str:
    """Return what people call a cause."""
    return CAUSES.get(name, name.replace("_", " "))


def signal_title(name: str) -> str:
    """Return what people call a signal, as `accelerometer x` for `accel_x`."""
    if name in SIGNALS:
        return SIGNALS[name]
    sensor, _, axis = name.rpartition("_")
    way = AXES["vector"].get(axis, axis)
    return f"{SIGNALS[sensor]} {way}" if sensor in SIGNALS else name.replace("_", " ")


def key_title(key: str) -> str:
    """Return what people call a parameter: `lever arm, forward` for `mount.lever_arm_m.0`."""
    part, _, rest = key.removeprefix("_").partition(".")
    name, _, axis = rest.rpartition(".")
    name = name or rest
    quantity = QUANTITIES.get(name.rpartition(".")[2], name.rpartition(".")[2].replace("_", " "))
    if not rest.endswith(f".{axis}") or axis == rest:
        axis = ""
    kind = name if name in AXES else "sensor" if axis.isdigit() else "vector"
    way = AXES[kind].get(axis, axis.removesuffix("_deg").replace("_", " "))
    title = (
        quantity
        if part in ("mount", "chassis", "suspension")
        else (f"{PARTS.get(part, part.replace('_', ' '))} {quantity}")
    )
    return f"{title}, {way}" if way else title


def in_series(names: Sequence[str], last: str = "and") -> str:
    """Join as in speech: `a, b and c`."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def verdict(diagnosis: Diagnosis) -> Words:
    """Return what the diagnosis says, with how sure it is."""
    titles = [cause_title(cause.name) for cause in diagnosis.causes]
    tail = _advice(diagnosis) + _likely(diagnosis) + _incomplete(diagnosis)
    if diagnosis.verdict == "found":
        count = f"{_counted(len(titles))} certain."
        return Words(f"Found: {in_series(titles)}", count + _left(diagnosis) + tail)
    if diagnosis.verdict == "ambiguous":
        groups = [in_series([cause_title(n) for n in g], "or") for g in diagnosis.look_alikes]
        confused = {name for group in diagnosis.look_alikes for name in group}
        sure = [cause_title(c.name) for c in diagnosis.causes if c.name not in confused]
        text = "Something is wrong, and these drives cannot tell which of them it is."
        if sure:
            text += f" Beyond doubt about its kind is {in_series(sure)}."
        return Words(f"Ambiguous: {'; '.join(groups)}", text + _left(diagnosis) + tail)
    if diagnosis.verdict == "unknown":
        return _unknown(diagnosis, titles, tail)
    text = (
        "What the model predicts and what was measured differ by no more than noise and the "
        "tolerances of an honest model file."
    )
    return Words("Nothing found: the model fits", text + tail)


def _unknown(diagnosis: Diagnosis, titles: Sequence[str], tail: str) -> Words:
    where = _where(diagnosis)
    kinds = {s.kind for s in diagnosis.structure}
    if GOES_AGAINST in kinds:
        return Words(
            f"Unknown: against the model's prediction: {where}",
            "A sign in the configuration is wrong, or the mount in the model file: 'imucald "
            "check' looks for wrong signs. No parameter was fitted to that.",
        )
    text = "The measured signals differ from the model in a way that no known cause explains."
    if NOT_PLAUSIBLE in kinds:
        first = next(s for s in diagnosis.structure if s.kind == NOT_PLAUSIBLE)
        text = f"{first.text[:1].upper()}{first.text[1:]}."
    if titles:
        text += f" Besides, this was found: {in_series(titles)}."
    return Words(f"Unknown: something is left in {where}" if where else "Unknown", text + tail)


def _advice(diagnosis: Diagnosis) -> str:
    """Whether the extended file is worth using, in so many words."""
    if not diagnosis.causes:
        return ""
    if diagnosis.recommended:
        return " The extended model file predicts better, on data that its fit did not see: use it."
    if diagnosis.gain.worse:
        names = in_series([signal_title(n) for n in diagnosis.gain.worse])
        return f" The extended model file is not recommended: it predicts {names} worse."
    return " The extended model file is not recommended: it brings nothing on data not fitted."


def _likely(diagnosis: Diagnosis) -> str:
    if not diagnosis.likely:
        return ""
    names = in_series([cause_title(c.name) for c in diagnosis.likely])
    return f" Likely, and not written into the file: {names}."


def _incomplete(diagnosis: Diagnosis) -> str:
    return "" if diagnosis.complete else " The time limit ended the search: there may be more."


def _where(diagnosis: Diagnosis) -> str:
    """The signals that hold structure, in words."""
    return in_series(list(dict.fromkeys(signal_title(s.signal) for s in diagnosis.structure)))


def _left(diagnosis: Diagnosis) -> str:
    where = _where(diagnosis)
    return f" Something is left besides, in {where}, that no known cause explains." if where else ""


def with_titles(text: str, names: Iterable[str]) -> str:
    """Return a text with the names of causes as people call them."""
    known = set(names)
    return WORD.sub(lambda found: cause_title(found[0]) if found[0] in known else found[0], text)


def evidence(cause: FoundCause) -> str:
    """Return the evidence for a cause in one line."""
    known = cause.evidence
    parts = []
    if "sigma" in known:
        parts.append(f"{number(known['sigma'], 2)} standard deviations from the model file")
        if "quantile" in known:
            parts.append(f"named from tolerance + {number(known['quantile'], 2)} on")
    return "; ".join(parts)


def outcome(candidate: Candidate) -> str:
    """Return why a cause was not named."""
    return f"{candidate.outcome}: {typographic(candidate.text)}"


def gain(found: Gain) -> str:
    """Return the gain on held-out data in one line."""
    if not math.isfinite(found.held_out_log_likelihood):
        return "not known: the drives are too short to hold anything out"
    low, high = found.interval
    return (
        f"{number(found.held_out_log_likelihood)} nats likelier "
        f"(95 % interval {number(low)} to {number(high)})"
    )


def less(signal: SignalGain) -> str:
    """Return by how much a residual falls, in per cent."""
    if not signal.rms_before > 0.0 or not math.isfinite(signal.rms_after):
        return "-"
    share = 100.0 * (signal.rms_after / signal.rms_before - 1.0)
    return f"{share:+.0f} %" if abs(share) >= 0.5 else "0 %"


def number(x: float, digits: int = 3) -> str:
    """Return a number with so many significant digits, without powers of ten where it is short."""
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
    """Decimals that show two digits of it; None where that takes powers of ten."""
    size = math.floor(math.log10(half)) if half > 0.0 else -99
    return max(0, 1 - size) if -7 < size < 6 else None


def for_people(key: str, p: Estimated) -> tuple[str, str]:
    """Return value with spread, and what the file says, in the unit in which people think."""
    factor, unit = HUMAN_UNITS.get(p.unit, (1.0, unit_text(p.unit)))
    if key in PLAIN_KEYS:
        factor, unit = 1.0, ""
    elif key in RATES:
        factor, unit = 1e6, "ppm"
    shown = f"{with_spread(factor * p.value, factor * p.std)} {unit}".strip()
    return shown, f"{number(factor * p.stated)} {unit}".strip()


def in_file(p: Estimated) -> str:
    """Return value with spread in the model file's own unit."""
    return f"{with_spread(p.value, p.std)} {unit_text(p.unit)}".strip()


def unit_text(unit: str) -> str:
    """Return a unit as it is printed: `m/s²` for `m/s^2`, nothing for the plain number."""
    if unit == "1":
        return ""
    return unit.replace("^2", "²").replace("^3", "³").replace("*", "·")


def typographic(text: str) -> str:
    """Return a sentence with its signs as they are printed."""
    return text.replace("+-", "±").replace("^2", "²").replace("^3", "³")


def duration(seconds: float) -> str:
    """Return a length of time: `45 s`, `31 min`, `2.3 h`."""
    if not math.isfinite(seconds):
        return "-"
    if seconds < 100.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200.0 else f"{seconds / 3600:.1f} h"


def _counted(n: int) -> str:
    names = ("No", "One", "Two", "Three", "Four", "Five", "Six")
    return f"{names[n] if n < len(names) else n} {'cause is' if n == 1 else 'causes are'}"
