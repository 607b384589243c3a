"""Status for people and programs: asked for over a Unix socket, answered by the loop itself.

A client connects, sends one line and reads until the end: ``status`` gives JSON, ``events`` the
last events as JSON, ``history`` (or ``history SINCE``) the last half hour, ``metrics`` Prometheus
text, and ``GET /metrics HTTP/1.1`` the same as a web server would.

The last half hour is kept for a page that is opened later: a row each two seconds, as JSON of about
200 bytes, so that it takes 200 kB and an answer is made by joining rows.
"""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from imucald.core.angles import DEG_PER_RAD
from imucald.core.text import json_text
from imucald.motion.ticks import ACCEL, GYRO, SPEED, TICK_RATE
from imucald.mount.estimate import ANGLES
from imucald.mount.mount_words import half_width
from imucald.runtime.engine import Engine
from imucald.runtime.summary import plain
from imucald.service.background_writer import Say
from imucald.service.line_server import LineServer, nobody_listens
from imucald.service.metrics import metrics_text

RUNNING = Path("/run/imucald")
"""Holds a folder for each daemon of systemd or root."""
READABLE_BY_ALL = 0o666
"""It answers questions and takes no orders."""


def default_socket(channel: str, environment: Mapping[str, str] | None = None) -> Path | None:
    """Where the status socket is, or None where there is no folder for it.

    Root has one where its environment names none, as in a container, under sudo or cron.
    """
    environment = os.environ if environment is None else environment
    if folder := environment.get("RUNTIME_DIRECTORY", "").partition(":")[0]:
        return Path(folder) / "status.sock"
    if folder := environment.get("XDG_RUNTIME_DIR", ""):
        return Path(folder) / f"imucald-{_in_one_name(channel)}.sock"
    return running_socket(channel) if os.geteuid() == 0 else None


def running_socket(channel: str) -> Path:
    """The status socket of systemd's or root's daemon of a channel."""
    return RUNNING / _in_one_name(channel) / "status.sock"


def _in_one_name(channel: str) -> str:
    """A channel such as /dev/ttyACM0 without what would name other folders."""
    return channel.strip("/.").replace("/", "-")


class StatusServer(LineServer):
    """Answers on a Unix socket that everybody may read.

    status: makes the status when somebody asks; events: the last events; history: the last half
    hour after a time of day, as JSON. say: see `LineServer`.
    Raises LinkError when the socket cannot be made.
    """

    def __init__(
        self,
        path: Path,
        status: Callable[[], Mapping[str, Any]],
        clock: Callable[[], float] = time.monotonic,
        events: Callable[[], Sequence[Mapping[str, Any]]] = list,
        history: Callable[[float], str] = lambda since: "{}\n",  # noqa: ARG005
        say: Say = nobody_listens,
    ) -> None:
        super().__init__(path, READABLE_BY_ALL, lambda line, _: self._answer(line), clock, say=say)
        self._status = status
        self._events = events
        self._history = history

    def _answer(self, request: bytes) -> bytes:
        line = request.strip().decode("ascii", "replace")
        if line == "status":
            return status_json(self._status()).encode()
        if line == "events":
            return status_json({"events": list(self._events())}).encode()
        if line.partition(" ")[0] == "history":
            return self._history(since(line.partition(" ")[2])).encode()
        if line == "metrics":
            return metrics_text(self._status()).encode()
        if line.startswith("GET "):
            if line.split()[1:2] == ["/metrics"]:
                return _http("200 OK", metrics_text(self._status()).encode())
            return _http("404 Not Found", b"only /metrics is here\n")
        return b"error: ask for status, events, history or metrics\n"


def status_json(status: Mapping[str, Any]) -> str:
    """One JSON object on one line."""
    return json_text(status) + "\n"


def _http(code: str, body: bytes) -> bytes:
    kind = "text/plain; version=0.0.4; charset=utf-8"
    head = f"HTTP/1.1 {code}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
    return f"{head}Connection: close\r\n\r\n".encode() + body


PERIOD_S = 2.0
KEPT = 900
"""Half an hour."""
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
"""Wall clock [s]; state; kind of flow; mount, with half of its 95 % intervals; means over the
period of the force in sensor axes (less what a model file takes out) and as corrected, of the
change of speed, and of speed times corrected turn rate."""


class RecentHistory:
    """Gathers ticks into rows. wall: the time of day [s]."""

    def __init__(self, wall: Callable[[], float] = time.time) -> None:
        self._wall = wall
        self._rows: deque[tuple[float, str]] = deque(maxlen=KEPT)
        self._ticks: list[list[float]] = []
        self._k = -1
        self._ended: tuple[int, float] | None = None  # tick and speed [m/s] of the last row's end

    def tick(self, engine: Engine) -> None:
        """Take the tick that was closed last, unless it was taken already."""
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
        """Make a row of the ticks since the last one; flow: see `runtime.flow`."""
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
        """Forces, dv/dt and speed times turn rate of the ticks; NaN where not known."""
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
        """Rows after a time of day [s], oldest first, with the names of the columns."""
        rows = ",".join(text for at, text in self._rows if at > since)
        return f'{{"period_s":{PERIOD_S},"columns":{json_text(COLUMNS)},"rows":[{rows}]}}\n'


def since(text: str) -> float:
    """A time of day [s]; before all times where it is none."""
    try:
        return float(text)
    except ValueError:
        return -math.inf
