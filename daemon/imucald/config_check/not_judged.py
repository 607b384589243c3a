"""Report configured quantities for which only the range of values could be checked, for `imucald
check`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

from imucald.config_check.finding import Finding
from imucald.config_check.source import QuantitySource
from imucald.core.samples import SI_UNITS

_FLAG = SI_UNITS["flag"]


def not_judged(rows: Sequence[QuantitySource], found: Iterable[Finding]) -> Iterator[Finding]:
    """Yield one note that names all received quantities that occur in no finding."""
    judged = {name.partition(".")[0] for f in found for name in (f.quantity, *f.beside)}
    left: dict[str, str] = {}
    for row in rows:
        name = row.quantity.partition(".")[0]
        values = row.statistics.si
        if name not in judged and values.count:
            is_flag = row.statistics.conversion.unit.dimension == "flag"
            same = values.least == values.largest
            word = (" (never on)", " (always on)")[values.least > 0.5] if is_flag and same else ""
            left.setdefault(name, name + word)
    if left:
        text = f"checked for unit and range only: {', '.join(left.values())}"
        yield Finding("note", "check", text)
