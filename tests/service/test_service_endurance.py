"""Hours through the live path: no memory, thread or file is left behind."""

from __future__ import annotations

import gc

import shuttle
from imucald.bus.log import LogReader
from imucald.service.service import Service, ServiceOptions, process_figures

WARM_UP_S, MEASURED_S = 1200.0, 2400.0
GROWTH_LIMIT = 1 << 20
"""Bytes per hour, and no less for the part of an hour that is measured."""


def test_an_hour_of_driving_leaves_nothing_behind(tmp_path):
    config = shuttle.write(tmp_path, cycles=4)
    (frames,) = LogReader([tmp_path / "shuttle.log"])
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
        state_folder=tmp_path / "state",
        status_socket=tmp_path / "s",
    )
    service = Service(options, clock=lambda: now[0])
    length = rows[-1][0] - rows[0][0] + 0.01
    send = service.link.send

    def drive_until(end: float) -> None:
        while now[0] < end:
            handle, start = service.engine.frame, now[0]
            for t, can_id, data in rows:
                for out_id, out in handle(t + start, can_id, data):
                    send(out_id, out)
            for k in range(round(length)):
                now[0] = start + k + 1.0
                service._chores(now[0])
            now[0] = start + length

    drive_until(WARM_UP_S)
    assert service.keeper.writer.flush(5.0)
    gc.collect()
    before = process_figures()
    drive_until(WARM_UP_S + MEASURED_S)
    assert service.keeper.writer.flush(5.0)
    gc.collect()
    after = process_figures()
    assert service.engine.pipeline.quality >= 2
    assert service.keeper.writer.saves > 20
    service.close()
    assert after["rss_bytes"] - before["rss_bytes"] < GROWTH_LIMIT
    assert after["threads"] == before["threads"]
    assert after["open_files"] == before["open_files"]
