"""Run linear algebra on one thread, regardless of the settings of the calling process."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


def on_one_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Make a function run with one BLAS thread.

    The matrices of these functions are small, so several threads would only wait for each other.
    The last bit of a sum would also depend on the number of threads. The command line sets one
    thread for its whole process. In a notebook, only this function is limited.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        if os.environ.get("OPENBLAS_NUM_THREADS") == "1":
            return function(*args, **kwargs)
        from threadpoolctl import threadpool_limits  # noqa: PLC0415 - not on the command line

        with threadpool_limits(limits=1, user_api="blas"):
            return function(*args, **kwargs)

    return limited
