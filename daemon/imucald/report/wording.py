"""Texts about a diagnosis, for the terminal and the HTML page."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from imucald.diagnosis.causes import BY_NAME
from imucald.diagnosis.result import (
    OTHERWISE,
    UNBELIEVED,
    Candidate,
    Diagnosis,
    Estimated,
    FoundCause,
    Gain,
    Kind,
    SignalGain,
    Structure,
)
from imucald.report.model_changes import model_changes
from imucald.report.numbers import (
    TIMES,
    for_people,
    in_file,
    number,
    size_text,
    typographic,
    unit_text,
)
from imucald.report.titles import cause_title, key_title, signal_title

NOTHING_MEANS = (
    "Rows with 'nothing' may exceed the floor by what the tolerances of a correct model file allow."
)
UNCHANGED = "unchanged"
MANY = 4
"""Largest number of names in a sentence. Of a longer list, the first names are shown."""


class ParameterRow(NamedTuple):
    """One parameter of a cause: its key, value and unit as texts."""

    title: str
    value: str
    stated: str
    key: str
    """Key of the model file; empty if the model file has no such key."""
    in_file: str


class CandidateRow(NamedTuple):
    """A cause that was tested but not named in the diagnosis, as texts."""

    title: str
    outcome: str
    value: str
    shows: str
    """Smallest size at which these drives would have shown the cause."""


@dataclass(frozen=True)
class Words:
    """The texts of the verdict."""

    headline: str
    explanation: str
    next: str
    """What the user should do."""


class Card(NamedTuple):
    """A cause that was found, as texts."""

    name: str
    title: str
    certainty: str
    text: str
    rows: list[ParameterRow]
    evidence: str
    signals: list[str]
    against: list[str]


class SignalRow(NamedTuple):
    """The residual of a signal, as texts."""

    name: str
    verdict: str
    before: str
    after: str
    less: str
    floor: str
    unit: str
    slow: str
    left: str


def in_series(names: Sequence[str], last: str = "and") -> str:
    """Join names as in a sentence: `a, b and c`."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def few_of(names: Sequence[str], last: str) -> str:
    """Join names like `in_series`. For a long list, the result contains the first three names and
    the number of the others."""
    if len(names) <= MANY:
        return in_series(names, last)
    shown = MANY - 1
    return f"{', '.join(names[:shown])} {last} {len(names) - shown} others"


def ways_apart(group: Sequence[str]) -> list[str]:
    """Return the manoeuvres with which the causes of a group could be distinguished. These drives
    cannot distinguish the causes."""
    return list(dict.fromkeys(BY_NAME[name].separate for name in group if name in BY_NAME))


def against(cause: FoundCause, diagnosis: Diagnosis) -> list[str]:
    """Return the arguments against a cause. The texts contain the titles of other causes that fit
    as well."""
    texts = [typographic(text) for text in cause.against]
    groups = [g for g in diagnosis.look_alikes if cause.name in g]
    others = dict.fromkeys(cause_title(n) for g in groups for n in g if n != cause.name)
    if others:
        texts.append(f"{few_of([*others], 'and')} fit{'s' if len(others) == 1 else ''} as well")
    return texts


class Suspect(NamedTuple):
    """A cause that fits as well as a found cause, but is not in the extended model file."""

    name: str
    title: str
    text: str


def other_suspects(diagnosis: Diagnosis) -> list[Suspect]:
    """Return the causes that cannot be distinguished from a found cause and were not found
    themselves."""
    named = {cause.name for cause in (*diagnosis.causes, *diagnosis.likely)}
    names = dict.fromkeys(n for group in diagnosis.look_alikes for n in group if n not in named)
    return [Suspect(n, cause_title(n), BY_NAME[n].sentence) for n in names if n in BY_NAME]


def for_prediction_only(diagnosis: Diagnosis) -> str:
    """Return the reason why the extended model file may contain a wrong cause although its
    predictions are good; empty if all causes are certain."""
    sets = diagnosis.look_alikes
    if not sets:
        return ""
    count = "two" if len(sets) == 1 and len(sets[0]) == 2 else "several"
    return f"one of {count} causes that fit equally well"


def how_sure(cause: FoundCause, diagnosis: Diagnosis) -> str:
    """Return the certainty of a cause in one word: certain, likely, or ambiguous (other causes fit
    as well)."""
    is_confused = any(cause.name in group for group in diagnosis.look_alikes)
    return "ambiguous" if is_confused and cause.certainty == "certain" else cause.certainty


def look_alike_groups(diagnosis: Diagnosis) -> dict[tuple[str, ...], tuple[str, ...]]:
    """Return the groups of causes that these drives cannot distinguish: a mapping from the titles
    of each group (each title once) to the names."""
    return {tuple(cause_title(n) for n in names): names for names in diagnosis.look_alikes}


def verdict(diagnosis: Diagnosis) -> Words:
    """Return the verdict of the diagnosis and its certainty."""
    headline, explanation = _found_words(diagnosis)
    return Words(headline, explanation, next_step(diagnosis))


def _found_words(diagnosis: Diagnosis) -> tuple[str, str]:
    titles = [with_size(cause) for cause in diagnosis.causes]
    tail = _likely(diagnosis) + _incomplete(diagnosis)
    if diagnosis.verdict == "found":
        count = f"{_counted(len(titles))} certain."
        return f"Found: {in_series(titles)}", count + _left(diagnosis) + tail
    if diagnosis.verdict == "ambiguous":
        sizes = {cause_title(c.name): with_size(c) for c in diagnosis.causes}
        groups = [
            few_of([sizes.get(title, title) for title in of_group], "or")
            for of_group in look_alike_groups(diagnosis)
        ]
        confused = {name for group in diagnosis.look_alikes for name in group}
        sure = [cause_title(c.name) for c in diagnosis.causes if c.name not in confused]
        text = "Something is wrong, but these drives do not show which of these causes it is."
        if sure:
            text += f" Certain in any case: {in_series(sure)}."
        return f"Ambiguous: {'; '.join(groups)}", text + _left(diagnosis) + tail
    if diagnosis.verdict == "unknown":
        return _unknown(diagnosis, titles, tail)
    if diagnosis.likely:
        headline = f"Likely: {in_series([with_size(c) for c in diagnosis.likely])}"
        text = (
            "Nothing is certain. Likely causes pass a weaker test and are not written into the "
            "model file."
        )
    else:
        headline = f"Nothing found in {diagnosis.duration_s / 60.0:.3g} min of driving"
        text = (
            "The model fits these drives: predicted and measured signals differ by no more than "
            "noise and the tolerances of a correct model file."
        )
    undecided = sum(c.outcome == "not decidable here" for c in diagnosis.candidates)
    if undecided:
        text += (
            f" {undecided} of the causes cannot be decided with these drives; longer drives "
            "may show them."
        )
    return headline, text + _incomplete(diagnosis)


def _unknown(diagnosis: Diagnosis, titles: Sequence[str], tail: str) -> tuple[str, str]:
    where = _where(diagnosis)
    kinds = {s.kind for s in diagnosis.structure}
    if Kind.GOES_AGAINST in kinds:
        return (
            f"Unknown: opposite sign to the model's prediction in {where}",
            "A sign in the configuration or the mount in the model file is wrong. No parameter "
            "was fitted to these signals.",
        )
    text = "The measured signals differ from the model in a way that no known cause explains."
    if Kind.NOT_PLAUSIBLE in kinds:
        first = next(s for s in diagnosis.structure if s.kind == Kind.NOT_PLAUSIBLE)
        text = typographic(f"{first.text[:1].upper()}{first.text[1:]}.")
    headline = f"Unknown: the model does not explain {where}" if where else "Unknown"
    if titles:
        headline = f"Found: {in_series(titles)}. {headline}"
        text += f" These causes are certain nevertheless: {in_series(titles)}."
    return headline, text + tail


def with_size(cause: FoundCause) -> str:
    """Return the title of a cause with its size: `gyroscope bias (up: 1.00 deg/s)`. The size is the
    parameter that is furthest from the model file, in standard deviations."""
    title = cause_title(cause.name)
    known = BY_NAME.get(cause.name)
    own = {k: p for k, p in (cause.along_vehicle or cause.in_file).items() if k not in TIMES}
    if known is not None and known.lead:
        own = dict([*own.items()][: known.lead])
    if not own:
        return title

    def distance(key: str) -> float:
        p = own[key]
        return abs(p.value - p.stated) / p.std if p.std > 0.0 else 0.0

    key = max(own, key=distance)
    size, (quantity, _, way) = size_text(key, own[key]), key_title(key).partition(", ")
    variants = known.variants if known is not None else ()
    sections = {key.partition(".")[0] for keys in variants for key in keys}
    what = way or ("" if len(sections) == 1 and len(own) == 1 else quantity)
    return f"{title} ({what}: {size})" if what else f"{title} ({size})"


def next_step(diagnosis: Diagnosis) -> str:
    """Return what the user should do after this verdict, as sentences."""
    if not diagnosis.complete:
        return "Run the command again with --time-limit 300: the time limit ended the search."
    file = _use_of_file(diagnosis) if diagnosis.causes else ""
    if diagnosis.verdict == "unknown":
        return f"{_after_unknown(diagnosis)} {file}".strip()
    if diagnosis.verdict == "ambiguous":
        ways = _manoeuvres([name for group in diagnosis.look_alikes for name in group])
        return f"Record another drive{ways}, and diagnose it together with these logs. {file}"
    if _is_turned(diagnosis):
        return f"Fasten the sensor, and record a new drive. {file}"
    if diagnosis.causes:
        return file
    if diagnosis.likely:
        ways = _manoeuvres([cause.name for cause in diagnosis.likely])
        return f"Record a longer drive{ways}, and diagnose it together with these logs."
    return "Nothing to do: the model file fits these drives."


def _is_turned(diagnosis: Diagnosis) -> bool:
    return any(cause.name in ("mount_shift", "mount_creep") for cause in diagnosis.causes)


def _manoeuvres(names: Sequence[str]) -> str:
    """Return the manoeuvres that show which of these causes is true, in brackets."""
    ways = ways_apart(names)[:MANY]
    return f" ({'; '.join(ways)})" if ways else ""


def _after_unknown(diagnosis: Diagnosis) -> str:
    if Kind.GOES_AGAINST in {s.kind for s in diagnosis.structure}:
        return (
            "Run 'imucald check' on these logs, correct the sign that it names, and diagnose the "
            "logs again."
        )
    return (
        f"Look at {_where(diagnosis) or 'the signals'} in the pictures of the report. If the "
        "sensor is loose, fasten it. Otherwise the cause is one that imucald does not know."
    )


def _use_of_file(diagnosis: Diagnosis) -> str:
    use, why = advice(diagnosis)
    if use == UNCHANGED:
        signals = dict.fromkeys(n for cause in diagnosis.causes for n in cause.signals)
        where = f" ({in_series([signal_title(n) for n in signals])})" if signals else ""
        return f"Correct the cause in the sensor or its sender{where}: {why}."
    text = use.replace(" it", " the extended model file (--write-model FILE)", 1)
    return f"{text[:1].upper()}{text[1:]}: {why}."


def advice(diagnosis: Diagnosis) -> tuple[str, str]:
    """Return whether the user should use the extended model file ("it"), and the reason."""
    if not model_changes(diagnosis.model_before, diagnosis.model_after):
        return UNCHANGED, "the model file has no key for what was found"
    if diagnosis.recommended and not diagnosis.gain.was_fitted:
        return "use it", (
            "its new values were measured at stops or read from samples, so the fit does not change"
        )
    if diagnosis.recommended and _is_turned(diagnosis):
        return "use it for these drives only", "the sensor was turned during them"
    if diagnosis.recommended and (why := for_prediction_only(diagnosis)):
        return "use it for prediction only", f"it contains {why}"
    if diagnosis.recommended:
        return "use it", "it predicts better, on data that its fit did not see"
    if any(s.kind in UNBELIEVED for s in diagnosis.structure):
        why = f"the model does not explain {_where(diagnosis)}"
    elif diagnosis.gain.worse:
        names = in_series([signal_title(n) for n in diagnosis.gain.worse])
        why = (
            f"it predicts {names} worse. The causes are certain, but a written value that this "
            "signal shows is wrong"
        )
    else:
        why = "it does not predict held-out data better"
    return "do not use it", why


def _likely(diagnosis: Diagnosis) -> str:
    if not diagnosis.likely:
        return ""
    names = in_series([cause_title(c.name) for c in diagnosis.likely])
    return f" Likely, but not written into the file: {names}."


def _incomplete(diagnosis: Diagnosis) -> str:
    return (
        "" if diagnosis.complete else " The time limit ended the search: there may be more causes."
    )


def _where(diagnosis: Diagnosis) -> str:
    """Return a text with the signals whose residuals have an unexplained pattern."""
    return in_series(list(dict.fromkeys(signal_title(s.signal) for s in diagnosis.structure)))


def _left(diagnosis: Diagnosis) -> str:
    where = _where(diagnosis)
    return f" No known cause explains the remaining differences in {where}." if where else ""


def evidence(cause: FoundCause) -> str:
    """Return the evidence for a cause in one line; "" for direct evidence."""
    known = cause.evidence
    if "beyond_tolerance" not in known:
        return ""
    beyond, least = (number(known[name], 2) for name in ("beyond_tolerance", "threshold"))
    return f"{beyond} σ beyond the tolerance of a correct model file, threshold {least} σ"


def parameter_rows(cause: FoundCause) -> list[ParameterRow]:
    """Return the rows for the parameters of a cause: first the parameters along the sensor's axes
    (with the keys of the model file), then along the vehicle's axes."""
    rows = []
    for key, p in (*cause.in_file.items(), *cause.along_vehicle.items()):
        shown, stated = for_people(key, p)
        if key.startswith("_"):  # no key of the model file
            rows.append(ParameterRow(key_title(key), shown, "-", "", shown))
            continue
        of_file = "" if key in cause.along_vehicle else key
        rows.append(ParameterRow(key_title(key), shown, stated, of_file, in_file(p)))
    return rows


def card(cause: FoundCause, diagnosis: Diagnosis) -> Card:
    """Return the texts about a cause for terminal and page."""
    signals = [signal_title(name) for name in cause.signals]
    return Card(
        cause.name, cause_title(cause.name), how_sure(cause, diagnosis), typographic(cause.text),
        parameter_rows(cause), evidence(cause), signals, against(cause, diagnosis),
    )  # fmt: skip


def signal_rows(diagnosis: Diagnosis) -> list[SignalRow]:
    """Return the texts about the residuals of all signals for terminal and page."""
    return [
        SignalRow(
            signal_title(name), s.verdict, number(s.rms_before), number(s.rms_after), less(s),
            number(s.noise_floor), unit_text(s.unit),
            f"{number(s.slow_before)} → {number(s.slow_after)}", typographic(s.left),
        )
        for name, s in diagnosis.signals.items()
    ]  # fmt: skip


def not_named(diagnosis: Diagnosis) -> list[CandidateRow]:
    """Return the causes that were not named, sorted by their gain (largest first). Each has the
    smallest size at which these drives would have shown the cause."""
    ordered = sorted(
        diagnosis.candidates, key=lambda c: -c.nats if math.isfinite(c.nats) else math.inf
    )
    return [CandidateRow(cause_title(c.name), c.outcome, *_sizes(c)) for c in ordered]


def _sizes(c: Candidate) -> tuple[str, str]:
    """Return the estimated change of a cause's parameter, and the smallest size at which it would
    be visible."""
    if not math.isfinite(c.shows_from):
        return typographic(c.text), ""
    off = Estimated(c.off, c.std, c.unit, c.shows_from)
    value, least = for_people(c.key, off)
    why = OTHERWISE if c.text.endswith(OTHERWISE) else ""
    return f"{key_title(c.key)}: {value}", f"from {least} on{why}"


def gain(found: Gain) -> str:
    """Return the gain on held-out data in one line."""
    if not math.isfinite(found.held_out_log_likelihood):
        return "not known: the drives are too short to keep data back for the test"
    if not found.was_fitted:
        return "does not apply: the values were read directly and not fitted"
    low, high = found.interval
    return (
        f"{number(found.held_out_log_likelihood)} nats likelier "
        f"(95 % interval {number(low)} to {number(high)})"
    )


def less(signal: SignalGain) -> str:
    """Return the reduction of a residual in per cent."""
    if not signal.rms_before > 0.0 or not math.isfinite(signal.rms_after):
        return "-"
    share = 100.0 * (signal.rms_after / signal.rms_before - 1.0)
    return f"{share:+.0f} %" if abs(share) >= 0.5 else "0 %"


def _counted(n: int) -> str:
    names = ("No", "One", "Two", "Three", "Four", "Five", "Six")
    return f"{names[n] if n < len(names) else n} {'cause is' if n == 1 else 'causes are'}"


def structure_text(structure: Structure) -> str:
    """Return a text about an unexplained pattern, with the title of the parameter. If the parameter
    belongs to another sensor than the signal, the text states the other sensor."""
    key, text = structure.parameter, structure.text
    if not key:
        return typographic(text)
    is_own = structure.signal.startswith(key.partition(".")[0])
    of_another = "" if is_own else "the residual fits an error of another signal: "
    return typographic(of_another + key_title(key) + text.removeprefix(key))
