"""Send readings to a receiver. If the receiver is not available, try again with increasing
pauses."""

from __future__ import annotations

import random
import time
from collections.abc import Callable
from typing import Protocol

from imucald.core.errors import ImucaldError
from imucald.feeds.daemon_source import Reading, Say

FIRST_PAUSE_S = 1.0
LONGEST_PAUSE_S = 60.0


def next_pause(pause: float, lasted: float) -> float:
    """Return the pause before the next attempt to connect [s]. pause: the last pause (0: none).
    lasted: duration of the last connection [s].

    A connection shorter than the longest pause does not count as success. Therefore the pauses also
    increase for a receiver that accepts connections and closes them again.
    """
    is_first = pause == 0.0 or lasted > LONGEST_PAUSE_S
    return FIRST_PAUSE_S if is_first else min(2.0 * pause, LONGEST_PAUSE_S)


class ReceiverError(ImucaldError):
    """The reason why a receiver cannot be reached or refuses data."""


class Source(Protocol):
    """A source of readings."""

    def read(self, seconds: float) -> Reading:
        """Listen for `seconds` [s], then return the present reading."""
        ...


class Receiver(Protocol):
    """Interface of a receiver of readings. `connect` and `publish` raise ReceiverError."""

    def connect(self) -> None:
        """Connect to the receiver."""
        ...

    def publish(self, reading: Reading) -> None:
        """Send a reading."""
        ...

    def disconnect(self) -> None:
        """Disconnect after an error. The call never raises an error."""
        ...

    def close(self) -> None:
        """End the feed: report to the receiver that no value is available any more. The call never
        raises an error."""
        ...


class Feed:
    """Reads and publishes readings until the feed is stopped. Readings during an outage are not
    stored.

    period: time between two readings [s].
    """

    def __init__(
        self,
        source: Source,
        receiver: Receiver,
        period: float,
        say: Say,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._source, self._receiver = source, receiver
        self._period = period
        self._say = say
        self._clock = clock
        self._is_connected = False
        self._pause = 0.0
        self._next_try = self._connected_at = clock()
        self._last_error = ""
        self.stopping = False

    def run(self) -> None:
        """Run until `stopping`."""
        try:
            while not self.stopping:
                self.publish_once()
        finally:
            self._receiver.close()

    def publish_once(self) -> None:
        """Read and publish one reading."""
        reading = self._source.read(self._period)
        if not self._is_connected and self._clock() < self._next_try:
            return
        try:
            if not self._is_connected:
                self._receiver.connect()
                self._is_connected, self._connected_at = True, self._clock()
            self._receiver.publish(reading)
            self._last_error = ""
        except ReceiverError as error:
            self._failed(str(error))

    def _failed(self, text: str) -> None:
        self._receiver.disconnect()
        lasted = self._clock() - self._connected_at if self._is_connected else 0.0
        self._is_connected = False
        self._pause = next_pause(self._pause, lasted)
        many = random.uniform(0.8, 1.2)  # many vehicles, one receiver
        self._next_try = self._clock() + many * self._pause
        if text != self._last_error:
            self._last_error = text
            self._say(f"{text}; trying again, with pauses of up to {LONGEST_PAUSE_S:g} s")
