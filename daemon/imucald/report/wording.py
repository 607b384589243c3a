"""A diagnosis in words, for terminal and page alike: verdicts, names, numbers with spread."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from imucald.diagnosis.result import GOES_AGAINST, Diagnosis, FoundCause, Gain, SignalGain

CAUSES: Mapping[str, str] = {
    "accel_bias": "accelerometer bias",
    "accel_scale": "accelerometer scale",
    "accel_cross_axis": "accelerometer cross-axis",
    "gyro_bias": "gyroscope bias",
    "gyro_scale": "gyroscope scale",
    "gyro_bias_temperature": "gyroscope drift with temperature",
    "g_sensitivity": "gyroscope g-sensitivity",
    "squat_dive": "squat and dive",
    "wheel_speed_scale": "speed scale (tyre radius)",
    "yaw_rate_scale": "yaw-rate scale",
    "yaw_rate_offset": "yaw-rate offset",
    "steering_offset": "steering-angle offset",
    "sensor_lowpass": "sensor low-pass",
    "dropouts": "drop-outs",
}
"""Titles that are more than the name with blanks; a new cause needs none."""

SIGNALS: Mapping[str, str] = {
    "accel": "accelerometer",
    "gyro": "gyroscope",
    "yaw_rate": "vehicle yaw rate",
    "lateral_accel": "vehicle lateral acceleration",
    "longitudinal_accel": "vehicle longitudinal acceleration",
}

CERTAIN = 0.999
"""Probabilities beyond it are said as "more than": the model of chance is not better than that."""

WORD = re.compile(r"\w+")

SENTENCE_END = re.compile(r"(?<=\.)\s+")

Z95 = 1.959964
"""Half width of a 95 % interval in standard deviations."""

HUMAN_UNITS: Mapping[str, tuple[float, str]] = {
    "rad": (math.degrees(1.0), "deg"),
    "rad/s": (math.degrees(1.0), "deg/s"),
    "rad/s/K": (math.degrees(1.0), "deg/s/K"),
    "rad/(m/s^2)": (math.degrees(9.80665), "deg/g"),
    "(rad/s)/(m/s^2)": (math.degrees(1.0), "(deg/s)/(m/s^2)"),
    "s": (1000.0, "ms"),
    "1": (100.0, "%"),
    "": (100.0, "%"),
}
"""Units in which people think, for those of the model file."""


@dataclass(frozen=True)
class Verdict:
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
    return f"{SIGNALS[sensor]} {axis}" if sensor in SIGNALS else name.replace("_", " ")


def in_series(names: Sequence[str], last: str = "and") -> str:
    """Join as in speech: `a, b and c`."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def verdict(diagnosis: Diagnosis) -> Verdict:
    """Return what the diagnosis says, with how sure it is."""
    titles = [cause_title(cause.name) for cause in diagnosis.causes]
    if diagnosis.verdict == "found":
        headline = f"Found: {in_series(titles)}" if titles else "Found"
        text = f"{_counted(len(titles))}{certainty(diagnosis.causes)}."
        return Verdict(headline, text + _confirmed(diagnosis) + _left(diagnosis))
    if diagnosis.verdict == "ambiguous":
        return _ambiguous(diagnosis, titles)
    if diagnosis.verdict == "unknown":
        where = _where(diagnosis)
        if any(s.kind == GOES_AGAINST for s in diagnosis.structure):
            return Verdict(
                f"Unknown: against the model's prediction: {where}",
                "A sign in the configuration is wrong, or the mount in the model file: 'imucald "
                "check' looks for wrong signs. No parameter was fitted to that.",
            )
        headline = f"Unknown: something is left in {where}" if where else "Unknown"
        text = "The measured signals differ from the model in a way that no known cause explains."
        if titles:
            text += f" Besides, this was found: {in_series(titles)}."
        return Verdict(headline, text)
    text = (
        "What the model predicts and what was measured differ by no more than noise and the "
        "tolerances of an honest model file."
    )
    return Verdict("Nothing found: the model fits", text)


def _ambiguous(diagnosis: Diagnosis, titles: Sequence[str]) -> Verdict:
    groups = [in_series([cause_title(n) for n in g], "or") for g in diagnosis.look_alikes]
    text = "Something is wrong, and these drives cannot tell which of them it is."
    confused = {name for group in diagnosis.look_alikes for name in group}
    sure = [cause for cause in diagnosis.causes if cause.name not in confused]
    if groups and sure:
        also = in_series([cause_title(cause.name) for cause in sure])
        text += f" Beyond doubt about its kind is {also}{certainty(sure)}."
    headline = "; ".join(groups) or in_series(titles, "or")
    return Verdict(f"Ambiguous: {headline}", text + _confirmed(diagnosis) + _left(diagnosis))


def _confirmed(diagnosis: Diagnosis) -> str:
    """A warning where data that the fit did not see do not speak for the extension."""
    low, high = diagnosis.gain.interval
    if low > 0.0 or not math.isfinite(low + high):
        return ""
    return (
        f" Held-out data do not confirm it: the 95 % interval of the gain is {number(low)} to "
        f"{number(high)} nats."
    )


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


def certainty(causes: Sequence[FoundCause]) -> str:
    """Return how sure the causes are, by the least sure of them; empty where it is not known."""
    known = [c.evidence["probability"] for c in causes if "probability" in c.evidence]
    if not known:
        return ""
    least = "at least " if len(known) > 1 and min(known) <= CERTAIN else ""
    each = "each " if len(known) > 1 else ""
    return f", {each}with a probability of {least}{percent(min(known))}"


def percent(p: float) -> str:
    """Return a probability for people: never 100 %."""
    if not math.isfinite(p):
        return "not known"
    if p > CERTAIN:
        return f"more than {100 * CERTAIN:.1f} %"
    if p < 1.0 - CERTAIN:
        return f"less than {100 * (1 - CERTAIN):.1f} %"
    return f"{100 * p:.1f} %"


def evidence(cause: FoundCause) -> str:
    """Return the evidence for a cause in one line."""
    known = cause.evidence
    parts = []
    if "probability" in known:
        parts.append(f"probability {percent(known['probability'])}")
    if "sigma" in known:
        parts.append(f"{number(known['sigma'], 2)} standard deviations from the model file")
    if "log_bayes_factor" in known:
        parts.append(f"log Bayes factor {number(known['log_bayes_factor'], 3)} nats")
    parts += [
        f"{name.replace('_', ' ')} {number(x, 3)}"
        for name, x in known.items()
        if name not in ("probability", "sigma", "log_bayes_factor")
    ]
    nats = cause.gain.get("held_out_log_likelihood", 0.0)
    if nats and math.isfinite(nats):
        parts.append(f"worth {number(nats, 3)} nats on held-out data")
    return "; ".join(parts)


def gain(found: Gain) -> str:
    """Return the gain on held-out data in one line."""
    if not math.isfinite(found.held_out_log_likelihood):
        return "not known: the drives are too short to hold anything out"
    low, high = found.interval
    return (
        f"{number(found.held_out_log_likelihood)} nats likelier "
        f"(95 % interval {number(low)} to {number(high)})"
    )


def mount_errors(found: Gain, unit: str = " deg") -> tuple[str, str] | None:
    """Return the mount error before and after [deg] as texts; None where it is not known."""
    before, after = found.mount_error_deg_before, found.mount_error_deg_after
    if before is None and after is None:
        return None
    return _degrees(before, unit), _degrees(after, unit)


def _degrees(x: float | None, unit: str) -> str:
    return "not known" if x is None or not math.isfinite(x) else f"{x:.2f}{unit}"


def ratio(signal: SignalGain, after: bool) -> float:
    """Return a residual's rms over its noise floor; not a number where there is no floor."""
    rms = signal.rms_after if after else signal.rms_before
    return rms / signal.noise_floor if signal.noise_floor > 0.0 else math.nan


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
    """Return `value ± std`, rounded to two digits of the deviation."""
    if not math.isfinite(value):
        return "-"
    if not math.isfinite(std) or std <= 0.0:
        return number(value, 4)
    places = _places(std)
    if places is None:
        return f"{number(value, 3)} ± {number(std, 2)}"
    return f"{value:.{places}f} ± {std:.{places}f}"


def interval(value: float, std: float) -> str:
    """Return the 95 % interval, rounded as `with_spread` does."""
    low, high = value - Z95 * std, value + Z95 * std
    if not (math.isfinite(low) and math.isfinite(high)):
        return "-"
    places = _places(std)
    if places is None:
        return f"{number(low, 4)} to {number(high, 4)}"
    return f"{low:.{places}f} to {high:.{places}f}"


def _places(std: float) -> int | None:
    """Decimals that show two digits of a deviation; None where that takes powers of ten."""
    size = math.floor(math.log10(std)) if std > 0.0 else -99
    return max(0, 1 - size) if -7 < size < 6 else None


def human(value: float, std: float, unit: str) -> str:
    """Return the same in a unit in which people think; empty where there is no other."""
    if unit not in HUMAN_UNITS:
        return ""
    factor, name = HUMAN_UNITS[unit]
    return f"{with_spread(factor * value, factor * std)} {name}"


def unit_text(unit: str) -> str:
    """Return a unit as it is printed: `m/s²` for `m/s^2`, nothing for the plain number."""
    if unit == "1":
        return ""
    return unit.replace("^2", "²").replace("^3", "³").replace("*", "·")


def plain_sentence(cause: FoundCause) -> str:
    """Return a cause's text without the sentences that repeat its parameters, if any is left."""
    parts = SENTENCE_END.split(cause.text)
    kept = [part for part in parts if not any(key in part for key in cause.parameters)]
    return typographic(" ".join(kept) or cause.text)


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
    return f"{names[n] if n < len(names) else n} {'cause' if n == 1 else 'causes'}"
