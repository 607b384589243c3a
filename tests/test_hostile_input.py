"""Hostile input: whatever comes is judged and counted, and the estimate does not learn from it."""

from __future__ import annotations

import json
import random

import numpy as np
import pytest

from engine_bus import (
    AIDED,
    MESSAGES,
    OBD_ANSWER,
    RICH,
    Sender,
    columns_of,
    engine_of,
    frames_of,
    load,
)
from imucald.can.columns import CAN_EFF_FLAG, FrameColumns
from imucald.can.e2e.protection import REASONS as FRAME_REASONS
from imucald.can.e2e.protector import MessageProtector
from imucald.can.logs.log_reader import CandumpWriter, LogReader
from imucald.inputs.routes import MessageRoute
from imucald.runtime.estimators import estimator_for
from imucald.runtime.output.output_frames import output_database
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine
from imucald.runtime.summary import as_json
from simulated_bus import (
    degrees_between,
    drive_frames,
    fed,
    loaded,
    merged,
    rotation_of,
    with_data,
    with_times,
)

PROTECTED = (0x200, 0x201, 0x1A0, 0x0C2, 0x130)
ESTIMATORS = ("full", "published")


def random_frames(rng: np.random.Generator, n: int, width: int) -> FrameColumns:
    """Random ids (most of them ours), lengths and bytes; stamps that stumble now and then."""
    ours = [m.can_id for m in MESSAGES.values()] + [OBD_ANSWER]
    ids = np.array([*ours, *ours, 0x7FF, 0x123, 0x64 | CAN_EFF_FLAG], np.uint32)
    length = rng.choice([0, 1, 2, 4, 7, 8, 8, 8, 8, 8, min(20, width), width], n).astype(np.uint8)
    data = rng.integers(0, 256, (n, width), dtype=np.uint8)
    data[rng.random(n) < 0.1] = 0xFF  # not available in most signals, and NaN
    data[rng.random(n) < 0.05] = 0x00
    data[np.arange(width) >= length[:, None]] = 0
    steps = rng.exponential(1.0 / 8000.0, n)
    jump = rng.random(n)
    steps[jump < 1e-4] = -3600.0
    steps[jump > 1.0 - 1e-4] = 86400.0 * 365
    t = 1.6e9 + np.cumsum(steps)
    return FrameColumns(t, rng.choice(ids, n), length, data, np.zeros(n, np.uint8), ("can0",))


def assert_all_judged(engine, frames_by_id) -> None:
    """Of each message: accepted + rejected = sent. In all: counted under a reason."""
    guard_total = 0
    for route in engine.router.routes:
        if isinstance(route, MessageRoute):
            sent = frames_by_id.get(route.match.can_id, 0)
            rejected = sum(route.checker.rejected.values())
            assert route.checker.accepted + rejected == sent, route.name
            guard_total += rejected
    counted = engine.router.rejected
    assert sum(counted[r] for r in FRAME_REASONS if r) == guard_total
    assert all(reason for reason in counted)


def count_ids(frames) -> dict[int, int]:
    ids, counts = np.unique(frames.can_id, return_counts=True)
    return dict(zip(ids.tolist(), counts.tolist(), strict=True))


def assert_well_formed(out: FrameColumns) -> None:
    """Every value is a number of its range or not available, and every counter goes on by one."""
    database = output_database()
    # a chunk of 15,000 frames is under two seconds: Health goes out once a second and on changes
    for name, least in (
        ("IMUCALD_Acceleration", 100), ("IMUCALD_AngularRate", 100), ("IMUCALD_Health", 2)
    ):  # fmt: skip
        rows = out.data[out.can_id == database.message(name).can_id]
        assert len(rows) >= least
        counter = (rows[:, 6] >> 4).astype(int)
        assert np.all(np.diff(counter) % 16 == 1)


@pytest.mark.slow
def test_a_million_random_frames_are_each_judged(tmp_path):
    rng = np.random.default_rng(7)
    config = load(RICH, tmp_path)
    engine = engine_of(config, estimator_for(config.config))
    totals: dict[int, int] = {}
    out_count = 0
    for chunk in range(20):
        frames = random_frames(rng, 50_000, 8 if chunk % 4 else 64)
        for can_id, n in count_ids(frames).items():
            totals[can_id] = totals.get(can_id, 0) + n
        out = engine.columns(frames)
        out_count += len(out)
        assert_well_formed(out)
    assert_all_judged(engine, totals)
    assert engine.sent == out_count
    assert {"short_frame", "checksum", "counter_jump", "not_finite", "out_of_range"} <= set(
        engine.router.rejected
    )


def test_fifty_thousand_random_frames_one_by_one_as_by_columns(tmp_path):
    rng = np.random.default_rng(8)
    config = load(RICH, tmp_path)
    frames = random_frames(rng, 50_000, 64)
    single, columns = engine_of(config), engine_of(config)
    rows = zip(
        frames.t.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True
    )
    out = [f for t, i, n, data in rows for f in single.frame(t, i, data[:n].tobytes())]
    assert frames_of(columns.columns(frames)) == out
    assert single.router.rejected == columns.router.rejected
    assert_all_judged(single, count_ids(frames))


# The estimate unmoved ----------------------------------------------------------------------------


def rows_of(frames, ids=PROTECTED):
    return np.flatnonzero(np.isin(frames.can_id, ids))


def chosen(frames, rng, share, ids=PROTECTED):
    rows = rows_of(frames, ids)
    return frames.take(np.sort(rng.choice(rows, int(share * len(rows)), replace=False)))


def wrong_bytes(frames, rng):
    """A burst of up to eight wrong bits: every CRC-8 sees it."""
    data = frames.data.copy()
    at = rng.integers(0, frames.length, len(frames))
    data[np.arange(len(frames)), at] ^= rng.integers(1, 256, len(frames), dtype=np.uint8)
    return with_data(frames, data)


def cut_short(frames, rng):
    return with_data(frames, frames.data, rng.integers(0, frames.length).astype(np.uint8))


def sent_again(frames, rng):
    return frames


def of_another_mount(frames, rng):
    """What a second sensor, turned by 90 degrees, would say; its checksums do not fit."""
    data = frames.data.copy()
    data[:, :6] = np.roll(frames.data[:, :6], 2, axis=1)
    return with_data(frames, data)


@pytest.fixture(scope="module", params=ESTIMATORS)
def clean(request):
    return request.param, fed(request.param, drive_frames())


@pytest.mark.parametrize("damage", [wrong_bytes, cut_short, sent_again, of_another_mount])
def test_damaged_frames_between_good_ones_do_not_move_the_estimate(clean, damage):
    estimator, undisturbed = clean
    rng = np.random.default_rng(5)
    frames = drive_frames()
    ids = PROTECTED[:2] if damage is of_another_mount else PROTECTED
    extra = damage(chosen(frames, rng, 0.001, ids), rng)
    disturbed = fed(estimator, merged(frames, with_times(extra, extra.t + 2e-6)))
    rejected = disturbed.router.rejected
    assert rejected.total() - rejected["untrusted"] == len(extra)
    assert rejected["untrusted"] <= 3 * len(extra)
    lost = rejected["untrusted"] - undisturbed.router.rejected["untrusted"]
    assert disturbed.router.used == undisturbed.router.used - lost
    # what moves it is only that the good samples around are dropped too
    moved = degrees_between(rotation_of(disturbed), rotation_of(undisturbed))
    std = undisturbed.pipeline.estimator.estimate().std
    assert moved < np.degrees(max(std))


def test_what_a_rejected_frame_says_has_no_influence_at_all(clean):
    """Frames with wrong checksums at the same places, whatever is in them: the same last bit."""
    estimator, _ = clean
    frames = drive_frames()
    extra = chosen(frames, np.random.default_rng(5), 0.002, PROTECTED[:2])
    contents = [
        wrong_bytes(extra, np.random.default_rng(1)),
        wrong_bytes(extra, np.random.default_rng(2)),
        of_another_mount(extra, None),
    ]
    found = [
        fed(estimator, merged(frames, with_times(content, content.t + 2e-6)))
        for content in contents
    ]
    rejected = found[0].router.rejected
    assert rejected["checksum"] > 0.99 * len(extra)
    for other in found[1:]:
        assert other.router.rejected == rejected
        assert np.array_equal(rotation_of(other), rotation_of(found[0]))
        assert other.pipeline.estimator.estimate().std == found[0].pipeline.estimator.estimate().std


def test_frames_that_are_not_ours_change_nothing_at_all(clean):
    estimator, undisturbed = clean
    rng = np.random.default_rng(6)
    frames = drive_frames()
    n = 30_000
    ids = rng.integers(0x300, 0x600, n).astype(np.uint32)
    data = rng.integers(0, 256, (n, 8), dtype=np.uint8)
    t = np.sort(rng.uniform(frames.t[0], frames.t[-1], n))
    foreign = FrameColumns(
        t, ids, np.full(n, 8, np.uint8), data, np.zeros(n, np.uint8), frames.channels
    )
    disturbed = fed(estimator, merged(frames, foreign))
    assert np.array_equal(rotation_of(disturbed), rotation_of(undisturbed))
    assert disturbed.router.rejected == undisturbed.router.rejected


def test_a_takeover_with_right_checksums_is_not_learnt_from(clean):
    """Somebody sends well-formed frames of another mount beside the sensor: neither is believed."""
    estimator, undisturbed = clean
    frames = drive_frames()
    last_minute = frames.t > frames.t[-1] - 60.0
    attacked = frames.take(last_minute & (frames.can_id == 0x200))
    protector = make_engine(loaded())
    route = next(r for r in protector.router.routes if r.match.can_id == 0x200)
    forged = MessageProtector(route.checker.spec)
    data = forged.protect_columns(of_another_mount(attacked, None).data)
    forgery = with_data(attacked, data)
    disturbed = fed(estimator, merged(frames, with_times(forgery, forgery.t + 2e-6)))
    before = fed(estimator, frames.take(~last_minute))
    moved = degrees_between(rotation_of(disturbed), rotation_of(before))
    assert moved < np.degrees(max(before.pipeline.estimator.estimate().std))
    assert (
        disturbed.router.sample_counts["accel"] < undisturbed.router.sample_counts["accel"] - 5000
    )


# Logs --------------------------------------------------------------------------------------------


def damaged_line(rng: random.Random, line: bytes) -> bytes:
    """One line of a log, damaged in one of many ways; it may happen to stay valid."""
    at = rng.randrange(len(line))
    ways = (
        lambda: line[:at],
        lambda: line[:at] + bytes([rng.randrange(256)]) + line[at + 1 :],
        lambda: line[:at] + line[at + 1 :],
        lambda: line.replace(b"#", rng.choice([b"##", b"", b"#R", b"# "])),
        lambda: line.replace(b"(", rng.choice([b"(-", b"(nan", b"(1e400", b"((", b"(9" * 40])),
        lambda: line + rng.randbytes(rng.choice([1, 30, 5000])),
        lambda: b"\x00" * rng.randrange(1, 60),
        lambda: rng.randbytes(rng.randrange(1, 200)),
        lambda: line[at:] + line[:at],
    )
    return rng.choice(ways)()


@pytest.fixture(scope="module")
def log_lines(tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "clean.log"
    with CandumpWriter(path) as writer:
        writer.write_columns(drive_frames().take(slice(0, 30_000)))
    return path.read_bytes().splitlines()


def replayed(path):
    engine = make_engine(loaded("published"))
    reader = LogReader([path], engine.router.matches)
    return Replay(engine, reader).run(), reader


def test_two_thousand_damaged_lines_are_each_read_or_counted(log_lines, tmp_path):
    rng = random.Random(9)
    lines = list(log_lines)
    for i in rng.sample(range(len(lines)), 2000):
        lines[i] = damaged_line(rng, lines[i]).replace(b"\n", b"?").replace(b"\r", b"?")
    path = tmp_path / "damaged.log"
    path.write_bytes(b"\n".join(lines) + b"\n")
    result, reader = replayed(path)
    blank = sum(not line.strip() for line in lines)
    assert reader.frames_read + sum(reader.rejected.values()) + blank == len(lines)
    assert sum(reader.rejected.values()) > 1000
    assert all(f"{path}:" in text for text in reader.problems)
    assert json.loads(as_json(result))["frames"]["rejected"].items() >= reader.rejected.items()


def test_lines_that_are_no_frames_leave_the_estimate_as_it_is(log_lines, tmp_path):
    rng = random.Random(10)
    mixed = []
    for i, line in enumerate(log_lines):
        mixed.append(line)
        if i % 15 == 0:  # 2,000 of them
            mixed.append(
                rng.choice([line[:-3] + b"G", line[:20], b"\x00\xff", b"(1.0) can0 zzz#00"])
            )
    paths = [tmp_path / "clean.log", tmp_path / "mixed.log"]
    for path, lines in zip(paths, (log_lines, mixed), strict=True):
        path.write_bytes(b"\n".join(lines) + b"\n")
    (clean_result, _), (mixed_result, reader) = map(replayed, paths)
    assert sum(reader.rejected.values()) == len(mixed) - len(log_lines)
    for key in ("mount", "state", "first_usable_s", "signals", "duration_s"):
        assert mixed_result[key] == clean_result[key]


def test_every_reason_of_a_refused_sample_is_reported(tmp_path):
    config = load(RICH, tmp_path)
    engine, sender = engine_of(config), Sender(config)
    spoilt = {
        "not_finite": (0.0, MESSAGES["PAR"].can_id, b"\x00\x00\xc0\x7f" + bytes(16)),
        "out_of_range": sender.frame(0.0, "SPD", V=310.0),
        "saturated": sender.frame(0.0, "ACC", AX=60.0, AY=0.0, AZ=0.0),
        "not_available": (0.0, MESSAGES["ACC_Z"].can_id, b"\x80\x00"),
        "short_frame": (0.0, MESSAGES["MAG"].can_id, bytes(5)),
    }
    for reason, frame in spoilt.items():
        engine.frame(*frame)
        assert engine.router.rejected[reason] == 1, reason
    by_columns = engine_of(config)
    by_columns.columns(columns_of(spoilt.values()))
    assert by_columns.router.rejected == engine.router.rejected


def test_attitude_and_travel_direction_stand_random_frames(tmp_path):
    rng = np.random.default_rng(11)
    config = load(AIDED, tmp_path)
    engine = engine_of(config)
    for _ in range(4):
        frames = random_frames(rng, 15_000, 8)
        assert_well_formed(engine.columns(frames))
    assert {"accel", "gyro", "mag", "speed"} <= set(engine.router.sample_counts)
