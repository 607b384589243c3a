"""Hands readings on to a receiver; one that is not there is tried again, later and later."""

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
    """The pause [s] after one of `pause` (0: none yet) and a connection that lasted so long.

    One that does not outlast the longest pause is no success: a receiver that takes connections
    and drops them is tried ever more seldom.
    """
    is_first = pause == 0.0 or lasted > LONGEST_PAUSE_S
    return FIRST_PAUSE_S if is_first else min(2.0 * pause, LONGEST_PAUSE_S)


class ReceiverError(ImucaldError):
    """A receiver cannot be reached, or refuses what it is sent: why."""


class Source(Protocol):
    """Gives readings."""

    def read(self, seconds: float) -> Reading:
        """Listen for so long; return what is known then."""
        ...


class Receiver(Protocol):
    """Takes readings. All raise ReceiverError."""

    def connect(self) -> None:
        """Reach it."""
        ...

    def publish(self, reading: Reading) -> None:
        """Hand a reading on."""
        ...

    def disconnect(self) -> None:
        """Let go of it after an error; never raises."""
        ...

    def close(self) -> None:
        """The feed ends: say that nothing is available any more; never raises."""
        ...


class Feed:
    """Reads and publishes until it is stopped; what comes during an outage is not kept.

    period: between two readings [s].
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
        """Loop until `stopping`."""
        try:
            while not self.stopping:
                self.step()
        finally:
            self._receiver.close()

    def step(self) -> None:
        """One reading."""
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
