"""Import python-can without its MF4 reader.

If asammdf is installed (extra ``mf4``), ``import can`` imports it together with pandas. The import
of both takes 48 MiB and 0.2 to 1.8 s, more than a whole daemon. Use `with_mf4` to read MF4.
"""

from __future__ import annotations

import importlib
from functools import partial
from typing import Any

from imucald.core.libraries import standing_in

with standing_in("asammdf", None):
    import can

__all__ = ["can", "with_mf4"]


def with_mf4() -> Any:
    """Import asammdf, and return python-can's MF4 reader class.

    asammdf lists the ids of each bus when it opens a file. The reader needs no list, and asammdf
    never ends the list of a group whose data hold records although the group states none.

    Raises ImportError if asammdf is not installed (extra ``mf4``).
    """
    importlib.import_module("asammdf")
    module: Any = importlib.reload(importlib.import_module("can.io.mf4"))
    module.MDF = partial(module.MDF, process_bus_logging=False)
    return module.MF4Reader
