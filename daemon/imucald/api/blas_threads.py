"""Linear algebra on one thread, whatever the process around it has set."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Call a function with one BLAS thread: its matrices are small, so that more threads wait for
    each other, and the last bit of a sum depends on their number.

    The command line sets this for its process; a notebook keeps its own threads for all else.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        if os.environ.get("OPENBLAS_NUM_THREADS") == "1":
            return function(*args, **kwargs)
        from threadpoolctl import threadpool_limits  # noqa: PLC0415 - not on the command line

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
