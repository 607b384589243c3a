"""A mosquitto of our own, for the tests of the MQTT feed."""

from __future__ import annotations

import contextlib
import shutil
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path

import paho.mqtt.client as paho
from paho.mqtt.enums import CallbackAPIVersion

from feed_bench import wait_until

MOSQUITTO = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin")


class Broker:
    """A mosquitto of our own; `heard` keeps the newest message of each topic."""

    def __init__(self, folder: Path, more: str = "allow_anonymous true\n") -> None:
        with socket.create_server(("127.0.0.1", 0)) as free:
            self.port = free.getsockname()[1]
        self._config = folder / "mosquitto.conf"
        self._config.write_text(f"listener {self.port} 127.0.0.1\nuser root\n{more}")
        self.heard: dict[str, str] = {}
        self.count = 0
        self.start()

    def start(self) -> None:
        command = [str(MOSQUITTO), "-c", str(self._config)]
        self._process = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        wait_until(self._is_open)

    def _is_open(self) -> bool:
        with socket.socket() as probe:
            return probe.connect_ex(("127.0.0.1", self.port)) == 0

    def stop(self) -> None:
        self._process.terminate()
        self._process.wait(5.0)

    @contextlib.contextmanager
    def watched(self, topic: str) -> Iterator[dict[str, str]]:
        """Messages of a topic and all below it, retained ones too."""
        client = paho.Client(CallbackAPIVersion.VERSION2)
        heard: dict[str, str] = {}

        def take(_client: object, _user: object, message: paho.MQTTMessage) -> None:
            heard[message.topic.removeprefix(f"{topic}/")] = message.payload.decode()
            self.count += 1

        client.on_message = take
        client.connect("127.0.0.1", self.port)
        client.subscribe(f"{topic}/#", qos=1)
        client.loop_start()
        try:
            yield heard
        finally:
            client.disconnect()
            client.loop_stop()
