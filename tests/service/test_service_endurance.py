"""Hours through the live path: no memory, thread or file is left behind.

Memory is measured in a process of its own, where nothing else takes or frees any.
"""

from __future__ import annotations

import gc
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import shuttle
from imucald.can.logs.log_reader import LogReader
from imucald.service.parts import ServiceOptions
from imucald.service.running_status import process_figures
from imucald.service.service import Service

pytestmark = pytest.mark.slow

WARM_UP_S, MEASURED_S = 1800.0, 1800.0
GROWTH_LIMIT = 1 << 20
"""Bytes per hour, and no less for the part of an hour that is measured."""


def test_an_hour_of_driving_leaves_nothing_behind(tmp_path):
    done = subprocess.run(
        [sys.executable, __file__, str(tmp_path)],
        capture_output=True,
        text=True,
        check=False,
        env={"PYTHONPATH": str(Path(__file__).parents[1]), "OPENBLAS_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    before, after = found["before"], found["after"]
    assert found["quality"] >= 2
    assert found["saves"] > 20
    assert after["rss_bytes"] - before["rss_bytes"] < GROWTH_LIMIT
    assert after["threads"] == before["threads"]
    assert after["open_files"] == before["open_files"]


def drive(folder: Path) -> dict[str, Any]:
    """Drive for an hour in the folder; figures before and after its second half."""
    config = shuttle.write(folder, cycles=4)
    (frames,) = LogReader([folder / "shuttle.log"])
    rows = [
        (t, can_id, data[:length].tobytes())
        for t, can_id, length, data in zip(
            frames.t.tolist(),
            frames.can_id.tolist(),
            frames.length.tolist(),
            frames.data,
            strict=True,
        )
        if can_id in (0x200, 0x202)
    ]
    now = [0.0]
    options = ServiceOptions(
        config,
        interface="virtual",
        channel="endurance",
        state_folder=folder / "state",
        status_socket=folder / "s",
    )
    service = Service(options, clock=lambda: now[0])
    length = rows[-1][0] - rows[0][0] + 0.01
    send = service.link.send

    def drive_until(end: float) -> dict[str, Any]:
        while now[0] < end:
            handle, start = service.engine.frame, now[0]
            for t, can_id, data in rows:
                for out_id, out in handle(t + start, can_id, data):
                    send(out_id, out)
            for k in range(round(length)):
                now[0] = start + k + 1.0
                service._chores(now[0])
            now[0] = start + length
        assert service.parts.calibration_store is not None
        assert service.parts.calibration_store.writer.flush(5.0)
        gc.collect()
        return process_figures()

    before = drive_until(WARM_UP_S)
    after = drive_until(WARM_UP_S + MEASURED_S)
    quality = service.engine.pipeline.quality
    service.close()
    assert service.parts.calibration_store is not None
    saves = service.parts.calibration_store.writer.saves
    return {"before": before, "after": after, "quality": quality, "saves": saves}


if __name__ == "__main__":
    print(json.dumps(drive(Path(sys.argv[1]))))
