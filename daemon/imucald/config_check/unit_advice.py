"""The advice about a wrong unit, where the configuration states a unit already."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from imucald.config_check.finding import SET_UNIT, Finding
from imucald.config_check.source import QuantitySource


def with_stated_units(
    findings: Iterable[Finding], sources: Sequence[QuantitySource]
) -> Iterator[Finding]:
    """Yield the findings; "set 'unit:'" becomes which unit is set, and what the database has."""
    for finding in findings:
        advice = _advice(finding.quantity, sources) if SET_UNIT in finding.text else None
        if advice is None:
            yield finding
        else:
            text = finding.text.replace(SET_UNIT, advice)
            yield Finding(finding.level, finding.quantity, text)


def _advice(quantity: str, sources: Sequence[QuantitySource]) -> str | None:
    """What to do instead; None where the configuration states no unit for the quantity."""
    own = [s for s in sources if s.quantity == quantity or s.quantity.startswith(f"{quantity}.")]
    stated = [s for s in own if s.wanted.source.unit is not None]
    if not stated:
        return None
    source = stated[0]
    wrong = f"'unit: {source.wanted.source.unit}' is set"
    if source.signal is not None and source.signal.unit not in ("", source.wanted.source.unit):
        return f"{wrong}: remove it (the database has {source.signal.unit}) or correct it"
    return f"{wrong}: correct it"
