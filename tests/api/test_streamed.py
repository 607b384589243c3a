"""Logs larger than memory: parts, and files written in bounded memory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from replayed_drive import config, drive, log

import imucald

FORMATS = ("parquet", "csv", "mf4", "mcap")


def test_a_stream_gives_the_same_samples_in_parts(monkeypatch):
    monkeypatch.setattr("imucald.api.streaming.PART_ROWS", 30_000)
    stream = imucald.stream(config(), log())
    with pytest.raises(imucald.ImucaldError, match="has not ended"):
        _ = stream.result
    parts = list(stream)
    assert len(parts) > 2
    for name in ("accel", "gyro", "raw/speed"):
        for i, array in enumerate(drive().tables[name].arrays):
            joined = np.concatenate([p.tables[name].arrays[i] for p in parts if name in p.tables])
            assert np.array_equal(joined, array, equal_nan=array.dtype.kind == "f")
    assert stream.result.to_dict() == drive().to_dict()
    assert [p.to_s for p in parts[:-1]] <= [p.from_s for p in parts[1:]]
    assert all(len(repr(part).splitlines()) <= 5 for part in parts)
    assert parts[0].accel.num_rows == len(parts[0].tables["accel"])
    with pytest.raises(imucald.ImucaldError, match="once"):
        list(stream)


@pytest.mark.slow
@pytest.mark.parametrize("ending", FORMATS)
def test_a_stream_writes_what_a_whole_drive_writes(monkeypatch, tmp_path, ending):
    monkeypatch.setattr("imucald.api.streaming.PART_ROWS", 30_000)
    imucald.stream(config(), log()).write(
        tmp_path / f"s.{ending}", ("accel", "history", "raw/speed")
    )
    again = imucald.open_result(tmp_path / f"s.{ending}")
    for name in ("accel", "history", "raw/speed"):
        for mine, theirs in zip(
            drive().tables[name].arrays, again.tables[name].arrays, strict=True
        ):
            assert np.array_equal(mine, theirs, equal_nan=mine.dtype.kind == "f")
    assert again.to_dict() == drive().to_dict()


@pytest.mark.slow
@pytest.mark.parametrize(("ending", "hours"), [("parquet", 3), ("csv", 2), ("mf4", 2), ("mcap", 2)])
def test_a_log_of_hours_takes_no_more_than_300_mib_nor_more_than_one_of_an_hour(
    tmp_path, ending, hours
):
    """At 100 Hz it is written in parts of 25 minutes: the second hour shows what they leave."""
    taken = []
    for length in (1, hours):
        found = _repeated(tmp_path / f"out{length}.{ending}", length)
        assert found["duration_s"] == pytest.approx(length * 3600, abs=1)
        assert found["mib"] < 300.0
        taken.append(found["mib"])
    assert taken[-1] < taken[0] + 30.0


def _repeated(out: Path, hours: int):
    program = Path(__file__).parent / "repeated_log.py"
    done = subprocess.run(
        [sys.executable, str(program), str(config().path), str(log()), str(hours), str(out)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    return json.loads(done.stdout)
