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
        self._pause = FIRST_PAUSE_S
        self._next_try = clock()
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
                self._is_connected = True
            self._receiver.publish(reading)
            self._pause, self._last_error = FIRST_PAUSE_S, ""
        except ReceiverError as error:
            self._failed(str(error))

    def _failed(self, text: str) -> None:
        self._receiver.disconnect()
        self._is_connected = False
        pause = self._pause * random.uniform(0.8, 1.2)  # many vehicles, one receiver
        self._next_try = self._clock() + pause
        self._pause = min(2.0 * self._pause, LONGEST_PAUSE_S)
        if text != self._last_error:
            self._last_error = text
            self._say(f"{text}; trying again, at last every {LONGEST_PAUSE_S:g} s")
