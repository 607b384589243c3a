"""A whole replay with the compiled part and without it gives the same result, to the last bit."""

from __future__ import annotations

import json
import random
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorded_calls import CONFIG, needs_kernels, simulated

import imucald
from imucald.core import compiled

pytestmark = [needs_kernels, pytest.mark.slow]


Replayed = tuple[str, dict[str, dict[str, np.ndarray]]]


def replayed(log: Path) -> Replayed:
    """The result as JSON text, and all tables."""
    drive = imucald.replay(imucald.Config.load(CONFIG), log)
    tables = {name: table.as_dict() for name, table in drive.tables.items()}
    return json.dumps(drive.to_dict(), default=str), tables


def damaged(log: Path, draw: random.Random) -> None:
    """Holes, doubled frames, frames with other bits, a clock that is set, text that is none."""
    lines, out, late = log.read_text().splitlines(), [], 0.0
    at = 0
    while at < len(lines):
        text = lines[at]
        kind = draw.random()
        if kind < 0.0002:
            at += draw.randrange(4000)  # a hole
        elif kind < 0.0004:
            late += draw.choice([-0.4, 20.0, 5.0])
        elif kind < 0.002:
            out.append(text)
        elif kind < 0.004:
            place = draw.randrange(text.index("#") + 1, len(text))
            text = text[:place] + draw.choice("0123456789ABCDEFxyz ") + text[place + 1 :]
        stamp, rest = text[1:].split(")", 1)
        out.append(f"({float(stamp) + late:.6f}){rest}" if stamp.count(".") == 1 else text)
        at += 1
    log.write_text("\n".join(out) + "\n")


def assert_equal(log: Path) -> None:
    one = replayed(log)
    with compiled.left_out():
        assert_same(one, replayed(log))


def assert_same(one: Replayed, other_one: Replayed) -> None:
    (text, tables), (other_text, without) = one, other_one
    assert text == other_text
    assert list(tables) == list(without)
    for name, table in tables.items():
        for column, values in table.items():
            other: Any = without[name][column]
            assert values.dtype == other.dtype
            assert np.array_equal(values, other, equal_nan=values.dtype.kind == "f"), name


def test_a_drive(tmp_path: Path) -> None:
    assert_equal(simulated(tmp_path, 14.0))


@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_drive(tmp_path: Path, seed: int) -> None:
    log = simulated(tmp_path, 9.0)
    damaged(log, random.Random(seed))
    assert_equal(log)


def test_a_drive_among_the_frames_of_other_units(tmp_path: Path) -> None:
    assert_equal(simulated(tmp_path, 1.0, "--background"))


def test_drives_in_threads_at_once(tmp_path: Path) -> None:
    logs = []
    for minutes in (3.0, 4.0):
        folder = tmp_path / str(minutes)
        folder.mkdir()
        logs.append(simulated(folder, minutes))
    alone = [replayed(log) for log in logs]
    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-4)
    try:
        with ThreadPoolExecutor(4) as pool:
            together = list(pool.map(replayed, 2 * logs))
    finally:
        sys.setswitchinterval(interval)
    for one, other in zip(2 * alone, together, strict=True):
        assert_same(one, other)
