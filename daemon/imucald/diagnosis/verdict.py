"""From what was found to words: look-alikes, the manoeuvre that would separate, the verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from imucald.diagnosis.cause import Cause
from imucald.diagnosis.contest import FAMILIES
from imucald.diagnosis.result import GOES_AGAINST, Candidate, Structure, Verdict
from imucald.diagnosis.search import ALIKE, Search
from imucald.diagnosis.trial import ACCEPT, Found

MOST_TOLD = 12
"""Losers that are told of."""


def look_alikes(search: Search, found: Found) -> tuple[list[tuple[str, ...]], list[Candidate]]:
    """Exchange each active cause for every other; those as good are its look-alikes.

    Returns the sets, and what lost with its distance. Delays and low-passes have had a contest of
    fits of their own already, and far from the model their derivatives mislead: they are exchanged
    only for causes outside their family.
    """
    evidence = found.point.evidence
    active = {v.cause for v in found.active}
    sets = [names for names in found.alike if names[0] in active]
    losers: dict[tuple[str, ...], float] = {}
    for variant in found.active:
        rest = [key for v in found.active if v is not variant for key in v.keys]
        temper = search.temper(found, variant.keys)
        winner = evidence.fit([*rest, *variant.keys], temper=temper).log_evidence
        winner += search.prior(variant)
        alike = {variant.cause}
        for other in search.variants:
            if other.cause in (variant.cause, "mount_shift"):
                continue
            if any(variant.cause in f and other.cause in f for f in FAMILIES):
                continue
            if any(other.cause == v.cause for v in found.active):
                continue
            said = evidence.fit([*rest, *other.keys], temper=temper).log_evidence
            behind = said + search.prior(other) - winner
            if behind > -ALIKE and search.is_possible(found, other, rest, temper):
                alike.add(other.cause)
            names = (other.cause,)
            losers[names] = max(losers.get(names, -math.inf), behind)
        if len(alike) > 1:
            sets.append((variant.cause, *sorted(alike - {variant.cause})))
    told = sorted(losers.items(), key=lambda item: -item[1])[:MOST_TOLD]
    winner_name = found.active[0].cause if len(found.active) == 1 else "one of the causes"
    return sets, [
        Candidate(k, v, f"in place of {winner_name}") for k, v in told if math.isfinite(v)
    ]


def losers_of(search: Search, found: Found) -> list[Candidate]:
    """What was tried on top of the found causes and did not pay.

    What promised to pay, and did not once it was fitted, is left out: its score means nothing.
    """
    best: dict[str, float] = {}
    for trial in search.trials(found):
        name = trial.variant.cause
        best[name] = max(best.get(name, -math.inf), trial.score)
    ordered = sorted(best.items(), key=lambda item: -item[1])[:MOST_TOLD]
    return [
        Candidate((name,), score, "in addition: does not pay for itself")
        for name, score in ordered
        if math.isfinite(score) and score < ACCEPT
    ]


def to_separate(sets: Sequence[Sequence[str]], causes: Mapping[str, Cause]) -> str:
    """Say which manoeuvres would tell the look-alikes apart."""
    parts = []
    for names in sets:
        ways = list(dict.fromkeys(causes[n].seen_by for n in names if causes[n].seen_by))
        parts.append(f"{' or '.join(names)}: {'; '.join(ways)}")
    return ". ".join(parts)


def verdict_of(
    scores: Mapping[str, float], sets: Sequence[Sequence[str]], structure: Sequence[Structure]
) -> Verdict:
    """The four honest verdicts."""
    if any(s.kind == GOES_AGAINST for s in structure):
        return "unknown"
    if not scores:
        return "unknown" if structure else "nothing"
    return "ambiguous" if sets else "found"
