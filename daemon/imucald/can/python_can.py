"""python-can, imported without the heavy optional readers it would pull in.

Where asammdf is installed, ``import can`` imports it, and pandas with it: 60 MiB and a second
that a daemon never uses. The import is kept out here, and made good by `with_mf4` for those who
read MF4.
"""

from __future__ import annotations

import importlib
import sys
from typing import Any

_absent = "asammdf" not in sys.modules
if _absent:
    sys.modules["asammdf"] = None  # type: ignore[assignment]
import can  # noqa: E402

if _absent:
    del sys.modules["asammdf"]

__all__ = ["can", "with_mf4"]


def with_mf4() -> Any:
    """Return python-can's MF4 reader class, with asammdf really imported.

    Raises ImportError where asammdf is not installed (extra ``mf4``).
    """
    importlib.import_module("asammdf")
    return importlib.reload(importlib.import_module("can.io.mf4")).MF4Reader
