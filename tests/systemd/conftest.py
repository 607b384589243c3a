"""The machine with systemd in it, as a fixture."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from machine import Outcome, debian_root, run_machine, why_not


@pytest.fixture(scope="session")
def systemd_root() -> Path:
    """The Debian folder; skips with the reason where it cannot be, fails where it must."""
    reason = why_not()
    if reason and os.environ.get("IMUCALD_REQUIRE_VCAN") == "1":
        pytest.fail(reason)
    if reason:
        pytest.skip(reason)
    return debian_root()


@pytest.fixture
def run_under_systemd(systemd_root: Path, tmp_path: Path) -> Callable[..., Outcome]:
    """`run_machine` on a fresh machine: (script, files=..., shared=...) -> Outcome."""
    run: Any = partial(run_machine, systemd_root, tmp_path)
    return run
