"""Reuse results of functions that are called repeatedly with the same inputs.

A column of a fit is an evaluation with one changed number. Most signals of this evaluation stay the
same.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")
Known = dict[tuple[Any, ...], tuple[tuple[Any, ...], Any]]


class Once:
    """Calls a function, unless its result for these inputs is already known.

    Inputs are the same if arrays are the same objects and all other inputs are equal. The result of
    the function must therefore depend on its inputs only. The stored arrays are made read-only.
    keeps: if True, new results are stored in `known`. If False, new results are stored only as long
    as this object exists.
    """

    def __init__(self, known: Known, keeps: bool) -> None:
        self._known = known
        self._new = known if keeps else {}

    def __call__(self, make: Callable[..., T], *inputs: Any) -> T:
        """Return the result of `make` for these inputs. Functions are identified by their names."""
        key = (make.__name__, *((id(x),) if isinstance(x, np.ndarray) else x for x in inputs))
        found = self._known.get(key) or self._new.get(key)
        if found is not None:
            known: T = found[1]
            return known
        made = make(*inputs)
        # Inputs are kept too, because an array's id is unique only while the array lives.
        self._new[key] = inputs, made
        for x in made if isinstance(made, tuple) else (made,):
            if isinstance(x, np.ndarray):
                x.flags.writeable = False
        return made
