"""MQTT: status and corrected values as JSON under one topic, with a last will."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imucald.core.errors import ConfigError
from imucald.core.text import json_text
from imucald.feeds.daemon_source import Reading, Say
from imucald.feeds.feed_loop import LONGEST_PAUSE_S
from imucald.feeds.status_content import QUALITIES, status_content

PASSWORD = "IMUCALD_MQTT_PASSWORD"
"""Environment variable; a password does not belong on a command line."""
KEEPALIVE_S = 10
"""A connection that is silent for one and a half times this [s] is dead: the will is sent."""
PACKET_MAX = 1 << 16
"""Longest packet taken from a broker [bytes]: only acknowledgements are asked for."""
UNITS = {"acceleration": "m/s2", "angular_rate": "deg/s"}


@dataclass(frozen=True)
class MqttSettings:
    """host, port: of the broker. topic: what all topics begin with. ca: for TLS."""

    host: str
    port: int
    topic: str
    user: str | None = None
    ca: Path | None = None


class MqttReceiver:
    """Publishes with paho-mqtt, whose thread keeps the connection and makes it again."""

    def __init__(self, settings: MqttSettings, say: Say) -> None:
        from paho.mqtt.client import Client  # noqa: PLC0415 - an extra
        from paho.mqtt.enums import CallbackAPIVersion  # noqa: PLC0415

        class BoundedClient(Client):
            """paho holds whatever length a packet announces; nothing long is meant for us."""

            def _sock_recv(self, bufsize: int) -> bytes:
                if bufsize > PACKET_MAX:
                    raise ConnectionError(f"the broker sends a packet of {bufsize} bytes")
                return bytes(super()._sock_recv(bufsize))

        self._settings = settings
        self._say = say
        self._reported = ""
        client = BoundedClient(CallbackAPIVersion.VERSION2, client_id="")
        client.reconnect_delay_set(1, int(LONGEST_PAUSE_S))
        client.will_set(self._topic("online"), "0", qos=1, retain=True)
        if settings.user is not None:
            client.username_pw_set(settings.user, os.environ.get(PASSWORD))
        if settings.ca is not None:
            try:
                client.tls_set(str(settings.ca))
            except (OSError, ValueError) as error:
                raise ConfigError(f"{settings.ca}: no certificates to trust: {error}") from None
        client.on_connect = self._connected
        client.on_connect_fail = lambda *_: self._report("cannot be reached")
        client.on_disconnect = self._disconnected
        self._client = client

    def connect(self) -> None:
        """Have the library connect, and connect again whenever that is lost."""
        settings = self._settings
        self._client.connect_async(settings.host, settings.port, KEEPALIVE_S)
        self._client.loop_start()

    def publish(self, reading: Reading) -> None:
        """Hand a reading on; without a connection it is let go, never sent late."""
        if not self._client.is_connected():
            return
        if reading.is_new:
            self._send("status", status_content(reading), retain=True)
        quality = 0 if reading.status is None else reading.status["quality"]
        for name, values in reading.corrected.items():
            self._send(name, corrected_content(name, values, quality, reading.at))

    def disconnect(self) -> None:
        """Nothing to do: the library goes on by itself."""

    def close(self) -> None:
        """Take leave: offline, by our own word."""
        if self._client.is_connected():
            self._client.publish(self._topic("online"), "0", qos=1, retain=True).wait_for_publish(
                1.0
            )
        self._client.disconnect()
        self._client.loop_stop()

    def _send(self, name: str, content: Mapping[str, Any], retain: bool = False) -> None:
        self._client.publish(self._topic(name), json_text(content), retain=retain)

    def _topic(self, name: str) -> str:
        return f"{self._settings.topic}/{name}"

    def _connected(self, client: Any, _user: Any, _flags: Any, code: Any, _more: Any) -> None:
        if code.is_failure:
            self._report(f"refuses us: {code}")
            return
        self._reported = ""
        self._say(f"{self._broker} takes {self._settings.topic}/#")
        client.publish(self._topic("online"), "1", qos=1, retain=True)

    def _disconnected(self, _c: Any, _user: Any, _flags: Any, code: Any, _more: Any) -> None:
        if code.is_failure:
            self._report(f"is gone: {code}")

    @property
    def _broker(self) -> str:
        return f"MQTT broker {self._settings.host}:{self._settings.port}"

    def _report(self, text: str) -> None:
        if text != self._reported:
            self._reported = text
            self._say(f"{self._broker} {text}; trying again")


def corrected_content(
    name: str, values: tuple[float, float, float] | None, quality: int, at: float
) -> dict[str, Any]:
    """What the topic of a corrected vector carries; null where it is not available."""
    x, y, z = (None, None, None) if values is None else (round(v, 4) for v in values)
    shown = QUALITIES[0 if values is None else quality]
    return {"at": round(at, 3), "x": x, "y": y, "z": z, "unit": UNITS[name], "quality": shown}
