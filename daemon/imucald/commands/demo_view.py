"""The display of `imucald demo` during the drive: a live picture on a terminal, else lines of
text."""

from __future__ import annotations

import math
import time
from typing import Any, Self

from rich.live import Live

from imucald.commands.demo_drive import Angle, Demonstration, angles_beside
from imucald.commands.demo_picture import Picture
from imucald.commands.terminal import plain_console
from imucald.core.angles import DEG_PER_RAD
from imucald.core.text import clock
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import (
    plus_minus,
    reasons,
)

FASTEST = 24.0
"""Fastest speed on a terminal, as a multiple of real time, so that the user can follow."""
FRAME_S = 0.1
"""Period of drawing the picture [s of real time]."""
LINE_S = 15.0
"""Period of plain lines [s of driving]."""


class PlainView:
    """Prints a line from time to time."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._next = LINE_S

    def __enter__(self) -> Self:
        print(f"A simulated drive (seed {self._seed}) on a virtual CAN bus, imucald listening.")
        print(
            "   time  state             roll 95 %        pitch 95 %          yaw 95 %  waiting for"
        )
        return self

    def __exit__(self, *_: object) -> None:
        """Do nothing, because nothing is open."""

    def show(self, demo: Demonstration) -> None:
        """Print a line when one is due."""
        if demo.now < self._next:
            return
        self._next += LINE_S
        estimate = demo.estimate()
        found = {a.name: a for a in angles_beside(estimate, demo.truth)}
        cells = "".join(f"{_with_interval(found.get(name)):>18}" for name in ANGLES)
        waiting = next((text for _, text in reasons(estimate.waiting_for)), "")
        state = estimate.state.name.lower()
        print(f"{clock(demo.now):>7}  {state:<9}{cells}  {waiting}".rstrip(), flush=True)


class LiveView:
    """Shows a live picture."""

    def __init__(self, seed: int) -> None:
        self._live = Live(console=plain_console(), auto_refresh=False, transient=True)
        self._picture = Picture()
        self._began = time.monotonic()
        self._drawn = -math.inf

    def __enter__(self) -> Self:
        self._live.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._live.__exit__(*error)

    def show(self, demo: Demonstration) -> None:
        """Draw the picture when it is due."""
        self._picture.note(demo)
        now = time.monotonic()
        ahead = demo.now / FASTEST - (now - self._began)
        if ahead > 0.0:
            time.sleep(ahead)
        if now - self._drawn >= FRAME_S or demo.now >= demo.drive.duration_s:
            self._drawn = now
            self._live.update(self._picture.draw(demo), refresh=True)


def _with_interval(angle: Angle | None) -> str:
    if angle is None:
        return "-"
    return f"{angle.estimate * DEG_PER_RAD:+.2f} {plus_minus(angle.std * DEG_PER_RAD, unit='')}"
