"""The measured drives, where they lie beside the tree: no line of them may be rejected."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from imucald.can.columns import concatenate
from imucald.can.logs.log_reader import IdMatch, LogReader
from paths import ROOT

DATA = ROOT.parent / "shared" / "data"
DRIVES = sorted(DATA.glob("*/drive.log.gz"))

pytestmark = pytest.mark.skipif(not DRIVES, reason=f"no measured drives in {DATA}")


@pytest.mark.slow
@pytest.mark.parametrize("path", DRIVES, ids=lambda path: path.parent.name)
def test_every_line_of_a_drive_is_a_frame(path: Path) -> None:
    lines = gzip.decompress(path.read_bytes()).splitlines()
    reader = LogReader([path], strict=True)
    frames = concatenate(list(reader))
    assert len(frames) == reader.frames_read == len(lines)
    assert frames.t.tolist() == [float(line[1 : line.index(b")")]) for line in lines]
    tails = [line.rsplit(b" ", 1)[1].split(b"#") for line in lines]
    assert (frames.can_id & 0x7FFF_FFFF).tolist() == [int(number, 16) for number, _ in tails]
    assert frames.length.tolist() == [len(data) // 2 for _, data in tails]
    padded = b"".join(bytes.fromhex(data.decode()).ljust(8, b"\0") for _, data in tails)
    assert frames.data.tobytes() == padded


def test_a_filter_takes_one_bus_of_a_drive() -> None:
    path = DATA / "css_canmod_164" / "drive.log.gz"
    lines = gzip.decompress(path.read_bytes()).splitlines()
    reader = LogReader([path], [IdMatch(0x7E8, 0x7FF, "can0"), IdMatch(0x001, 0x7FF, "can0")])
    frames = concatenate(list(reader))
    assert len(frames) == sum(b" can0 7E8#" in line for line in lines) > 0
    assert np.unique(frames.can_id).tolist() == [0x7E8]
    assert reader.frames_read == len(lines)
