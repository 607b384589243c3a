"""What a feed reads of a daemon, and how it goes on without daemon or receiver."""

from __future__ import annotations

import argparse
import itertools
import signal
import struct

import pytest

from feed_bench import AHEAD, calibrated, source_of, traffic, wait_until
from imucald import cli
from imucald.commands import feed as feed_command
from imucald.commands import status as status_command
from imucald.config import parse_config
from imucald.core.errors import ImucaldError
from imucald.feeds.corrected_frames import STALE_S, CorrectedFrames
from imucald.feeds.daemon_source import Reading
from imucald.feeds.feed_loop import LONGEST_PAUSE_S, Feed, ReceiverError
from imucald.runtime.output.output_frames import OutputFrames

CONFIG = parse_config(
    "database: x.dbc\nsignals: {accelerometer: {x: A.X, y: A.Y, z: A.Z}, "
    "gyroscope: {x: G.X, y: G.Y, z: G.Z}}\n"
).config


def crc(can_id: int, payload: bytes) -> int:
    """CRC-8 SAE J1850 as docs/output-frames.md describes it."""
    value = 0xFF
    for byte in (*can_id.to_bytes(2, "big"), *payload[:7]):
        value ^= byte
        for _ in range(8):
            value = (value << 1 ^ 0x1D if value & 0x80 else value << 1) & 0xFF
    return value ^ 0xFF


def frame(counter: int, x: int = 500, quality: int = 3, y: int = -250) -> bytes:
    head = struct.pack("<3hB", x, y, 4903, counter % 16 << 4 | quality)
    return head + bytes([crc(0x640, head)])


def test_means_are_of_the_good_frames_between_two_looks_in_si():
    frames = CorrectedFrames(CONFIG)
    assert frames.names == ("acceleration", "angular_rate")
    for i, x in enumerate((400, 500, 600)):
        frames.take_frame(0.1 * i, 0x640, frame(i, x))
    means = frames.means(0.3)
    assert means["acceleration"] == pytest.approx((1.0, -0.5, 9.806))
    assert means["angular_rate"] is None
    assert frames.means(0.4)["acceleration"] == pytest.approx((1.0, -0.5, 9.806)), "it stands"
    assert frames.means(0.21 + STALE_S)["acceleration"] is None, "until it is stale"


@pytest.mark.parametrize(
    "bad",
    [
        frame(1)[:7] + bytes([frame(1)[7] ^ 1]),  # checksum
        frame(0),  # counter stands still
        frame(1)[:5],  # short
        frame(1, quality=0, x=-32768),
        frame(1, quality=1),
        frame(1, quality=4),
        frame(1, x=-32768),
    ],
)
def test_a_frame_that_must_not_be_used_is_not(bad):
    frames = CorrectedFrames(CONFIG)
    frames.take_frame(0.0, 0x640, frame(0, 400))
    frames.take_frame(0.01, 0x640, bad)
    assert frames.means(0.02)["acceleration"] == pytest.approx((0.8, -0.5, 9.806))


@pytest.mark.parametrize("ended", [frame(1, quality=0, x=-32768), frame(1, quality=4)])
def test_a_value_does_not_stand_where_its_frame_says_that_it_must_not_be_used(ended):
    frames = CorrectedFrames(CONFIG)
    frames.take_frame(0.0, 0x640, frame(0, 400))
    assert frames.means(0.1)["acceleration"] is not None
    frames.take_frame(0.11, 0x640, ended)
    assert frames.means(0.2)["acceleration"] is None


def test_a_mean_of_frames_before_an_unusable_one_is_given_once():
    frames = CorrectedFrames(CONFIG)
    frames.take_frame(0.0, 0x640, frame(0, 400))
    frames.take_frame(0.01, 0x640, frame(1, quality=4))
    assert frames.means(0.02)["acceleration"] is not None
    assert frames.means(0.03)["acceleration"] is None
    frames.take_frame(0.04, 0x640, frame(2))
    assert frames.means(0.05)["acceleration"] is not None
    assert frames.means(0.06)["acceleration"] is not None, "it stands again"


def test_the_quality_of_a_mean_is_the_lowest_of_its_frames():
    frames = CorrectedFrames(CONFIG)
    for i, quality in enumerate((3, 2, 3)):
        frames.take_frame(0.01 * i, 0x640, frame(i, quality=quality))
    frames.means(0.1)
    assert frames.quality["acceleration"] == 2
    frames.take_frame(0.11, 0x640, frame(3))
    frames.means(0.2)
    assert frames.quality["acceleration"] == 3


def test_restored_counts_only_where_it_is_accepted_and_foreign_ids_never():
    frames = CorrectedFrames(CONFIG, (1, 2, 3))
    frames.take_frame(0.0, 0x640, frame(0, quality=1))
    assert frames.means(0.0)["acceleration"] is not None
    other = CorrectedFrames(CONFIG)
    other.take_frame(0.0, 0x123, frame(0))
    assert other.means(0.0)["acceleration"] is None


def test_values_read_are_values_sent():
    output = OutputFrames(CONFIG)
    can_id, data = output.corrected("gyro", (0.1, -0.2, 0.3), 2)
    x, y, z, quality = output.message_of("gyro").values(data)
    assert (x, y, z) == pytest.approx((5.73, -11.46, 17.19), abs=0.006)
    assert (can_id, quality) == (0x641, 2)
    _, nothing = output.corrected("gyro", None, 0)
    assert output.message_of("gyro").values(nothing) == [None, None, None, 0]


@pytest.mark.slow
def test_a_source_reads_status_and_bus_of_a_running_daemon(tmp_path):
    messages: list[str] = []
    with calibrated(tmp_path) as (_, service):
        source = source_of(service, messages)
        with traffic(service.link.channel) as silent:
            readings: list[Reading] = []
            wait_until(lambda: readings.append(source.read(0.1)) or good(readings[-1]))
            last = readings[-1]
            assert last.corrected["acceleration"] == pytest.approx((AHEAD, 0.0, 9.81), abs=0.15)
            assert last.corrected["angular_rate"] is None
            assert last.status is not None
            assert last.status["state"] in {"usable", "fine"}
            silent.set()
            wait_until(lambda: not good(source.read(0.1)))
            silent.clear()
            wait_until(lambda: good(source.read(0.1)))
    wait_until(lambda: source.read(0.1).status is None)
    assert not good(source.read(STALE_S + 0.1))
    source.close()
    assert "listening on" in messages[0]
    assert "waiting" in messages[-1]


def good(reading: Reading) -> bool:
    return reading.corrected.get("acceleration") is not None


class Script:
    """A source of empty readings and a receiver that fails as told."""

    def __init__(self) -> None:
        self.now, self.fails, self.done = 0.0, True, []

    def clock(self) -> float:
        return self.now

    def read(self, seconds: float) -> Reading:
        self.now += seconds
        return Reading(self.now, None)

    def connect(self) -> None:
        self.done.append(("connect", self.now))
        if self.fails:
            raise ReceiverError("nobody there")

    def publish(self, reading: Reading) -> None:
        if self.fails:
            raise ReceiverError("gone")
        self.done.append(("publish", self.now))

    def disconnect(self) -> None:
        self.done.append(("disconnect", self.now))

    def close(self) -> None:
        self.done.append(("close", self.now))


def test_a_receiver_that_is_not_there_is_tried_again_later_and_later_and_reported_once():
    script, messages = Script(), []
    feed = Feed(script, script, 0.1, messages.append, script.clock)
    while script.now < 600.0:
        feed.publish_once()
    tries = [t for what, t in script.done if what == "connect"]
    pauses = [b - a for a, b in itertools.pairwise(tries)]
    assert pauses[0] < 1.5
    assert all(b > 1.2 * a for a, b in itertools.pairwise(pauses[:5]))
    assert max(pauses) < 1.3 * LONGEST_PAUSE_S
    assert len(messages) == 1
    assert messages[0].startswith("nobody there; trying again")
    script.fails = False
    while script.done[-1][0] != "publish":
        feed.publish_once()
    feed.publish_once()
    assert script.done[-1][0] == "publish"
    script.fails = True
    feed.publish_once()
    assert "gone" in messages[-1]
    feed.stopping = True
    feed.run()
    assert script.done[-1][0] == "close"


@pytest.mark.parametrize(
    ("command", "why"),
    [
        (["feed", "mqtt", "can7", "--rate", "1000"], "--rate must be 0.1 to 100"),
        (["feed", "mqtt", "can7", "--broker", "host:x"], "HOST:PORT"),
        (["feed", "mqtt", "can7", "--topic", "a/#"], "must not contain '#' or '\\+'"),
        (["feed", "mqtt", "can7", "--ca", "/nowhere"], "/nowhere: there is no such file"),
        (["feed", "kuksa", "can7", "--token", "/nowhere"], "/nowhere: there is no such file"),
        (["feed", "mqtt", "--topic", "a/#"], "must not contain '#' or '\\+'"),
    ],
)
def test_a_feed_that_cannot_begin_says_why(command, why, capsys, monkeypatch):
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    assert cli.main(command) == 1
    assert capsys.readouterr().err.replace("+", "\\+").count(why) == 1


@pytest.mark.parametrize(("channel", "topic"), [("239.74.163.2", "239.74.163.2"), (None, "can7")])
def test_topics_have_the_channel_that_was_asked_for(channel, topic, tmp_path, monkeypatch):
    begun = []

    def received(_: argparse.Namespace, bus: str) -> None:
        begun.append(bus)
        if len(begun) == 2:
            raise ImucaldError("enough")

    monkeypatch.setattr(feed_command, "_socket", lambda *_: tmp_path / "imucald-can7.sock")
    monkeypatch.setattr(feed_command, "_receiver", received)
    assert cli.main(["feed", "mqtt", *([channel] if channel else []), "--broker", "x:1"]) == 1
    assert begun[-1] == topic


@pytest.mark.parametrize("target", ["mqtt", "foxglove", "kuksa"])
def test_a_feed_without_a_channel_waits_for_a_daemon(target, tmp_path, monkeypatch, capsys):
    path, slept, begun = tmp_path / "imucald-can7.sock", [], []

    def received(_: argparse.Namespace, bus: str) -> None:
        begun.append(bus)
        if slept:
            raise ImucaldError("enough")

    found = lambda *_: [path] if len(slept) > 2 else []  # noqa: E731
    monkeypatch.setattr(status_command, "running_sockets", found)
    monkeypatch.setattr(feed_command.time, "sleep", slept.append)
    monkeypatch.setattr(feed_command, "_receiver", received)
    assert cli.main(["feed", target]) == 1
    assert slept == [1.0] * 3
    assert begun[-1] == "can7"
    assert capsys.readouterr().err.count("no running daemon found; waiting for one") == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_feed_that_waits_for_a_daemon_ends_at_a_signal(number, monkeypatch):
    monkeypatch.setattr(status_command, "running_sockets", lambda *_: [])
    monkeypatch.setattr(feed_command.time, "sleep", lambda _: signal.raise_signal(number))
    before = {one: signal.getsignal(one) for one in (signal.SIGINT, signal.SIGTERM)}
    try:
        assert cli.main(["feed", "mqtt"]) == 0
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)


def test_a_receiver_that_takes_one_reading_and_goes_is_tried_later_and_later():
    script = Script()
    feed = Feed(script, script, 0.1, lambda _: None, script.clock)
    while script.now < 600.0:
        script.fails = script.done[-1:] != [] and script.done[-1][0] == "publish"
        feed.publish_once()
    assert sum(what == "connect" for what, _ in script.done) < 20
