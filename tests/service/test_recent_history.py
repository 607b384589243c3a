"""The half hour that a daemon keeps for a page that is opened later."""

from __future__ import annotations

import itertools
import json

import numpy as np
import pytest

from imucald.runtime.session import make_engine
from imucald.service.asking import ask
from imucald.service.recent_history import COLUMNS, KEPT, RecentHistory
from service_bench import Bench, running
from simulated_bus import EPOCH, drive, drive_frames, loaded


@pytest.fixture(scope="module")
def history():
    """Of a drive as it comes live: frame by frame; wall clock is the drive's."""
    engine = make_engine(loaded("joint"))
    engine_now = [0.0]
    made = RecentHistory(lambda: engine_now[0])
    frames, due = drive_frames(), 2.0
    for t, can_id, data in frames.rows():
        engine.frame(t, can_id, data)
        engine_now[0] = t - EPOCH
        made.tick(engine)
        if engine_now[0] >= due:
            due += 2.0
            made.end_row(engine, "good")
    return made


def rows(history: RecentHistory, since: float = -np.inf) -> dict[str, list]:
    found = json.loads(history.as_json(since))
    assert found["columns"] == list(COLUMNS)
    return dict(zip(COLUMNS, zip(*found["rows"], strict=True), strict=True))


def test_the_change_of_speed_is_the_drives_own_and_the_corrected_force_follows_it(history):
    found = rows(history)
    at = np.array(found["at"])
    true = drive()
    speed = np.interp([at - 2.0, at], true.truth.t, true.truth.speed)
    dvdt = np.array(found["dvdt_mps2"], float)
    known = np.isfinite(dvdt)
    assert known.mean() > 0.9
    assert np.abs(dvdt - (speed[1] - speed[0]) / 2.0)[known].max() < 0.5
    corrected = np.array(found["corrected_x_mps2"], float)
    both = known & np.isfinite(corrected)
    assert np.corrcoef(corrected[both], dvdt[both])[0, 1] > 0.9


def test_only_rows_after_a_time_are_given_out_and_no_more_than_half_an_hour_is_kept(history):
    engine, now = make_engine(loaded("joint")), itertools.count()
    made = RecentHistory(lambda: 2.0 * next(now))
    for _ in range(KEPT + 50):
        made.end_row(engine, "starting")
    found = rows(made)
    assert len(found["at"]) == KEPT
    assert found["state"][-1] == "waiting"
    assert rows(made, found["at"][-3])["at"] == found["at"][-2:]
    assert sum(len(text) for _, text in made._rows) < 250 * KEPT
    assert max(len(text) for _, text in history._rows) < 250


@pytest.mark.parametrize("request_line", ["history", "history 0", "history nonsense"])
def test_a_daemon_gives_its_history_over_the_status_socket(tmp_path, request_line):
    bench = Bench(tmp_path)
    with running(bench.service()) as service:
        service._history.end_row(service.engine, "starting")
        found = json.loads(ask(tmp_path / "status.sock", request_line))
    assert found["columns"] == list(COLUMNS)
    assert len(found["rows"]) >= 1
