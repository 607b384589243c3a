"""Text that UTF-8 can always hold, whatever names it is about.

A file name is bytes; where they are no UTF-8, Python holds them as lone surrogates, which no
encoder takes. So a text that may name a file is made encodable before it is sent or written.
"""

from __future__ import annotations

import json
import re
from typing import Any

_LONE = re.compile("[\ud800-\udfff]")


def encodable(text: str) -> str:
    r"""Return the text with each lone surrogate in the letters ``\udcff``; never fails."""
    return _LONE.sub(lambda found: f"\\u{ord(found[0]):04x}", text)


def json_text(content: Any, indent: int | None = None) -> str:
    r"""Return JSON that UTF-8 can hold. Raises ValueError for NaN and infinity.

    A lone surrogate becomes the letters ``\udcff`` within its string: as a JSON escape of its own
    (``"\udcff"``) strict readers refuse it, and those that take it cannot print what they got.
    """
    text = json.dumps(content, indent=indent, allow_nan=False, ensure_ascii=False)
    return _LONE.sub(lambda found: f"\\\\u{ord(found[0]):04x}", text)
