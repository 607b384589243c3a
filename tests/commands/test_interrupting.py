"""Ctrl-C is never lost in code that ignores every exception."""

from __future__ import annotations

import copyreg
import importlib
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from imucald.commands.interrupting import interrupt


@pytest.fixture(autouse=True)
def handler() -> Iterator[None]:
    before = [(n, signal.signal(n, interrupt)) for n in (signal.SIGINT, signal.SIGALRM)]
    yield
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    for number, former in before:
        signal.signal(number, former)


class _Interrupted(type):
    """A class that is interrupted when `copyreg` notes its slots."""

    def __setattr__(cls, name: str, value: Any) -> None:
        signal.raise_signal(signal.SIGINT)
        super().__setattr__(name, value)


def test_a_copy_does_not_lose_it() -> None:
    made = _Interrupted("Made", (), {})

    def copy() -> None:
        copyreg._slotnames(made)  # type: ignore[attr-defined]
        time.sleep(5.0)

    with pytest.raises(KeyboardInterrupt):
        copy()
    assert "__slotnames__" in vars(made)


def test_an_import_is_finished_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = (
        "import signal\ntry:\n    signal.raise_signal(signal.SIGINT)\nexcept BaseException: pass\n"
    )
    (tmp_path / "swallows_all.py").write_text(text + "DONE = True\n")
    monkeypatch.syspath_prepend(tmp_path)

    def load() -> None:
        importlib.import_module("swallows_all")
        time.sleep(5.0)

    with pytest.raises(KeyboardInterrupt):
        load()
    assert sys.modules.pop("swallows_all").DONE


def test_elsewhere_it_comes_at_once() -> None:
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
