"""A feed as a process of its own beside the daemon, both on a kernel's CAN."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from test_service_vcan import Node, running

from feed_bench import wait_until
from mqtt_broker import MOSQUITTO, Broker

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(MOSQUITTO is None, reason="not installed: mosquitto (Debian's package)"),
]


def test_corrected_frames_of_a_daemon_reach_a_broker_and_stop_with_the_sensor(vcan, tmp_path: Path):
    folder = tmp_path / "mosquitto"
    folder.mkdir()
    broker = Broker(folder)
    try:
        with running(tmp_path, vcan.name) as daemon, broker.watched("car") as heard:
            command = [sys.executable, "-m", "imucald", "feed", "mqtt", "--topic", "car"]
            command += ["--broker", f"127.0.0.1:{broker.port}", "--accept", "restored"]
            feed = subprocess.Popen([*command, "--socket", str(daemon.socket)])
            node = Node(vcan.name)
            try:
                wait_until(lambda: "acceleration" in heard and value(heard) is not None, 30.0)
                assert json.loads(heard["acceleration"])["quality"] == "restored"
                assert daemon.status()["state"] == "restored"
                node.stop()
                wait_until(lambda: value(heard) is None)
            finally:
                node.stop()
                feed.terminate()
                assert feed.wait(10.0) == 0
            wait_until(lambda: heard["online"] == "0")
    finally:
        broker.stop()


def value(heard: dict[str, str]) -> float | None:
    found: float | None = json.loads(heard["acceleration"])["x"]
    return found
