"""What candump prints on a screen is read strictly, whatever its time stamps say.

The truth is the list of frames from which the lines are printed here.
"""

from __future__ import annotations

from datetime import UTC, datetime
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from imucald.can.logs.log_reader import CAN_EFF_FLAG, IdMatch, LogReader
from imucald.core.errors import LogError
from log_text import Frame, frames_of

CLOCK = 0x123
CYCLE = 0.01
START_US = 1_600_000_000_000_100


def drive(count: int, seed: int = 4) -> list[Frame]:
    """Frames of several forms on two channels; every tenth has the id of the clock."""
    rng = np.random.default_rng(seed)
    us = START_US + np.cumsum(rng.integers(100, 3000, count))
    frames = []
    for k in range(count):
        fd = k % 7 == 3
        size = int(rng.choice([12, 64] if fd else [1, 5, 8]))
        can_id = (
            CAN_EFF_FLAG | int(rng.integers(1 << 29)) if k % 3 else int(rng.integers(0x200, 0x300))
        )
        channel = "can0" if k % 2 else "vcan10"
        if k % 10 == 0:
            can_id, channel, fd, size = CLOCK, "can0", False, 8
        frames.append(Frame(int(us[k]) / 1e6, can_id, rng.bytes(size), channel, fd))
    return frames


def printed(frame: Frame, stamp: str) -> str:
    """One line as candump (can-utils, lib.c) prints it."""
    extended = frame.can_id >= CAN_EFF_FLAG
    number = f"{frame.can_id - CAN_EFF_FLAG:08X}" if extended else f"{frame.can_id:03X}"
    size = f"[{len(frame.data):02d}]" if frame.fd else f"[{len(frame.data)}]"
    data = " ".join(f"{byte:02X}" for byte in frame.data)
    return f"{stamp}  {frame.channel:>6}  {number:>8}  {size:>4}  {data}"


def absolute(frame: Frame, _: Frame, __: Frame) -> str:
    return f" ({frame.t:.6f})"


def date(frame: Frame, _: Frame, __: Frame) -> str:
    return f" ({datetime.fromtimestamp(round(frame.t * 1e6) / 1e6, UTC):%Y-%m-%d %H:%M:%S.%f})"


def since_start(frame: Frame, _: Frame, first: Frame) -> str:
    return f" ({frame.t - first.t:010.6f})"


def difference(frame: Frame, before: Frame, _: Frame) -> str:
    return f" ({frame.t - before.t:010.6f})"


STAMPS = [absolute, date, since_start, difference]

CHANGES = [(a, b) for pair in product(STAMPS[:2], STAMPS[2:]) for a, b in (pair, pair[::-1])]
"""From a form to one that a line shows to be another."""


def text_of(frames: list[Frame], stamp) -> list[str]:  # type: ignore[no-untyped-def]
    before = [frames[0], *frames]
    return [printed(f, stamp(f, before[k], frames[0])) for k, f in enumerate(frames)]


@pytest.mark.parametrize("stamp", STAMPS)
@pytest.mark.parametrize("tail", ["", "\r", "   '........'"])
def test_common_lines_give_their_frames(tmp_path: Path, stamp, tail: str) -> None:
    frames = drive(6000)  # more than a block of text
    path = tmp_path / "a.txt"
    path.write_text("".join(f"{line}{tail}\n" for line in text_of(frames, stamp)), newline="")
    found = frames_of(*LogReader([path], strict=True))
    assert [f._replace(t=0.0) for f in found] == [f._replace(t=0.0) for f in frames]
    start = frames[0].t - found[0].t
    exact = 0.0 if stamp in (absolute, date) else 6000 * 0.5e-6
    assert np.abs([f.t + start - g.t for f, g in zip(found, frames, strict=True)]).max() <= (
        exact + 1e-6 * (stamp is date)
    )


@pytest.mark.parametrize("count", [400, 6000])
@pytest.mark.parametrize(("first", "second"), CHANGES)
def test_stamps_that_change_their_form_end_the_reading_at_that_line(
    tmp_path: Path, first, second, count: int
) -> None:
    frames = drive(2 * count)
    path = tmp_path / "a.txt"
    lines = text_of(frames[:count], first) + text_of(frames[count:], second)
    path.write_text("".join(f"{line}\n" for line in lines))
    place = rf"a\.txt:{count + 1}: .*time stamps? .*another form"
    with pytest.raises(LogError, match=place):
        list(LogReader([path]))
    with pytest.raises(LogError, match=place):
        list(LogReader([path], strict=True))


@pytest.mark.parametrize(("stamp", "damaged"), [(absolute, " (14365.249713)"),
                                                (difference, " (1436509052.249713)")])  # fmt: skip
def test_a_few_stamps_of_another_form_are_rejected(tmp_path: Path, stamp, damaged: str) -> None:
    frames = drive(600)
    path = tmp_path / "a.txt"
    lines = text_of(frames, stamp)
    for k in (0, 299, 300, 301, 599):
        lines[k] = printed(frames[k], damaged)
    path.write_text("".join(f"{line}\n" for line in lines))
    reader = LogReader([path])
    found = frames_of(*reader)
    assert [f.data for f in found] == [f.data for k, f in enumerate(frames)
                                       if k not in (0, 299, 300, 301, 599)]  # fmt: skip
    assert reader.rejected == {"bad_timestamp": 5}
    assert "another form" in reader.problems[0]
    assert found[-1].t - found[0].t < frames[-1].t - frames[0].t


def test_plain_lines_are_spread_over_the_cycle(tmp_path: Path) -> None:
    frames = drive(18_000)
    path = tmp_path / "a.txt"
    path.write_text("\n".join(text_of(frames, lambda *_: "")))
    found = frames_of(*LogReader([path], cycles=[(IdMatch(CLOCK, 0x7FF), CYCLE)]))
    assert [f._replace(t=0.0) for f in found] == [f._replace(t=0.0) for f in frames]
    times = [f.t for f in found]
    assert times[0] == pytest.approx(CYCLE)  # the first frame is the clock's
    # ten frames a cycle, the last of which is the clock's
    np.testing.assert_allclose(times[1:17_991], CYCLE + np.arange(1, 17_991) * CYCLE / 10)
    assert times[17_991:] == pytest.approx([18.0 + k * CYCLE / 9 for k in range(1, 10)])


def test_only_wanted_frames_are_handed_on_at_the_times_that_all_give(tmp_path: Path) -> None:
    frames = drive(3000)
    path = tmp_path / "a.txt"
    path.write_text("\n".join(text_of(frames, lambda *_: "")))
    cycles = [(IdMatch(CLOCK, 0x7FF), CYCLE)]
    every = frames_of(*LogReader([path], cycles=cycles))
    wanted = IdMatch(CAN_EFF_FLAG, CAN_EFF_FLAG, "vcan10")
    reader = LogReader([path], [wanted], cycles=cycles)
    ours = [f for f in every if f.can_id >= CAN_EFF_FLAG and f.channel == "vcan10"]
    assert 500 < len(ours) < 2500
    assert frames_of(*reader) == ours
    assert reader.frames_read == 3000


WRONG = {
    "a letter in the data": ("bad_hex", lambda s: s[:-1] + "G"),
    "a blank in a byte": ("bad_hex", lambda s: s[:-1] + " "),
    "a digit for a blank": ("bad_hex", lambda s: s[:-3] + "0" + s[-2:]),
    "a byte too few": ("bad_hex", lambda s: s[:-3]),
    "a digit behind the data": ("bad_hex", lambda s: s + "0"),
    "an id beyond 7FF": ("bad_id", lambda s: s.replace(" 123 ", " 823 ")),
    "an id in small letters": ("not_candump", lambda s: s.replace(" 123 ", " 12a ")),
    "nine classic bytes": ("bad_hex", lambda s: s.replace("[8]", "[9]") + " 00"),
    "a day that is none": ("bad_timestamp", lambda s: s.replace("2020-09-13", "2020-09-31")),
    "a letter in the stamp": ("not_candump", lambda s: s.replace("(2", "(O")),
    "no stamp": ("bad_timestamp", lambda s: s.partition(")")[2]),
}


@pytest.mark.parametrize("what", WRONG)
def test_one_wrong_line_among_many_right_ones_is_found(tmp_path: Path, what: str) -> None:
    reason, spoil = WRONG[what]
    frames = [
        Frame(1.6e9 + k / 100, CLOCK, bytes([k % 251] * 8), "can0", False) for k in range(900)
    ]
    lines = text_of(frames, date)
    good = lines[500]
    lines[500] = spoil(good)
    assert lines[500] != good
    path = tmp_path / "a.txt"
    path.write_text("\n".join(lines) + "\n")
    reader = LogReader([path])
    found = frames_of(*reader)
    assert reader.rejected == {reason: 1}
    assert reader.problems[0].startswith(f"{path}:501: ")
    assert [f.data for f in found] == [f.data for k, f in enumerate(frames) if k != 500]
