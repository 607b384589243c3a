"""A small fleet on disk: pieces of one simulated drive as logs of several vehicles."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from imucald.config import load_config
from imucald.simulation.drive import simulate
from imucald.simulation.random_model import random_model
from imucald.traffic.can_log import write_log
from imucald.traffic.drive_encoder import BusEncoder
from paths import ROOT

HERE = Path(__file__).parent
CONFIG = ROOT / "config" / "examples" / "passenger_car.yaml"
TABLES = ("drives", "events", "failures", "sources")
"""Those that are the same whenever and however often a fleet is evaluated."""


def whole_log(path: Path, minutes: float = 3.0) -> Path:
    """A simulated drive as a candump log."""
    drive = simulate(random_model(5, "city"), 5, minutes)
    write_log(drive, path, BusEncoder(load_config(CONFIG)), False, lambda _: None)
    return path


def make_fleet(
    folder: Path, log: Path, logs: int, vehicles: int = 3, seconds: float = 40.0
) -> Path:
    """Logs of `seconds` each, all different; returns the fleet file."""
    lines = log.read_bytes().splitlines(keepends=True)
    length = round(len(lines) * seconds / 180.0)
    for i in range(logs):
        place = folder / "logs" / f"car-{i % vehicles}" / f"2026-03-{i // vehicles + 1:02}.log"
        place.parent.mkdir(parents=True, exist_ok=True)
        start = (len(lines) - length) * i // max(logs - 1, 1)
        place.write_bytes(b"".join(lines[start : start + length]))
    return fleet_file(folder)


def fleet_file(folder: Path, more: str = "") -> Path:
    path = folder / "fleet.yaml"
    path.write_text(f"logs: 'logs/**/*'\nconfig: {CONFIG}\n{more}")
    return path


def tables_of(out: Path) -> dict[str, bytes]:
    """The bytes of the tables; there must be no parts beside them."""
    found = {str(p.relative_to(out)): p.read_bytes() for t in TABLES for p in (out / t).glob("*")}
    assert sorted(found) == sorted(f"{t}/{t}.parquet" for t in TABLES)
    return found


def environment() -> dict[str, str]:
    """For processes that have to find `poison`."""
    paths = [str(HERE), *filter(None, sys.path)]
    return os.environ | {"PYTHONPATH": os.pathsep.join(paths)}


@contextmanager
def on_a_terminal(command: list[str]) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """A run and the terminal to which it says how far it is."""
    terminal, its_end = os.openpty()
    run = subprocess.Popen(command, env=environment(), stderr=its_end)
    os.close(its_end)
    try:
        yield run, terminal
        run.wait(300.0)
    finally:
        run.kill()
        run.wait()
        os.close(terminal)


def read_until(terminal: int, pattern: bytes | None) -> str:
    """What comes on a terminal up to this pattern; None: up to its end."""
    text = b""
    while pattern is None or not re.search(pattern, text):
        try:
            more = os.read(terminal, 1024)
        except OSError:  # its other end is closed
            more = b""
        if not more:
            assert pattern is None, text
            break
        text += more
    return text.decode()


@pytest.fixture
def children_find_poison(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    from imucald.fleet.template_client import close_templates

    monkeypatch.setenv("PYTHONPATH", environment()["PYTHONPATH"])
    yield
    close_templates()
