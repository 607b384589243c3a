"""Raw values that a database's value table calls no value at all.

J1939 and the databases of vehicle makers name them: SNA, not available, invalid, error, init; in
German ones ungueltig, nicht verfuegbar, Fehler. A signal carries them instead of a value.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

_NAMES = re.compile(
    r"\b(sna|n a|not available|notavailable|unavailable|not valid|invalid|error|errorvalue|init"
    r"|initial|initvalue|initiali[sz](e|ed|ing|ation)|ungueltig|ungültig|nicht verfuegbar"
    r"|nicht verfügbar|fehler|fehlerwert|initwert|initialwert)\b"
)
_NO = re.compile(r"^(no|kein|keine|not in|without)\b")


def is_no_value(name: str) -> bool:
    """Whether an entry of a value table says that there is no value: "SNA", "NotAvailable"."""
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name)
    words = re.sub(r"[\W_]+", " ", words).strip().lower()
    return bool(_NAMES.search(words)) and not _NO.match(words)


def no_values(choices: Mapping[int, str]) -> tuple[int, ...]:
    """The raw values of a table that are none, in order."""
    return tuple(sorted(raw for raw, name in choices.items() if is_no_value(name)))
