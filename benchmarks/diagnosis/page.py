"""The tables of docs/diagnosis-accuracy.md."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from benchmarks.diagnosis.judged import (
    NEAR_FLOOR,
    WITHIN_STD,
    Line,
    floors,
    force_error,
    hidden_names,
    invented,
    is_identifiable,
    mount_error,
    named,
    naming,
    outside_signals_are_right,
    relative_error,
    said_names,
    size_of,
    turned,
    turned_deviations,
    z_scores,
)
from benchmarks.measured import ROOT, verdict
from hidden import CAUSES, OUTSIDE

PAGE = ROOT / "docs" / "diagnosis-accuracy.md"
BEGIN, END = "<!-- figures -->", "<!-- end of figures -->"
SIZE_ORDER = ("small", "medium", "large")
BIASED_DEG, BIASED_STD = 0.1, 1.0
"""A mount is told of that an effect turns by more than this, in degrees or in deviations."""


def written(page: str, text: str, begin: str = BEGIN, end: str = END) -> str:
    """Return the page with the figures between two marks replaced."""
    head, rest = page.split(begin)
    _, tail = rest.split(end)
    return f"{head}{begin}\n{text}\n{end}{tail}"


def report(lines: Sequence[Line]) -> str:
    """All tables of what there is."""
    parts: dict[str, list[Line]] = {}
    for line in lines:
        parts.setdefault(line["part"], []).append(line)
    out: list[str] = []
    makers: tuple[tuple[str, Callable[[Sequence[Line]], Iterator[str]]], ...] = (
        ("naming", _naming),
        ("nulls", _nulls),
        ("pairs", _pairs),
        ("outside", _outside),
    )
    for name, maker in makers:
        if name in parts:
            out += [*maker(parts[name]), ""]
    if "naming" in parts:
        out += [*_parameters(parts["naming"]), "", *_gain(parts["naming"], parts.get("nulls", []))]
        out += ["", *_confusion(parts["naming"]), ""]
    out += _seconds(lines)
    return "\n".join(out)


def _share(yes: int, of: int, bar: float | None = None, most: bool = False) -> str:
    """`18 of 20 (90 %; bar 95 %: met)`."""
    share = yes / max(of, 1)
    text = f"{yes} of {of} ({100.0 * share:.1f} %"
    if bar is None:
        return text + ")"
    met = share <= bar if most else share >= bar
    sign = "at most " if most else ""
    return f"{text}; bar {sign}{100.0 * bar:g} %: {verdict(met)})"


def _naming(lines: Sequence[Line]) -> Iterator[str]:
    strong = [line for line in lines if is_identifiable(line)]
    how = Counter(naming(line) for line in strong)
    yield f"### One effect: {len(lines)} drives, {len(strong)} of medium size and up"
    yield ""
    good = how["right"] + how["set"]
    yield (
        "- Named rightly, alone or in an ambiguous set with at most two others: "
        + _share(good, len(strong), 0.95)
    )
    yield "- The single right cause: " + _share(how["right"], len(strong), 0.85)
    rest = ", ".join(f"{name} {how[name]}" for name in sorted(how) if name not in {"right", "set"})
    if rest:
        yield f"- The others: {rest}."
    yield ""
    yield "| effect | " + " | ".join(f"{s}: right, in a set, of" for s in SIZE_ORDER) + " |"
    yield "|---|" + "---|" * len(SIZE_ORDER)
    for cause in CAUSES:
        cells = []
        for size in SIZE_ORDER:
            some = [x for x in lines if hidden_names(x) == [cause] and size_of(x) == size]
            counts = Counter(naming(line) for line in some)
            cells.append(f"{counts['right']}, {counts['set']}, {len(some)}" if some else "")
        if any(cells):
            yield f"| {cause} | " + " | ".join(cells) + " |"


def _nulls(lines: Sequence[Line]) -> Iterator[str]:
    nothing = sum(line["said"]["verdict"] == "nothing" for line in lines)
    yield f"### No effect: {len(lines)} drives"
    yield ""
    yield "- `nothing`: " + _share(nothing, len(lines), 0.95)
    others = Counter(
        f"{line['said']['verdict']} {'+'.join(said_names(line))}".strip()
        for line in lines
        if line["said"]["verdict"] != "nothing"
    )
    if others:
        yield "- Else: " + ", ".join(f"{name} {n}" for name, n in others.most_common()) + "."


def _pairs(lines: Sequence[Line]) -> Iterator[str]:
    n = len(lines)
    both = sum(len(named(line)) == 2 for line in lines)
    one = sum(len(named(line)) >= 1 for line in lines)
    third = sum(bool(invented(line)) for line in lines)
    yield f"### Two effects at once: {n} drives, medium and large"
    yield ""
    yield "- Both named: " + _share(both, n, 0.75)
    yield "- At least one: " + _share(one, n, 0.97)
    yield "- Something named that is not there: " + _share(third, n, 0.05, most=True)
    missed = Counter(c for line in lines for c in hidden_names(line) if c not in named(line))
    extra = Counter(c for line in lines for c in invented(line))
    if missed:
        yield "- Missed: " + ", ".join(f"{name} {k}" for name, k in missed.most_common()) + "."
    if extra:
        yield "- Invented: " + ", ".join(f"{name} {k}" for name, k in extra.most_common()) + "."


def _outside(lines: Sequence[Line]) -> Iterator[str]:
    yield f"### Effects that the catalogue lacks: {len(lines)} drives"
    yield ""
    strong = [line for line in lines if is_identifiable(line)]
    for some, what in ((strong, "medium size and up"), (lines, "all sizes")):
        unknown = sum(
            line["said"]["verdict"] == "unknown" and outside_signals_are_right(line)
            for line in some
        )
        wrong = sum(bool(said_names(line)) for line in some)
        yield (
            f"- {what}: `unknown` with a right signal "
            + _share(unknown, len(some), 0.80)
            + "; something named "
            + _share(wrong, len(some), 0.10, most=True)
        )
    yield ""
    yield "| effect | size | unknown with right signals | nothing | something named | of |"
    yield "|---|---|---|---|---|---|"
    for cause in OUTSIDE:
        for size in SIZE_ORDER:
            some = [x for x in lines if hidden_names(x) == [cause] and size_of(x) == size]
            if not some:
                continue
            unknown = sum(
                x["said"]["verdict"] == "unknown" and outside_signals_are_right(x) for x in some
            )
            none = sum(x["said"]["verdict"] == "nothing" for x in some)
            said = Counter(name for x in some for name in said_names(x))
            names = ", ".join(f"{name} {n}" for name, n in said.most_common(3))
            count = sum(bool(said_names(x)) for x in some)
            yield (
                f"| {cause} | {size} | {unknown} | {none} | {count}"
                f"{f' ({names})' if names else ''} | {len(some)} |"
            )


def _parameters(lines: Sequence[Line]) -> Iterator[str]:
    strong = [x for x in lines if is_identifiable(x) and naming(x) in {"right", "set", "beside"}]
    z = np.abs(z_scores(strong))
    large = [e for x in strong if size_of(x) == "large" if (e := relative_error(x)) is not None]
    yield "### Parameters of the effects that were named, medium size and up"
    yield ""
    inside = int(np.sum(z <= WITHIN_STD))
    yield "- Within 3 of their own standard deviations: " + _share(inside, len(z), 0.95)
    near = sum(e <= 0.15 for e in large)
    yield "- Large effects within 15 % of what was hidden: " + _share(near, len(large))
    yield ""
    yield (
        "| effect | parameters within 3 std | largest, in std "
        "| relative error at large size, median | largest |"
    )
    yield "|---|---|---|---|---|"
    for cause in CAUSES:
        some = [x for x in strong if hidden_names(x) == [cause]]
        z = np.abs(z_scores(some))
        if not len(z):
            continue
        errors = [e for x in some if size_of(x) == "large" if (e := relative_error(x)) is not None]
        spread = f"{100 * np.median(errors):.1f} % | {100 * max(errors):.1f} %" if errors else " | "
        yield (
            f"| {cause} | {int(np.sum(z <= WITHIN_STD))} of {len(z)} | {z.max():.1f} | {spread} |"
        )


def _gain(lines: Sequence[Line], nulls: Sequence[Line]) -> Iterator[str]:
    yield "### What the extended model is worth"
    yield ""
    found = [x for x in lines if is_identifiable(x) and naming(x) == "right"]
    ratios = [max(r) for x in found if (r := floors(x))]
    near = sum(r <= NEAR_FLOOR for r in ratios)
    yield (
        "- Held-out residual within 10 % of the noise floor, in every signal that the found cause "
        "touches: " + _share(near, len(ratios))
    )
    held = [x["said"]["gain"]["held_out_log_likelihood"] for x in found]
    held = [h for h in held if h is not None]
    if held:
        yield (
            f"- Held-out log-likelihood rises in {_share(sum(h > 0 for h in held), len(held))}, "
            f"median {np.median(held):.0f} nats."
        )
    usual = [e for x in nulls if (e := mount_error(x, "before")) is not None]
    if usual:
        yield (
            f"- Mount angle without an effect: median {np.median(usual):.2f} deg, 90th percentile "
            f"{np.quantile(usual, 0.9):.2f} deg."
        )
    yield from _mounts(found)
    yield ""
    yield (
        "Medians over the drives in which the effect was found; the daemon's estimator on the same "
        "samples, without a model, with the baseline and with the extended model. Force: rms error "
        "of the corrected horizontal force, means of 1 s while driving. Turned: how far the effect "
        "turns the mount, against the same drive without it."
    )
    yield ""
    yield (
        "| effect | residual / floor before | after | mount, no model [deg] | baseline | extended "
        "| turned, baseline | extended | force, no model [m/s²] | baseline | extended |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|---|"
    for cause in CAUSES:
        some = [x for x in found if hidden_names(x) == [cause]]
        if some:
            yield f"| {cause} | {' | '.join(_gain_row(some))} |"


def _mounts(found: Sequence[Line]) -> Iterator[str]:
    """What becomes of the mounts that an effect had turned, by three measures of that."""
    without = partial(turned_deviations, stated="without")
    limits = (
        (turned_deviations, BIASED_STD, "the deviation that the daemon states of it then"),
        (without, BIASED_STD, "the deviation that it states without the effect"),
        (turned, BIASED_DEG, f"{BIASED_DEG} deg"),
    )
    for size, limit, words in limits:
        biased = [x for x in found if (size(x, "before") or 0.0) > limit]
        yield f"- Where the effect turns the mount by more than {words}:"
        for error, what in ((size, "the turn"), (mount_error, "the mount's whole error [deg]")):
            both = [(a, b) for x in biased if (a := error(x, "before")) is not None
                    if (b := error(x, "after")) is not None]  # fmt: skip
            if both:
                before, after = np.median(both, axis=0)
                yield (
                    f"  {what} falls in {_share(sum(b < a for a, b in both), len(both))}, "
                    f"median {before:.2f} to {after:.2f};"
                )
        left = [
            f"{hidden_names(x)[0]} {size(x, 'before'):.2f} to {size(x, 'after'):.2f}"
            for x in biased
            if (size(x, "after") or 0.0) >= (size(x, "before") or 0.0)
        ]
        yield f"  the turn does not fall: {', '.join(left) or 'nowhere'}."


def _gain_row(lines: Sequence[Line]) -> Iterator[str]:
    yield _median([max(before) for x in lines if (before := _ratios(x, "rms_before"))], ".2f")
    yield _median([max(after) for x in lines if (after := _ratios(x, "rms_after"))], ".2f")
    pair, triple = ("before", "after"), ("none", "before", "after")
    columns = ((mount_error, ".2f", triple), (turned, ".2f", pair), (force_error, ".3f", triple))
    for error, form, models in columns:
        for model in models:
            yield _median([e for x in lines if (e := error(x, model)) is not None], form)


def _ratios(line: Line, which: str) -> list[float]:
    touched = {s for cause in line["said"]["causes"] for s in cause["signals"]}
    return [
        s[which] / s["noise_floor"]
        for name, s in line["said"]["signals"].items()
        if name in touched and s["noise_floor"]
    ]


def _median(values: Sequence[float], form: str) -> str:
    return f"{np.median(values):{form}}" if values else ""


def _confusion(lines: Sequence[Line]) -> Iterator[str]:
    """Hidden against said, medium size and up; a drive counts once for every name said."""
    strong = [line for line in lines if is_identifiable(line)]
    present = [c for c in CAUSES if any(hidden_names(x) == [c] for x in strong)]
    columns = [*CAUSES, "in a set", "unknown", "nothing"]
    yield "### Hidden against said, medium size and up"
    yield ""
    yield (
        "Rows: what was hidden. Columns: what was said, by the rows' numbers; a drive counts once "
        "for each name. *set*: an ambiguous set with the right one."
    )
    yield ""
    heads = [str(i + 1) for i in range(len(CAUSES))] + ["set", "unknown", "nothing"]
    yield "| hidden | " + " | ".join(heads) + " |"
    yield "|---|" + "---|" * len(heads)
    for cause in present:
        counts: Counter[str] = Counter()
        for line in strong:
            if hidden_names(line) == [cause]:
                counts.update(_columns(line))
        cells = " | ".join(str(counts[c]) if counts[c] else "" for c in columns)
        yield f"| {CAUSES.index(cause) + 1} {cause} | {cells} |"


def _columns(line: Line) -> list[str]:
    how = naming(line)
    if how == "set":
        return ["in a set"]
    return said_names(line) or [str(line["said"]["verdict"])]


def _seconds(lines: Sequence[Any]) -> list[str]:
    seconds = [line["cpu_s"] for line in lines if line["cpu_s"] > 0.0]
    errors = sum(line["said"]["verdict"] == "error" for line in lines)
    if not seconds:
        return []
    text = (
        f"Processor time of `diagnose` a drive (20 to 30 min of driving): median "
        f"{np.median(seconds):.1f} s, longest {max(seconds):.1f} s."
    )
    return [text] + ([f"{errors} drives broke it off with an error."] if errors else [])
