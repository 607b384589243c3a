"""A consumer whose calculation fails: all else goes on, it begins again, and that is reported."""

from __future__ import annotations

import io
import math
from functools import cache

import pytest

from engine_bus import Fine, Sender, columns_of, engine_of, frames_of, load
from imucald.core.errors import EstimateError
from imucald.core.samples import GRAVITY
from imucald.runtime.summary import RunCounts, summary
from imucald.service.announcements import Announcements
from imucald.service.journal import Journal

CONFIG = """
database: bus.dbc
signals:
  accelerometer: {x: ACC.AX, y: ACC.AY, z: ACC.AZ}
  gyroscope: {x: GYR.GX, y: GYR.GY, z: GYR.GZ}
  speed: SPD.V
attitude: {enabled: true}
"""
ATTITUDE, ACCEL = 0x646, 0x640
END, FAILS = 40.0, 20.0


@pytest.fixture(autouse=True)
def failed_calculations_fail_the_test() -> None:
    """They are the subject here."""


@cache
def traffic():
    sender, frames = Sender(), []
    for i in range(round(END / 0.02)):
        t = 1e6 + 0.02 * i
        swing = 0.05 * math.sin(i)
        frames.append(sender.frame(t, "ACC", AX=swing, AY=-swing, AZ=GRAVITY + swing))
        frames.append(sender.frame(t, "GYR", GX=swing, GY=0.0, GZ=-swing))
        if i % 5 == 0:
            frames.append(sender.frame(t, "SPD", V=0.0))
    return frames


def engine_that_fails(tmp_path, error, where="accel", times=1):
    engine = engine_of(load(CONFIG, tmp_path), Fine())
    (consumer,) = engine.consumers
    left = [times]
    of_filter = type(consumer.filter)

    class Failing(of_filter):
        def accel(self, t, values):
            if where == "accel" and t > FAILS and left[0]:
                left[0] -= 1
                raise error
            super().accel(t, values)

        def estimate(self, now=None):
            if where == "tick" and now is not None and now > FAILS and left[0]:
                left[0] -= 1
                raise error
            return super().estimate(now)

    consumer._new_filter = lambda: Failing(consumer._settings)
    consumer.begin_anew()
    return engine


def states(frames):
    return [data[6] & 0x0F for can_id, data in frames if can_id == ATTITUDE]


def replayed(engine):
    return frames_of(engine.columns(columns_of(traffic())))


@pytest.mark.parametrize("where", ["accel", "tick"])
@pytest.mark.parametrize(
    "error", [EstimateError("no"), ZeroDivisionError("x"), ValueError("math domain error")]
)
def test_it_begins_anew_and_all_else_goes_on(tmp_path, where, error):
    engine = engine_that_fails(tmp_path, error, where)
    out = [frame for row in traffic() for frame in engine.frame(*row)]
    sent = states(out)
    assert len(sent) == pytest.approx(10 * END, abs=2), "no frame is missing"
    good = [k for k, state in enumerate(sent) if state == 3]
    lost = [k for k in range(good[0], len(sent)) if sent[k] != 3]
    assert sent[lost[0]] < 2, "not available, or starting, from the next frame on"
    assert lost[0] == pytest.approx(10 * FAILS, abs=2)
    assert len(lost) == pytest.approx(10 * 6, abs=12), "a start"
    assert sent[-1] == 3
    assert sum(can_id == ACCEL for can_id, _ in out) == round(END / 0.02)
    assert engine.consumer_group.failures == {"attitude": 1}
    assert type(error).__name__ in engine.consumer_group.last_failures["attitude"]
    assert "test_failing_consumer.py" in engine.consumer_group.last_failures["attitude"]
    assert (
        frames_of(engine_that_fails(tmp_path, error, where).columns(columns_of(traffic()))) == out
    )


def test_it_is_counted_and_logged(tmp_path):
    engine = engine_that_fails(tmp_path, EstimateError("too little"), times=3)
    replayed(engine)
    found = summary(engine, RunCounts(0, 0, {}), END)
    assert found["attitude"]["failures"] == 3
    assert found["attitude"]["state"] == "relative_heading"
    lines = io.StringIO()
    announcements = Announcements(Journal(lines))
    for _ in range(3):
        announcements.update(engine, 0, 60.0)
    said = [line for line in lines.getvalue().splitlines() if "failed" in line]
    assert len(said) == 1
    assert "attitude failed and was restarted, 3 times so far: EstimateError: too little" in said[0]


def test_a_mistake_of_the_program_is_not_hidden(tmp_path):
    engine = engine_that_fails(tmp_path, TypeError("a mistake"))
    with pytest.raises(TypeError, match="a mistake"):
        replayed(engine)
