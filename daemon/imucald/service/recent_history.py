"""The values of the last half hour of a daemon, stored for a page that is opened later.

Every two seconds, a row of about 200 bytes of JSON is stored. The history needs 200 kB. An answer
only joins the rows.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable

import numpy as np

from imucald.core.angles import DEG_PER_RAD
from imucald.core.text import json_text
from imucald.motion.ticks import ACCEL, GYRO, SPEED, TICK_RATE
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import half_width
from imucald.runtime.engine import Engine
from imucald.runtime.summary import plain

PERIOD_S = 2.0
KEPT = 900
"""Largest number of rows: half an hour."""
NOTHING = [math.nan] * 3
COLUMNS = (
    "at",
    "state",
    "flow",
    *(f"{angle}_deg" for angle in ANGLES),
    *(f"{angle}_half_deg" for angle in ANGLES),
    *(f"raw_{axis}_mps2" for axis in "xyz"),
    *(f"corrected_{axis}_mps2" for axis in "xyz"),
    "dvdt_mps2",
    "turn_mps2",
)
"""Columns: wall clock [s]; state; kind of flow; angles of the mount; half of the 95 % interval of
each angle; means over the period.

The means are specific force in sensor axes (without the effects that a model file removes),
corrected specific force, change of speed, and speed times corrected turn rate.
"""


class RecentHistory:
    """Collects ticks in rows. wall: function that returns the time of day [s]."""

    def __init__(self, wall: Callable[[], float] = time.time) -> None:
        self._wall = wall
        self._rows: deque[tuple[float, str]] = deque(maxlen=KEPT)
        self._ticks: list[list[float]] = []
        self._k = -1
        self._ended: tuple[int, float] | None = None  # tick and speed [m/s] of the last row's end

    def tick(self, engine: Engine) -> None:
        """Add the last complete tick, unless it was already added."""
        pipeline = engine.pipeline
        row = pipeline.closed
        if row is None or pipeline.k == self._k:
            return
        self._k = pipeline.k
        raw = list(row[ACCEL.x : ACCEL.z + 1]) if row[ACCEL.n] else NOTHING
        correction = pipeline.correction
        force, rate = NOTHING, NOTHING
        if correction is not None and row[ACCEL.n]:
            force = list(correction.applied("accel", raw))
        if correction is not None and row[GYRO.n]:
            rate = list(correction.applied("gyro", row[GYRO.x : GYRO.z + 1]))
        speed = row[SPEED.mean] if row[SPEED.n] else math.nan
        self._ticks.append([*raw, *force, speed, rate[2]])

    def end_row(self, engine: Engine, flow: str) -> None:
        """Store a row with the means of all ticks since the last row. flow: see `runtime.flow`."""
        estimate = engine.pipeline.estimator.estimate()
        angles = estimate.angles or NOTHING
        std = estimate.angle_std or NOTHING
        known = [half_width(s * DEG_PER_RAD) for s in std]
        now = round(self._wall(), 3)
        row = [
            *(
                None if half is None else a * DEG_PER_RAD
                for a, half in zip(angles, known, strict=True)
            ),
            *known,
            *self._means(),
        ]
        head = [now, estimate.state.name.lower(), flow]
        self._rows.append((now, json_text(head + plain(row, 4))))
        self._ticks.clear()

    def _means(self) -> list[float]:
        """Return the means of forces, dv/dt and speed times turn rate over the ticks; NaN if not
        known."""
        if not self._ticks:
            self._ended = None
            return [math.nan] * 8
        ticks = np.array(self._ticks)
        known = np.isfinite(ticks)
        sums = np.where(known, ticks, 0.0).sum(axis=0)
        means = np.divide(sums, known.sum(axis=0), where=known.any(axis=0), out=np.full(8, np.nan))
        speeds = np.flatnonzero(known[:, 6])
        dvdt = math.nan
        if len(speeds):
            last = self._k - len(ticks) + int(speeds[-1]), float(ticks[speeds[-1], 6])
            if self._ended is not None and last[0] > self._ended[0]:
                dvdt = (last[1] - self._ended[1]) * TICK_RATE / (last[0] - self._ended[0])
            self._ended = last
        return [*means[:6].tolist(), dvdt, float(means[6] * means[7])]

    def as_json(self, since: float = -math.inf) -> str:
        """Return the rows after the time of day `since` [s], oldest first, with the names of the
        columns."""
        rows = ",".join(text for at, text in self._rows if at > since)
        return f'{{"period_s":{PERIOD_S},"columns":{json_text(COLUMNS)},"rows":[{rows}]}}\n'
