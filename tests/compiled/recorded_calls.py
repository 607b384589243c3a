"""What a replay hands to the kernels of the compiled part, for tests that hand them worse."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import imucald
from imucald.cli import main
from imucald.core import compiled
from paths import ROOT

CONFIG = ROOT / "config" / "examples" / "passenger_car.yaml"
MINUTES = 8
"""Every kernel is called within them."""
KEPT = 3
"""Calls of each kernel that are kept: the first, and later ones of another course."""

Arguments = tuple[Any, ...]

needs_kernels = pytest.mark.skipif(compiled.kernels is None, reason=f"kernels: {compiled.state}")


def simulated(folder: Path, minutes: float = MINUTES, *more: str) -> Path:
    """A simulated drive as candump text."""
    log = folder / "drive.log"
    asked = ["simulate", "--out", str(log), "--seed", "5", "--minutes", str(minutes), *more]
    assert main(asked) == 0
    return log


@contextlib.contextmanager
def watched(see: Callable[[str, Arguments], None]) -> Iterator[None]:
    """Show each call of a kernel before it is made."""
    kernels = compiled.kernels
    assert kernels is not None
    real = {name: getattr(kernels, name) for name in kernels.ARGUMENTS}

    def shown(name: str) -> Callable[..., int]:
        def call(*arguments: Any) -> int:
            see(name, arguments)
            found: int = real[name](*arguments)
            return found

        return call

    for name in real:
        setattr(kernels, name, shown(name))
    try:
        yield
    finally:
        for name, function in real.items():
            setattr(kernels, name, function)


def copied(arguments: Arguments) -> Arguments:
    """Arguments with arrays of their own."""
    return tuple(x.copy() if isinstance(x, np.ndarray) else x for x in arguments)


@cache
def calls() -> dict[str, list[Arguments]]:
    """Arguments of some calls of each kernel."""
    found: dict[str, list[Arguments]] = {}
    counts: dict[str, int] = {}

    def keep(name: str, arguments: Arguments) -> None:
        counts[name] = counts.get(name, 0) + 1
        if counts[name] in (1, 10, 50)[:KEPT]:
            found.setdefault(name, []).append(copied(arguments))

    with tempfile.TemporaryDirectory() as folder, watched(keep):
        imucald.replay(imucald.Config.load(CONFIG), simulated(Path(folder)))
    return found
