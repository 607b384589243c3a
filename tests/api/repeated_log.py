"""A log as long as one likes, as an open file: a drive again and again, each later than before.

As a program it writes such a log through `imucald.stream` and prints what memory that took:

    python tests/api/repeated_log.py CONFIG LOG HOURS OUT
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

SECONDS_DIGITS = 10
"""Digits of a candump stamp's whole seconds, in this century."""


class RepeatedLog:
    """Candump text of `count` drives, `every` seconds apart; reads like a file of bytes."""

    def __init__(self, text: bytes, count: int, every: int) -> None:
        self._text = np.frombuffer(text, np.uint8).copy()
        newlines = np.flatnonzero(self._text == ord("\n"))
        self._starts = np.concatenate([[0], newlines[:-1] + 1]) + 1  # behind the bracket
        self._seconds = np.zeros(len(self._starts), np.int64)
        for place in range(SECONDS_DIGITS):
            self._seconds = self._seconds * 10 + self._text[self._starts + place] - ord("0")
        self._left, self._every, self._shift = count, every, 0
        self._rest = memoryview(b"")

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer as far as text is left."""
        if not self._rest and self._left:
            later = self._seconds + self._shift
            for place in reversed(range(SECONDS_DIGITS)):
                later, digit = np.divmod(later, 10)
                self._text[self._starts + place] = digit + ord("0")
            self._shift += self._every
            self._left -= 1
            self._rest = memoryview(self._text).cast("B")
        count = min(len(buffer), len(self._rest))
        memoryview(buffer)[:count] = self._rest[:count]
        self._rest = self._rest[count:]
        return count

    def read(self, size: int) -> bytes:
        """Read up to so many bytes."""
        buffer = bytearray(size)
        return bytes(buffer[: self.readinto(buffer)])


def _peak_mib() -> float:
    """Of this program alone: what getrusage tells holds that of whoever started it, too."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) / 1024 for line in lines if line.startswith("VmHWM"))


def main() -> None:
    """Write, and say what it took."""
    import imucald

    config, log, hours, out = sys.argv[1:]
    text = Path(log).read_bytes()
    seconds = round(float(text.rpartition(b"(")[2][:17]) - float(text[1:18]))
    source = RepeatedLog(text, round(float(hours) * 3600 / seconds), seconds)
    began = time.process_time()
    stream = imucald.stream(imucald.Config.load(config), source)
    files = stream.write(out, ("accel", "gyro", "history", "events"))
    print(
        json.dumps(
            {
                "cpu_s": round(time.process_time() - began, 1),
                "mib": _peak_mib(),
                "duration_s": stream.result.duration_s,
                "files": [[f.name, f.stat().st_size] for f in files],
            }
        )
    )


if __name__ == "__main__":
    main()
