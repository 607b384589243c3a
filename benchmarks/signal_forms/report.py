"""What came of all runs, one line a form, and which bars it does not meet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from benchmarks.signal_forms.forms import FORMS, Form
from benchmarks.signal_forms.outcome import holds

USABLE = 0.95
WITHIN = 1.5
HOLDS = (0.93, 0.99)
"""The upper end is judged over all forms together, where all were run: the drives of one form
cannot tell 99 % from 100."""
NOT_LEARNT = 0.05
NAMED = 0.5
"""Share of what was not learnt from that has to be named; less than LEAST_S needs no name."""
LEAST_S = 5.0
AXES = ("roll", "pitch", "yaw")
HEAD = (
    f"{'form':34s} runs usable <=1.5x  med  p90 susp move anew lost    roll pitch  yaw  "
    "not learnt  named  verdict"
)

Line = dict[str, Any]


def report(lines: Sequence[Line]) -> tuple[str, bool]:
    """The table, and whether all bars are met."""
    out, failed, judged = [HEAD], [], 0
    for form in FORMS:
        mine = [line for line in lines if line["form"] == form.name]
        if not mine:
            continue
        text, fails = row(form, mine)
        judged += 1
        failed += [form.name] if fails else []
        out.append(text)
    hit, known = held([line for line in lines if _form(line).carries])
    total, n = sum(hit), sum(known)
    share = total / n if n else math.nan
    most = HOLDS[1] if judged == len(FORMS) else 1.0
    is_held = HOLDS[0] <= share <= most
    out += [
        "",
        f"{judged} forms, {len(lines)} runs: {judged - len(failed)} forms meet every bar, "
        f"{len(failed)} do not",
        f"95 % intervals hold in {_percent(share)} of {n} (bar {_percent(HOLDS[0])} to "
        f"{_percent(most)}): {'OK' if is_held else 'NOT MET'}; "
        + ", ".join(
            f"{a} {_percent(h / k) if k else '-'}" for a, h, k in zip(AXES, hit, known, strict=True)
        ),
    ]
    for group in dict.fromkeys(line["group"] for line in lines):
        mine = [x for x in lines if x["group"] == group and _form(x).carries and _counts(x)]
        good = sum(_within(x) for x in mine)
        out.append(f"{group}: usable within {WITHIN:g} times in {good} of {len(mine)} runs")
    return "\n".join(out), not failed and is_held


def row(form: Form, lines: Sequence[Line]) -> tuple[str, list[str]]:
    """A form's line, and the bars that it does not meet, in words."""
    counts = [x for x in lines if _counts(x)]
    n, fails = len(counts), []
    usable = sum(x.get("usable_s") is not None for x in counts)
    within = sum(map(_within, counts))
    ratios = [x["usable_s"] / x["twin_usable_s"] for x in counts if x.get("usable_s") is not None]
    bad = {
        s: sum(s in x.get("bad", {}) for x in lines) for s in ("suspect", "recalibrating", "lost")
    }
    moved = sum(bool(x.get("moves")) for x in lines)
    hit, known = held(lines)
    ran = [x for x in lines if "driving_s" in x]
    missed = sum(x["not_learnt_s"] for x in ran) / sum(x["driving_s"] for x in ran) if ran else 0.0
    most = max((x["not_learnt_s"] / x["driving_s"] for x in ran), default=0.0)
    unnamed = [x for x in lines if _is_unnamed(x)]
    refused = [x for x in lines if "refused" in x]
    if form.carries:
        if n and usable < USABLE * n:
            fails.append(f"usable {usable}/{n}")
        elif n and within < USABLE * n:
            fails.append(f"within 1.5x {within}/{n}")
        if missed > NOT_LEARNT:
            fails.append(f"not learnt {_percent(missed)}")
        if unnamed:
            fails.append(f"not named in {len(unnamed)}")
        if false := [x for x in lines if not x.get("check", {"usable": True})["usable"]]:
            fails.append(f"check says error in {len(false)}")
    if form.tells and (silent := [x for x in ran if not says_so(form, x)]):
        fails.append(f'check says no "{form.tells}" in {len(silent)}')
    if refused:
        fails.append(f"refused in {len(refused)}")
    fails += [f"{word} in {k}" for word, k in (*bad.items(), ("moved", moved)) if k]
    if sum(known) and sum(hit) < HOLDS[0] * sum(known):
        fails.append(f"95 % holds in {_percent(sum(hit) / sum(known))}")
    median, p90 = (
        (f"{np.median(ratios):.2f}", f"{np.percentile(ratios, 90):.2f}") if ratios else ("-", "-")
    )
    shares = " ".join(
        f"{_percent(h / k) if k else '-':>5s}" for h, k in zip(hit, known, strict=True)
    )
    learnt = f"{_percent(missed)}/{_percent(most)}"
    text = (
        f"{form.name:34s} {len(lines):4d} {_of(usable, n):>6s} {_of(within, n):>6s} {median:>5s} "
        f"{p90:>4s} {bad['suspect']:4d} {moved:4d} {bad['recalibrating']:4d} {bad['lost']:4d} "
        f" {shares} {learnt:>10s} {_of(len(lines) - len(unnamed), len(lines)):>6s}  "
        f"{'; '.join(fails) or 'OK'}"
    )
    return text, fails


def _form(line: Line) -> Form:
    return next(form for form in FORMS if form.name == line["form"])


def _counts(line: Line) -> bool:
    """Whether the unspoilt drive became usable, without which no form can be judged by it."""
    return line["twin_usable_s"] is not None


def _within(line: Line) -> bool:
    usable = line.get("usable_s")
    return usable is not None and bool(usable <= WITHIN * line["twin_usable_s"])


def held(lines: Iterable[Line]) -> tuple[list[int], list[int]]:
    """About x, y, z: intervals that held the truth, and all that were stated."""
    hit, known = [0, 0, 0], [0, 0, 0]
    for line in lines:
        for one in line.get("said", {}).values():
            for i, is_held in enumerate(holds(one)):
                if is_held is not None:
                    known[i] += 1
                    hit[i] += is_held
    return hit, known


def _is_unnamed(line: Line) -> bool:
    missed = line.get("not_learnt_s", 0.0)
    return missed > LEAST_S and line["named_s"] < NAMED * missed


def says_so(form: Form, line: Line) -> bool:
    """Whether a finding of `check` has the word that the form asks for."""
    return any(form.tells in text for text in line.get("check", {}).get("texts", ()))


def _of(k: int, n: int) -> str:
    return _percent(k / n) if n else "-"


def _percent(share: float) -> str:
    return "-" if math.isnan(share) else f"{abs(100.0 * share):.0f} %"
