"""Security access (service 0x27): seed, key, wrong keys, and the delay after wrong keys."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Callable

from imucald.uds.codes import Answer, Nrc

REQUEST_SEED = 0x01
SEND_KEY = 0x02
SEED_BYTES = 16
"""Length of the seed [bytes]: one AES block, for key functions that encrypt the seed."""

KeyFunction = Callable[[bytes], bytes]
"""Function that computes the key from the seed. The function runs in the daemon's loop, so it must
be fast and must not block."""


class Security:
    """The lock of the server. The lock opens if a tester sends the correct key for a seed.

    key_function: None refuses every tester. random: returns the given number of random bytes.
    attempts: number of wrong keys before the delay. delay: [s]. clock: monotonic [s]. wrong: number
    of consecutive wrong keys at the last shutdown. If it is not 0, the first key is accepted only
    after the delay (ISO 14229-1). on_count: called when this number changes. Wrong keys are counted
    over all sessions, so a new session gives no additional attempts.
    """

    def __init__(
        self,
        key_function: KeyFunction | None,
        clock: Callable[[], float],
        random: Callable[[int], bytes] = secrets.token_bytes,
        attempts: int = 3,
        delay: float = 10.0,
        wrong: int = 0,
        on_count: Callable[[int], None] = lambda _: None,
    ) -> None:
        self.unlocked = False
        self.refused = 0
        """Number of wrong keys and of requests during the delay."""
        self._key_function = key_function
        self._random = random
        self._clock = clock
        self._attempts = attempts
        self._delay = delay
        self._on_count = on_count
        self._wrong = min(wrong, attempts - 1)
        self._closed_until = clock() + delay if wrong else float("-inf")
        self._seed: bytes | None = None

    def lock(self) -> None:
        """Lock the server again."""
        self.unlocked = False
        self._seed = None

    def answer(self, data: bytes) -> Answer:
        """Answer a request; data: the bytes from the sub-function on."""
        if data[0] == REQUEST_SEED:
            return self._give_seed(data)
        return self._take_key(data[1:])

    def _give_seed(self, data: bytes) -> Answer:
        if len(data) != 1:
            return Nrc.INCORRECT_LENGTH
        if self._key_function is None:
            return Nrc.CONDITIONS_NOT_CORRECT
        if self._is_closed():
            return Nrc.DELAY_NOT_EXPIRED
        if self.unlocked:
            return bytes([REQUEST_SEED]) + bytes(SEED_BYTES)  # zeros: nothing to unlock
        self._seed = self._random(SEED_BYTES)
        return bytes([REQUEST_SEED]) + self._seed

    def _take_key(self, key: bytes) -> Answer:
        if not 1 <= len(key) <= 64:
            return Nrc.INCORRECT_LENGTH
        if self._is_closed():
            return Nrc.DELAY_NOT_EXPIRED
        seed, self._seed = self._seed, None  # a seed is good for one key
        if seed is None:
            return Nrc.REQUEST_SEQUENCE_ERROR
        expected = self._expected(seed)
        if expected and hmac.compare_digest(expected, key):
            self.unlocked = True
            if self._wrong:
                self._wrong = 0
                self._on_count(0)
            return bytes([SEND_KEY])
        return self._wrong_key()

    def _expected(self, seed: bytes) -> bytes:
        """Return the correct key for a seed. If the key function fails, the result is empty and
        every key is refused."""
        if self._key_function is None:
            return b""
        try:
            key = self._key_function(seed)
            # of a number n, bytes() makes n zeros: a key that anybody can send
            return bytes(key) if isinstance(key, bytes | bytearray) else b""
        except Exception:  # somebody else's code, fed by anybody on the bus: it must not end us
            return b""

    def _wrong_key(self) -> Nrc:
        self.refused += 1
        self._wrong += 1
        self._on_count(self._wrong)
        if self._wrong < self._attempts:
            return Nrc.INVALID_KEY
        self._wrong = self._attempts - 1  # after the delay: one more attempt, then closed again
        self._closed_until = self._clock() + self._delay
        return Nrc.EXCEEDED_ATTEMPTS

    def _is_closed(self) -> bool:
        closed = self._clock() < self._closed_until
        self.refused += closed
        return closed
