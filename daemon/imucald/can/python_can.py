"""python-can, imported without the MF4 reader that it would load besides.

Where asammdf is installed (extra ``mf4``), ``import can`` imports it, and pandas with it: 48 MiB
and 0.2 to 1.8 s, more than a whole daemon takes. `with_mf4` is for those who read MF4.
"""

from __future__ import annotations

import importlib
from typing import Any

from imucald.core.libraries import standing_in

with standing_in("asammdf", None):
    import can

__all__ = ["can", "with_mf4"]


def with_mf4() -> Any:
    """Return python-can's MF4 reader class, with asammdf really imported.

    Raises ImportError where asammdf is not installed (extra ``mf4``).
    """
    importlib.import_module("asammdf")
    return importlib.reload(importlib.import_module("can.io.mf4")).MF4Reader
