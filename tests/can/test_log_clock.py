"""The clock of a recorder: coarse, begun again and again, in another unit, or no clock at all."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns, IdMatch
from imucald.can.logs.log_format import ReadStatistics
from imucald.can.logs.log_reader import LogReader
from imucald.can.logs.recorder_clock import by_the_clock
from imucald.can.lost_frames import lost_share
from imucald.core.errors import LogError

SECONDS = 120.0
CYCLES = {0x100: 0.01, 0x101: 0.01, 0x120: 0.02, 0x130: 0.1}
JITTER = 0.0005


def sent() -> list[tuple[float, int]]:
    """Frames of periodic senders in the order of their times [s]."""
    rng = np.random.default_rng(5)
    frames = []
    for can_id, cycle in CYCLES.items():
        t = 0.003 * rng.random() + cycle * np.arange(round(SECONDS / cycle))
        frames += [(float(x), can_id) for x in t + JITTER * rng.random(len(t))]
    return sorted(frames)


def log(path: Path, stamps: NDArray[np.float64], ids: list[int]) -> Path:
    """Each frame carries its number, so that none can be taken for another."""
    lines = (
        f"({t:.6f}) can0 {can_id:03X}#{number:016X}\n"
        for number, (t, can_id) in enumerate(zip(stamps.tolist(), ids, strict=True))
    )
    path.write_text("".join(lines))
    return path


def read(path: Path, keep: list[IdMatch] | None = None) -> tuple[list[FrameColumns], LogReader]:
    reader = LogReader([path], keep, cycles=[(IdMatch(i, 0x7FF), c) for i, c in CYCLES.items()])
    return list(reader), reader


def times_of(path: Path) -> tuple[NDArray[np.float64], list[str]]:
    chunks, reader = read(path)
    numbers = np.concatenate([c.data.reshape(-1, 8).view(">u8").ravel() for c in chunks])
    assert np.array_equal(numbers, np.arange(len(numbers)))  # none lost, in order
    return np.concatenate([c.t for c in chunks]), reader.problems


@pytest.mark.parametrize("step", [0.05, 0.2, 1.0])
@pytest.mark.parametrize("handed_over", [False, True], ids=["coarse", "bursts"])
def test_frames_that_share_a_stamp_are_spread_over_the_time_they_were_sent_in(
    tmp_path: Path, step: float, handed_over: bool
) -> None:
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    stamps = step * (np.ceil(t / step) if handed_over else np.floor(t / step))
    found, problems = times_of(log(tmp_path / "coarse.log", stamps, ids.tolist()))
    error = found - t
    assert np.abs(error - np.median(error)).max() < 0.012  # one cycle
    assert np.median(error) == pytest.approx(step if handed_over else 0.0, abs=0.012)
    assert np.all(np.diff(found) >= 0.0)
    (note,) = problems
    assert f"steps of {step:g} s" in note
    assert "candump -l" in note


@pytest.mark.parametrize("apart", [3e-5, 8e-5])
def test_frames_that_are_stamped_as_they_are_read_lie_closer_than_a_bus_allows(
    tmp_path: Path, apart: float
) -> None:
    """A program reads what an adapter gathered for 120 ms, and stamps each frame as it does."""
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    burst = np.ceil(t / 0.12)
    place = np.arange(len(t)) - np.searchsorted(burst, burst)
    found, (note,) = times_of(log(tmp_path / "r.log", 0.12 * burst + apart * place, ids.tolist()))
    error = found - t
    assert np.abs(error - np.median(error)).max() < 0.012  # one cycle
    assert "steps of 0.12 s" in note


def test_stamps_of_a_clock_of_64_hertz_are_coarse_where_a_sender_is_faster(tmp_path: Path) -> None:
    slow = [(0.02 * k + 0.003 * i, 0x200 + i) for k in range(6000) for i in range(5)]
    t, ids = (np.array(column) for column in zip(*sorted(sent() + slow), strict=True))
    found, (note,) = times_of(log(tmp_path / "w.log", np.floor(t * 64) / 64, ids.tolist()))
    assert np.abs(found - t).max() < 0.016
    assert "steps of 0.0156 s" in note


def test_stamps_of_a_clock_of_64_hertz_are_not_told_as_lost_frames(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    cycles = {0x100: 0.01, 0x120: 0.02, 0x130: 0.1, 0x140: 0.02, 0x150: 0.05}
    frames = [
        (0.003 * rng.random() + cycle * k, can_id)
        for can_id, cycle in cycles.items()
        for k in range(round(60.0 / cycle))
    ]
    t, ids = (np.array(column) for column in zip(*sorted(frames), strict=True))
    chunks, _ = read(log(tmp_path / "w.log", np.floor(t * 64) / 64, ids.tolist()))
    found, seen = (np.concatenate([getattr(c, n) for c in chunks]) for n in ("t", "can_id"))
    shares = [lost_share(np.diff(found[seen == can_id])) for can_id in cycles]
    told = [share for share in shares if share is not None]
    assert len(told) >= 2
    assert told == pytest.approx(len(told) * [0.0], abs=0.005)


def test_bursts_that_are_handed_over_unevenly_keep_the_pace_of_their_senders(
    tmp_path: Path,
) -> None:
    """As an adapter does that is asked now and then; its frames are 20 us apart."""
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    rng = np.random.default_rng(8)
    asked = np.cumsum(0.1 + 0.04 * rng.random(1200))
    burst = np.searchsorted(asked, t)
    within = np.arange(len(t)) - np.searchsorted(burst, burst)
    found, problems = times_of(log(tmp_path / "b.log", asked[burst] + 2e-5 * within, ids.tolist()))
    error = (found - t)[200:-50]  # the last burst is cut
    assert np.abs(error - np.median(error)).max() < 0.015
    assert problems


def test_a_hole_between_coarse_stamps_remains_a_hole(tmp_path: Path) -> None:
    frames = [(t, i) for t, i in sent() if not 40.0 <= t < 50.0]
    t, ids = (np.array(column) for column in zip(*frames, strict=True))
    found, _ = times_of(log(tmp_path / "hole.log", np.floor(t), ids.tolist()))
    assert np.diff(found).max() > 9.9
    assert np.abs(found - t).max() < 0.02


@pytest.mark.parametrize("resolution", [1e-6, 1e-4, 1e-3])
def test_stamps_that_tell_a_sender_s_frames_apart_stay_as_they_are(
    tmp_path: Path, resolution: float
) -> None:
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    stamps = np.round(t / resolution) * resolution
    found, problems = times_of(log(tmp_path / "fine.log", stamps, ids.tolist()))
    assert np.array_equal(found, np.round(stamps, 6))
    assert problems == []


def test_a_strict_reading_refuses_coarse_stamps(tmp_path: Path) -> None:
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    path = log(tmp_path / "coarse.log", np.floor(t), ids.tolist())
    with pytest.raises(LogError, match="steps of 1 s"):
        list(LogReader([path], strict=True))


@pytest.mark.parametrize("loop", [1.0, 2.5])
def test_a_clock_that_begins_again_is_counted_on(tmp_path: Path, loop: float) -> None:
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    found, problems = times_of(log(tmp_path / "loop.log", t % loop, ids.tolist()))
    assert found == pytest.approx(t, abs=2e-6)
    (note,) = problems
    assert f"start from zero again every {loop:g} s" in note


def test_recordings_of_other_lengths_behind_one_another_are_no_loop(tmp_path: Path) -> None:
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    starts = np.array([0.0, 3.0, 10.0, 12.0, 30.0, 50.0, 75.0])
    stamps = t - starts[np.searchsorted(starts, t, side="right") - 1]
    found, problems = times_of(log(tmp_path / "again.log", stamps, ids.tolist()))
    assert found == pytest.approx(stamps, abs=1e-6)
    assert problems == []


def test_a_log_that_was_cut_into_equal_pieces_by_hand_is_one_after_another(tmp_path: Path) -> None:
    """Recordings that follow one another each with the clock set back by minutes hold no proof of
    too many frames: their times overlap."""
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    stamps = np.concatenate([t + 5.0 * k for k in range(40)])
    assert read(log(tmp_path / "many.log", stamps, 40 * ids.tolist()))[1].problems == []


@pytest.mark.parametrize(
    "stamps",
    [lambda t: t * 1e-3, lambda t: np.diff(t, prepend=0.0), lambda t: 0.0 * t],
    ids=["thousandths", "differences", "equal"],
)
@pytest.mark.parametrize("cycles", [True, False], ids=["cycles stated", "none"])
def test_more_frames_than_a_bus_carries_are_refused_with_a_remedy(
    tmp_path: Path, stamps: object, cycles: bool
) -> None:
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    assert callable(stamps)
    path = log(tmp_path / "fast.log", stamps(t), ids.tolist())
    stated = [(IdMatch(i, 0x7FF), c) for i, c in CYCLES.items()] if cycles else []
    with pytest.raises(
        LogError, match=r"multiply them by 1000|[Ee]xport them in seconds|count from the line"
    ):
        list(LogReader([path], cycles=stated))


def test_a_busy_bus_of_a_megabit_is_believed(tmp_path: Path) -> None:
    """Frames as close as they can follow each other."""
    stamps = 130e-6 * np.arange(200_000)
    assert read(log(tmp_path / "busy.log", stamps, 200_000 * [0x100]))[1].problems == []


def test_gvret_in_milliseconds_is_named(tmp_path: Path) -> None:
    lines = ["Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8"]
    lines += [f"{1e3 * t:.0f},{can_id:08X},false,Rx,0,1,00" for t, can_id in sent()]
    path = tmp_path / "canDrive.csv"
    path.write_text("\n".join(lines) + "\n")
    cycles = [(IdMatch(i, 0x7FF), c) for i, c in CYCLES.items()]
    with pytest.raises(LogError, match="milliseconds where the format has microseconds"):
        list(LogReader([path], cycles=cycles))


def test_copies_keep_the_stamp_of_their_frame(tmp_path):
    """A logger that writes each frame twice has no coarse clock, and copies are told by stamps."""
    frames = [one for one in sent() for _ in range(2)]
    lines = [f"({t:.6f}) can0 {i:03X}#{n // 2:016X}\n" for n, (t, i) in enumerate(frames)]
    path = tmp_path / "twice.log"
    path.write_text("".join(lines))
    chunks, _ = read(path)
    times = np.concatenate([chunk.t for chunk in chunks])
    assert (times[::2] == times[1::2]).all()
    assert np.abs(times - [round(t, 6) for t, _ in frames]).max() < 1e-9


def with_wrong_stamps(t: NDArray[np.float64], places: dict[int, float]) -> NDArray[np.float64]:
    stamps = t + 1.7e9
    for place, error in places.items():
        stamps[place] += error
    return stamps


@pytest.mark.parametrize("error", [-2816.0, 65536.0, -15.0])
@pytest.mark.parametrize("kept", [None, [IdMatch(0x100, 0x7FF)]], ids=["all", "one message"])
def test_a_frame_whose_stamp_jumps_away_and_back_is_rejected(
    tmp_path: Path, error: float, kept: list[IdMatch] | None
) -> None:
    """A wrong bit in one stamp makes no drive of 120 s last for an hour."""
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    place = int(np.flatnonzero(ids == 0x100)[5000])
    path = log(tmp_path / "wrong.log", with_wrong_stamps(t, {place: error}), ids.tolist())
    chunks, reader = read(path, kept)
    found = np.concatenate([c.t for c in chunks])
    assert found.max() - found.min() < SECONDS + 0.1
    assert reader.rejected == {"bad_timestamp": 1}
    assert f"is {error:+.1f} s from those" in reader.problems[0]
    assert len(found) == (len(t) if kept is None else 12000) - 1


def test_it_does_not_depend_on_the_chunks_which_stamps_are_damaged() -> None:
    t, ids = (np.array(column) for column in zip(*sent()[:40], strict=True))
    places = {7: 300.0, 9: -50.0, 20: 90.0, 21: 90.0, 30: 40.0, 38: 70.0, 39: -70.0}
    stamps = with_wrong_stamps(t, places)
    right = np.delete(stamps, [7, 9, 30])
    everything = FrameColumns(
        stamps, ids.astype("u4"), np.full(40, 8, "u1"), np.zeros((40, 8), "u1"),
        np.zeros(40, "u1"), ("can0",),
    )  # fmt: skip
    rng = np.random.default_rng(3)
    for _ in range(200):
        cuts = [0, *np.unique(rng.integers(1, 40, rng.integers(1, 40))).tolist(), 40]
        pieces = (everything.take(slice(a, b)) for a, b in pairwise(cuts))
        statistics = ReadStatistics(strict=False)
        found = list(by_the_clock("x.log", pieces, statistics))
        assert np.array_equal(np.concatenate([c.t for c in found]), right)
        assert statistics.rejected == {"bad_timestamp": 3}


def test_two_clocks_by_turns_are_left_as_they_are(tmp_path: Path) -> None:
    """Nobody knows which of them is right."""
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    stamps = with_wrong_stamps(t, dict.fromkeys(range(1, len(t), 2), 1e6))
    chunks, reader = read(log(tmp_path / "turns.log", stamps, ids.tolist()))
    assert sum(map(len, chunks)) == len(t)
    assert reader.rejected == {}


def test_a_clock_that_is_set_and_a_hole_reject_no_frame(tmp_path: Path) -> None:
    t, ids = (np.array(column) for column in zip(*sent(), strict=True))
    stamps = t + 1.7e9 + 3600.0 * (t > 30.0) - 7200.0 * (t > 60.0) + 20.0 * (t > 90.0)
    chunks, reader = read(log(tmp_path / "set.log", stamps, ids.tolist()))
    assert sum(map(len, chunks)) == len(t)
    assert reader.rejected == {}


def test_a_channel_that_falls_silent_ends_no_reading(tmp_path: Path) -> None:
    path = tmp_path / "two.log"
    with path.open("w") as file:
        for k in range(60_000):  # several blocks of text
            channel = k % 2 if k < 20_000 else 0
            file.write(f"({1e9 + 0.001 * k:.6f}) can{channel} 123#{k:016X}\n")
    chunks, _ = read(path)
    assert len(chunks) > 1
    assert sum(map(len, chunks)) == 60_000
