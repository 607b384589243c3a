"""What is made again and again of the same inputs, made once.

A column of a fit is an evaluation with one number changed, which leaves most of the signals as
they are.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")
Known = dict[tuple[Any, ...], tuple[tuple[Any, ...], Any]]


class Once:
    """Calls a function, unless what it makes of these inputs is known.

    Inputs are the same where an array is the same object, and anything else is equal. So the
    function must depend on its inputs alone, and no array that is kept may be changed: it is made
    read-only. keeps: whether what is made now is kept in `known`, or as long as this is.
    """

    def __init__(self, known: Known, keeps: bool) -> None:
        self._known = known
        self._new = known if keeps else {}

    def __call__(self, make: Callable[..., T], *inputs: Any) -> T:
        """What `make`, which goes by its name, makes of the inputs."""
        key = (make.__name__, *((id(x),) if isinstance(x, np.ndarray) else x for x in inputs))
        found = self._known.get(key) or self._new.get(key)
        if found is not None:
            known: T = found[1]
            return known
        made = make(*inputs)
        # Inputs are held too: an array's id is its own only while it lives.
        self._new[key] = inputs, made
        for x in made if isinstance(made, tuple) else (made,):
            if isinstance(x, np.ndarray):
                x.flags.writeable = False
        return made
