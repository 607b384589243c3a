"""Send readings to a receiver. If it is absent, retry with increasing pauses."""

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
    """Return the next pause [s]. pause: the last pause (0: none). lasted: time connected [s].

    A connection shorter than the longest pause does not count as success. Therefore the pauses
    increase for a receiver that accepts connections and drops them.
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
    """A receiver of readings. The methods of a receiver raise ReceiverError."""

    def connect(self) -> None:
        """Connect to the receiver."""
        ...

    def publish(self, reading: Reading) -> None:
        """Send a reading."""
        ...

    def disconnect(self) -> None:
        """Disconnect after an error; never raises."""
        ...

    def close(self) -> None:
        """End the feed: report that no value is available any more; never raises."""
        ...


class Feed:
    """Reads and publishes until it is stopped. Readings during an outage are not stored.

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
        """Process one reading."""
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
