"""An engine in the place of another one: where the inputs are the same, nobody notices."""

from __future__ import annotations

import random

import pytest

from engine_bus import (
    CONFIGS,
    DBC,
    RICH,
    Fine,
    ScriptedEstimator,
    Sender,
    Traffic,
    columns_of,
    engine_of,
    frames_of,
    load,
)
from imucald.motion.signal_health import SOUND_S
from imucald.runtime.engine import Engine

GYROSCOPE = (
    "gyroscope: {x: GYR.GX, y: {signal: GYR.GY, sign: -1}, z: {signal: GYR.GZ, offset: 0.25}}"
)


class Judging(ScriptedEstimator):
    """Says that the yaw rate is stuck, for as long as `stuck` holds."""

    stuck = True

    @property
    def stuck_signals(self) -> dict[str, bool]:
        return {"yaw_rate": self.stuck}


def one_by_one(engine: Engine, frames: list) -> list:
    return [out for frame in frames for out in engine.frame(*frame)]


def in_columns(engine: Engine, frames: list) -> list:
    return frames_of(engine.columns(columns_of(frames))) if frames else []


@pytest.mark.parametrize("feed", [one_by_one, in_columns])
@pytest.mark.parametrize("name", sorted(CONFIGS))
def test_with_the_same_configuration_every_frame_is_as_if_nothing_had_been(name, feed, tmp_path):
    for seed in range(6):
        rng = random.Random(seed)
        loaded = load(CONFIGS[name], tmp_path)
        frames = Traffic(rng, loaded).frames(1500)
        whole = engine_of(loaded)
        expected = feed(whole, frames)
        engine, got, start = engine_of(loaded), [], 0
        while start < len(frames):
            stop = start + rng.randint(1, 400)
            got += feed(engine, frames[start:stop])
            former, engine, start = engine, engine_of(loaded), stop
            engine.go_on_from(former, former.pipeline.estimator, keeps_consumers=True)
        assert got == expected
        assert engine.sent == whole.sent
        assert engine.router.rejected == whole.router.rejected
        assert engine.router.sample_counts == whole.router.sample_counts
        assert engine.router.used == whole.router.used
        assert engine.health() == whole.health()
        assert engine.pipeline.estimator.rows == whole.pipeline.estimator.rows


def after(engine: Engine, text: str, folder, dbc: str = DBC) -> Engine:
    """An engine of another configuration in the place of one, with an estimator of its own."""
    made = engine_of(load(text, folder, dbc), ScriptedEstimator())
    made.go_on_from(engine, made.pipeline.estimator)
    return made


def acc(sender: Sender, t: float) -> tuple[float, int, bytes]:
    return sender.frame(t, "ACC", AX=0.1, AY=0.2, AZ=9.8)


@pytest.mark.parametrize(
    ("change", "is_same"),
    [
        (("sign: -1", "sign: 1"), False),
        (("offset: 0.25", "offset: 0.5"), False),
        (("z: {signal: GYR.GZ", "z: {unit: rad/s, signal: GYR.GZ"), False),
        ((GYROSCOPE, "gyroscope: {x: MAG.MX, y: MAG.MY, z: MAG.MZ}"), None),
        (("status_rate: 5", "status_rate: 10"), True),
        (("z: {signal: GYR.GZ", "z: {range: [-200, 200], signal: GYR.GZ"), True),
    ],
)
def test_a_source_is_the_same_where_it_gives_the_same_numbers(change, is_same, tmp_path):
    before = engine_of(load(RICH, tmp_path)).router
    text = RICH.replace(*change)
    assert text != RICH
    if is_same is None:
        text = text.replace(
            "gyroscope: {x: MAG.MX, y: MAG.MY, z: MAG.MZ}",
            "gyroscope: {x: {signal: MAG.MX, unit: deg/s}, y: {signal: MAG.MY, unit: deg/s},"
            " z: {signal: MAG.MZ, unit: deg/s}}",
        )
        text = "\n".join(line for line in text.splitlines() if not line.startswith("  GYR:"))
    now = engine_of(load(text, tmp_path)).router
    same = now.same_sources(before)
    assert ("gyro" in same) == bool(is_same)
    assert same >= {"accel", "speed", "mag", "yaw_rate"}


@pytest.mark.parametrize(
    ("old", "new", "is_same"),
    [
        ("GX : 0|16@1- (0.01,0)", "GX : 0|16@1- (0.02,0)", False),
        ("GX : 0|16@1- (0.01,0)", "GX : 0|16@1+ (0.01,0)", False),
        ("BO_ 2566844672 GYR", "BO_ 2566844673 GYR", False),
        ('GX : 0|16@1- (0.01,0) [0|0] "deg/s" CAR', 'GX : 0|16@1- (0.01,0) [0|0] "deg/s" X', True),
    ],
)
def test_what_a_database_says_of_a_signal_decides_whether_it_is_the_same(
    old, new, is_same, tmp_path
):
    before = engine_of(load(RICH, tmp_path)).router
    assert old in DBC
    now = engine_of(load(RICH, tmp_path, DBC.replace(old, new))).router
    assert ("gyro" in now.same_sources(before)) == is_same


def test_wheels_that_give_the_speed_decide_whether_it_is_the_same(tmp_path):
    before = engine_of(load(CONFIGS["planar"], tmp_path)).router
    same = engine_of(load(CONFIGS["planar"], tmp_path)).router.same_sources(before)
    assert same == before.channels
    other = load(CONFIGS["planar"].replace("WHL.FL", "{signal: WHL.FL, sign: -1}"), tmp_path)
    assert before.channels - engine_of(other).router.same_sources(before) == {
        "speed",
        "wheel_speeds",
    }


def heard(folder) -> tuple[Engine, Sender, list]:
    """An engine that has heard 20 frames of the accelerometer, their sender, and the frames."""
    loaded = load(RICH, folder)
    engine, sender = engine_of(loaded), Sender(loaded)
    frames = [acc(sender, 1e6 + 0.01 * i) for i in range(20)]
    one_by_one(engine, frames)
    return engine, sender, frames


def test_an_old_frame_sent_again_is_no_good_one_after_the_change(tmp_path):
    engine, sender, frames = heard(tmp_path)
    now = after(engine, RICH.replace("status_rate: 5", "status_rate: 10"), tmp_path)
    used = now.router.used
    now.frame(1e6 + 0.2, *frames[-1][1:])
    assert now.router.used == used
    assert now.router.rejected["counter_repeated"] == 1
    now.frame(*acc(sender, 1e6 + 0.21))
    assert now.router.rejected["untrusted"] == 1, "not trusted yet"


def test_another_protection_begins_anew(tmp_path):
    engine, _, frames = heard(tmp_path)
    now = after(engine, RICH.replace("max_step: 2", "max_step: 3"), tmp_path)
    now.frame(1e6 + 0.2, *frames[-1][1:])
    assert not now.router.rejected


def test_two_senders_are_still_known_to_be_two(tmp_path):
    loaded = load(RICH, tmp_path)
    engine, sender = engine_of(loaded), Sender(loaded)
    t = [1e6 + 0.01 * i for i in range(1500)]
    one_by_one(engine, [sender.frame(x, "WHL", FL=36.0) for x in t])
    now = after(engine, RICH.replace("status_rate: 5", "status_rate: 10"), tmp_path)
    twice = [sender.frame(t[-1] + 0.001 * i, "WHL", FL=36.0) for i in range(3000)]
    one_by_one(now, twice)
    assert now.router.rejected["too_fast"] > 1000, "what is usual was known"


def test_the_faults_of_signals_that_nobody_judges_any_more_end(tmp_path):
    loaded = load(RICH, tmp_path)
    estimator = Judging()
    engine = engine_of(loaded, estimator)
    engine.frame(*acc(Sender(loaded), 1e6))
    for i in range(30):
        engine.idle(0.1 * i)
    assert set(engine.pipeline.health.signals) == {"yaw_rate"}
    deaf = after(engine, RICH, tmp_path)
    assert not deaf.pipeline.health.signals
    (event,) = deaf.pipeline.health.summary()["events"]
    assert (event["sensor"], event["until_s"]) == ("yaw_rate", pytest.approx(2.9, abs=0.2))


def test_a_stuck_yaw_rate_stays_so_for_the_next_estimator_that_judges(tmp_path):
    loaded = load(RICH, tmp_path)
    engine = engine_of(loaded, Judging())
    sender = Sender(loaded)
    engine.frame(*acc(sender, 1e6))
    for i in range(30):
        engine.idle(0.1 * i)
    made = engine_of(load(RICH, tmp_path), Judging())
    made.pipeline.estimator.stuck = False
    made.go_on_from(engine, made.pipeline.estimator)
    assert set(made.pipeline.health.signals) == {"yaw_rate"}
    begin = made.pipeline.k
    for k in range(begin + 1, begin + 200):
        if made.pipeline.health.signals:
            made.frame(*acc(sender, 1e6 + 0.1 * k + 0.05))
    assert 0.1 * (made.pipeline.k - begin) == pytest.approx(SOUND_S, abs=0.3)
    other = engine_of(load(RICH.replace("yaw_rate: MUX.YAW", "yaw_rate: GYR.GZ"), tmp_path))
    other.go_on_from(engine, other.pipeline.estimator)
    assert not other.pipeline.health.signals


def test_an_input_that_is_another_one_counts_as_missing_a_second_later_and_no_other(tmp_path):
    loaded = load(RICH, tmp_path)
    engine, sender = engine_of(loaded), Sender(loaded)
    for i in range(2000):
        engine.frame(*acc(sender, 1e6 + 0.01 * i))
    health = engine.health()
    assert (health.accelerometer_missing, health.gyroscope_missing) == (False, True)
    assert health.speed_missing
    now = after(engine, RICH.replace("sign: -1", "sign: 1"), tmp_path)
    health = now.health()
    assert (health.accelerometer_missing, health.gyroscope_missing) == (False, False)
    assert health.speed_missing, "it was before, and it is the same"
    for i in range(2000, 2150):
        now.frame(*acc(sender, 1e6 + 0.01 * i))
    assert now.health().gyroscope_missing


def test_counters_of_messages_that_stay_go_on_and_no_others(tmp_path):
    def counter(out: list, can_id: int) -> int:
        return next(data for i, data in reversed(out) if i == can_id)[6] >> 4

    loaded = load(RICH, tmp_path)
    engine, sender = engine_of(loaded, Fine()), Sender(loaded)
    out = one_by_one(engine, [acc(sender, 1e6 + 0.01 * i) for i in range(6)])
    assert counter(out, 0x640) == 5
    now = after(engine, RICH.replace("status_rate: 5", "status_rate: 10"), tmp_path)
    assert counter(now.frame(*acc(sender, 1e6 + 0.06)), 0x640) == 6
    text = RICH.replace("status_rate: 5", "status_rate: 5, ids: {acceleration: 0x651}")
    other = after(now, text, tmp_path)
    assert counter(other.frame(*acc(sender, 1e6 + 0.07)), 0x651) == 0, "another message"
