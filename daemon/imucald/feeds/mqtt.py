"""MQTT: publish status and corrected values as JSON under one topic, with a last will."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imucald.core.errors import ConfigError
from imucald.core.text import json_text
from imucald.feeds.daemon_source import Reading, Say, status_content
from imucald.feeds.feed_loop import FIRST_PAUSE_S, LONGEST_PAUSE_S, next_pause
from imucald.runtime.flow import QUALITIES

PASSWORD = "IMUCALD_MQTT_PASSWORD"
"""Environment variable for the password, because a command line is not secret."""
KEEPALIVE_S = 10
"""Keep-alive time [s]. After 1.5 times this time without data, the broker sends the last will."""
PACKET_MAX = 4
"""Longest packet accepted from a broker [bytes]. Only acknowledgements are expected. Messages that
paho would store (QoS 2) are longer, so they are refused."""
SENT_AHEAD = 1 << 14
"""Largest send buffer in the kernel for a slow broker [bytes]: some seconds of values."""
UNITS = {"acceleration": "m/s2", "angular_rate": "deg/s"}


@dataclass(frozen=True)
class MqttSettings:
    """Settings of the connection. host, port: address of the broker. topic: prefix of all topics.
    ca: path of the CA certificate for TLS."""

    host: str
    port: int
    topic: str
    user: str | None = None
    ca: Path | None = None


class MqttReceiver:
    """Publishes with paho-mqtt. A thread of paho keeps the connection and reconnects."""

    def __init__(self, settings: MqttSettings, say: Say) -> None:
        from paho.mqtt.client import Client  # noqa: PLC0415 - an extra
        from paho.mqtt.enums import CallbackAPIVersion, MQTTErrorCode  # noqa: PLC0415

        class BoundedClient(Client):
            """A client with a limit of the packet length, because paho stores packets of any
            length. Invalid packets, which would end the thread of paho, are ignored."""

            def _sock_recv(self, bufsize: int) -> bytes:
                if bufsize > PACKET_MAX:
                    raise ConnectionError(
                        f"the broker sends a packet of {bufsize} bytes, which is too long"
                    )
                return bytes(super()._sock_recv(bufsize))

            def _packet_handle(self) -> MQTTErrorCode:
                try:
                    return super()._packet_handle()
                except Exception:  # whatever a broker sends
                    return MQTTErrorCode.MQTT_ERR_PROTOCOL

        self._settings = settings
        self._say = say
        self._reported = ""
        self._leaving: dict[str, Any] = {}
        self._pause, self._connected_at = 0.0, time.monotonic()
        client = BoundedClient(CallbackAPIVersion.VERSION2, client_id="")
        client.reconnect_delay_set(int(FIRST_PAUSE_S), int(LONGEST_PAUSE_S))
        client.on_socket_open = _opened
        client.will_set(self._topic("online"), "0", qos=1, retain=True)
        if settings.user is not None:
            client.username_pw_set(settings.user, os.environ.get(PASSWORD))
        if settings.ca is not None:
            try:
                client.tls_set(str(settings.ca))
            except (OSError, ValueError) as error:
                raise ConfigError(
                    f"{settings.ca}: the certificates cannot be used: {error}"
                ) from None
        client.on_connect = self._connected
        client.on_connect_fail = lambda *_: self._report("cannot be reached")
        client.on_disconnect = self._disconnected
        self._client = client

    def connect(self) -> None:
        """Start the connection. The library reconnects after each loss of the connection."""
        settings = self._settings
        self._client.connect_async(settings.host, settings.port, KEEPALIVE_S)
        self._client.loop_start()

    def publish(self, reading: Reading) -> None:
        """Send a reading. Without a connection, the reading is dropped and never sent later."""
        if not self._client.is_connected():
            return
        if reading.is_new:
            self._send("status", status_content(reading.at, reading.status), retain=True)
        for name, values in reading.corrected.items():
            quality = reading.quality.get(name, 0)
            self._send(name, corrected_content(name, values, quality, reading.at))

    def disconnect(self) -> None:
        """Do nothing, because the library reconnects by itself."""

    def close(self) -> None:
        """Publish "offline" and disconnect."""
        if self._client.is_connected():
            last = self._client.publish(self._topic("online"), "0", qos=1, retain=True)
            with suppress(RuntimeError, ValueError):  # the broker goes meanwhile
                last.wait_for_publish(1.0)
        self._client.disconnect()
        self._client.loop_stop()

    def _send(self, name: str, content: Mapping[str, Any], retain: bool = False) -> None:
        self._put(name, json_text(content), 0, retain)

    def _put(self, name: str, text: str, qos: int, retain: bool) -> None:
        """Publish a message, unless the last message of the topic is still waiting. Without this
        limit, paho would store all messages for a slow broker and send them late."""
        if name not in self._leaving or _has_left(self._leaving[name]):
            self._leaving[name] = self._client.publish(self._topic(name), text, qos, retain)

    def _topic(self, name: str) -> str:
        return f"{self._settings.topic}/{name}"

    def _connected(self, _client: Any, _user: Any, _flags: Any, code: Any, _more: Any) -> None:
        if code.is_failure:
            self._report(f"refuses the connection: {code}")
            return
        self._reported = ""
        self._connected_at = time.monotonic()
        self._say(f"{self._broker} takes {self._settings.topic}/#")
        self._put("online", "1", 1, True)

    def _disconnected(self, client: Any, _user: Any, _flags: Any, code: Any, _more: Any) -> None:
        if code.is_failure:
            self._pause = next_pause(self._pause, time.monotonic() - self._connected_at)
            client.reconnect_delay_set(int(self._pause), int(LONGEST_PAUSE_S))
            self._report(f"has closed the connection: {code}")

    @property
    def _broker(self) -> str:
        return f"MQTT broker {self._settings.host}:{self._settings.port}"

    def _report(self, text: str) -> None:
        if text != self._reported:
            self._reported = text
            self._say(f"{self._broker} {text}; trying again")


def _opened(_client: Any, _user: Any, opened: Any) -> None:
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SENT_AHEAD)


def _has_left(message: Any) -> bool:
    try:
        return bool(message.is_published())
    except (RuntimeError, ValueError):  # it is lost with its connection, or was never taken
        return True


def corrected_content(
    name: str, values: tuple[float, float, float] | None, quality: int, at: float
) -> dict[str, Any]:
    """Return the JSON content for the topic of a corrected vector. The values are null if not
    available."""
    x, y, z = (None, None, None) if values is None else (round(v, 4) for v in values)
    shown = QUALITIES[0 if values is None else quality]
    return {"at": round(at, 3), "x": x, "y": y, "z": z, "unit": UNITS[name], "quality": shown}
