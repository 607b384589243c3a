"""How many threads a notebook's replay and diagnosis use."""

from __future__ import annotations

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from imucald.api.blas_threads import on_one_thread


def threads() -> set[int]:
    np.linalg.inv(np.eye(2))
    return {info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas"}


def test_a_call_has_one_thread_and_the_process_keeps_its_own(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with threadpool_limits(limits=2, user_api="blas"):
        assert on_one_thread(threads)() == {1}
        assert threads() == {2}


def test_the_process_keeps_its_threads_where_a_call_fails(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)

    def fails() -> None:
        raise ValueError("no frames")

    with threadpool_limits(limits=2, user_api="blas"):
        with pytest.raises(ValueError, match="no frames"):
            on_one_thread(fails)()
        assert threads() == {2}
