"""The Foxglove feed, read by a client of its protocol that is not its server's."""

from __future__ import annotations

import asyncio
import json
import math
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from feed_bench import AHEAD, calibrated, fed, traffic, wait_until
from imucald import cli
from imucald.config import parse_config
from imucald.feeds.corrected_frames import STALE_S, CorrectedFrames
from imucald.feeds.daemon_source import DaemonSource, Reading
from imucald.feeds.feed_loop import Feed, ReceiverError
from imucald.feeds.foxglove import FoxgloveReceiver, FoxgloveSettings, contents, transforms

pytest.importorskip("foxglove")
jsonschema = pytest.importorskip("jsonschema")
bridge = pytest.importorskip("robo_ws_bridge")
pool = pytest.importorskip("google.protobuf.descriptor_pool")


class Client:
    """Subscribes to all that is advertised; the newest message of each topic."""

    def __init__(self, port: int) -> None:
        self.channels: dict[str, dict] = {}
        self.messages: dict[str, dict] = {}
        self.frames: dict[str, dict] = {}
        self._port = port
        self._ended = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._listen()))

    async def _listen(self) -> None:
        client = bridge.WebSocketBridgeClient(f"ws://127.0.0.1:{self._port}")
        client.on_message(self._take)
        await client.connect()
        while not self._ended.is_set():
            for channel in client.channels.values():
                if channel["topic"] not in self.channels:
                    self.channels[channel["topic"]] = channel
                    await client.subscribe(channel["topic"])
            await asyncio.sleep(0.02)
        await client.disconnect()

    def _take(self, channel: dict, stamp: int, data: bytes) -> None:
        if channel["encoding"] == "json":
            content = json.loads(data)
            jsonschema.validate(content, json.loads(channel["schema"]))
        else:
            content = transform_of(channel, data)
            self.frames[content["child_frame_id"]] = content
        self.messages[channel["topic"]] = {**content, "stamp": stamp}

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._ended.set()
        self._thread.join(10.0)


def transform_of(channel: dict, data: bytes) -> dict:
    """Decode protobuf by the descriptors that were advertised with the channel."""
    import base64

    from google.protobuf import descriptor_pb2, json_format, message_factory

    files = descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"]))
    own = pool.DescriptorPool()
    for file in files.file:
        own.Add(file)
    kind = message_factory.GetMessageClass(own.FindMessageTypeByName(channel["schemaName"]))
    found = json_format.MessageToDict(kind.FromString(data), preserving_proto_field_name=True)
    assert channel["schemaName"] == "foxglove.FrameTransform"
    return found


@contextmanager
def listening(port: int) -> Iterator[Client]:
    client = Client(port)
    client.start()
    try:
        yield client
    finally:
        client.stop()


@pytest.mark.slow
def test_a_client_sees_corrected_and_raw_imu_mount_and_status(tmp_path):
    said: list[str] = []
    with calibrated(tmp_path) as (_, service), traffic(service.link.channel) as silent:
        receiver = FoxgloveReceiver(FoxgloveSettings("127.0.0.1", 0), said.append)
        source = DaemonSource(service.options.status_socket, said.append, wants_raw=True)
        with fed(Feed(source, receiver, 0.05, said.append)):
            wait_until(lambda: any("open ws://" in text for text in said))
            with listening(receiver.port) as client:
                seen = client.messages
                wait_until(lambda: {"/imu/data", "/imu/data_raw", "/mount", "/status"} <= set(seen))
                wait_until(lambda: seen["/imu/data"]["linear_acceleration"]["x"] is not None)
                corrected = seen["/imu/data"]["linear_acceleration"]
                assert list(corrected.values()) == pytest.approx([AHEAD, 0.0, 9.81], abs=0.15)
                raw = seen["/imu/data_raw"]
                cos, sin = math.cos(math.radians(25.0)), math.sin(math.radians(25.0))
                expected = [AHEAD * cos, -AHEAD * sin, 9.81]
                assert list(raw["linear_acceleration"].values()) == pytest.approx(expected, abs=0.1)
                assert raw["frame_id"] == "sensor"
                assert raw["angular_velocity"]["x"] is None
                truth = service.status()["mount"]
                assert seen["/mount"]["yaw_deg"] == pytest.approx(truth["yaw_deg"], abs=0.01)
                assert seen["/mount"]["yaw_deg"] == pytest.approx(25.0, abs=3.0)
                assert seen["/status"]["running"]
                wait_until(lambda: "sensor" in client.frames)
                turn = client.frames["sensor"]
                assert turn["parent_frame_id"] == "vehicle"
                yaw = 2.0 * math.atan2(turn["rotation"]["z"], turn["rotation"]["w"])
                assert math.degrees(yaw) == pytest.approx(truth["yaw_deg"], abs=0.5)
                assert abs(seen["/status"]["at"] * 1e9 - seen["/status"]["stamp"]) < 1e7
                silent.set()
                wait_until(lambda: seen["/imu/data"]["linear_acceleration"]["x"] is None)
                wait_until(lambda: seen["/imu/data_raw"]["linear_acceleration"]["x"] is None)
                silent.clear()
            with listening(receiver.port) as again:  # one that comes later gets the same
                wait_until(lambda: "/imu/data" in again.messages)
            service.stop()
            service.sockets.status.path.unlink()
            with listening(receiver.port) as after:
                wait_until(lambda: after.messages.get("/status", {}).get("running") is False)


def test_attitude_is_the_newest_in_the_frames_and_turns_the_vehicle_in_level_axes():
    config = parse_config(
        "database: x.dbc\nsignals: {accelerometer: {x: A.X, y: A.Y, z: A.Z}, "
        "gyroscope: {x: G.X, y: G.Y, z: G.Z}}\nattitude: {enabled: true}\n"
    ).config
    frames = CorrectedFrames(config)
    assert frames.attitude(0.0) is None
    payload = struct.pack("<hhHB", 500, -300, 9000, 3)
    value = 0xFF
    for byte in (0x06, 0x46, *payload):
        value ^= byte
        for _ in range(8):
            value = (value << 1 ^ 0x1D if value & 0x80 else value << 1) & 0xFF
    frames.take_frame(0.0, 0x646, payload + bytes([value ^ 0xFF]))
    assert frames.attitude(0.1) == pytest.approx((5.0, -3.0, 90.0))
    assert frames.attitude(0.1 + STALE_S) is None
    reading = Reading(0.0, None, False, attitude=(0.0, 0.0, 90.0))
    w, x, y, z = transforms(reading)["level", "vehicle"]
    half = math.sqrt(0.5)
    assert (w, x, y, z) == pytest.approx((half, 0.0, 0.0, -half)), "heading is clockwise"
    assert contents(reading) == {
        "/attitude": {"roll_deg": 0.0, "pitch_deg": 0.0, "heading_deg": 90.0}
    }


def test_an_address_that_is_taken_is_said_and_tried_again():
    first = FoxgloveReceiver(FoxgloveSettings("127.0.0.1", 0), lambda _: None)
    first.connect()
    second = FoxgloveReceiver(FoxgloveSettings("127.0.0.1", first.port), lambda _: None)
    with pytest.raises(ReceiverError, match="cannot listen on 127"):
        second.connect()
    second.close()
    first.close()


def test_the_command_asks_for_its_extra(monkeypatch, capsys):
    from imucald.commands import feed

    monkeypatch.setitem(feed.LIBRARIES, "foxglove", "no_such_library")
    assert cli.main(["feed", "foxglove", "--socket", "/nowhere"]) == 1
    assert "'.[foxglove]'" in capsys.readouterr().err
