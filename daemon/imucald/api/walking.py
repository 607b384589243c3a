"""`imucald.walk`: the direction of travel of a carried terminal, from a recorded log."""

from __future__ import annotations

import copy
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from imucald.api.columns import Columns, TableColumn, columns_from
from imucald.api.configuration import Configuration, PathLike
from imucald.api.logs import LogSource, opened, pieces
from imucald.api.run import Progress, refuse_empty
from imucald.api.table_access import NamedTables
from imucald.can.logs.log_reader import LogReader
from imucald.config import LoadedConfig
from imucald.core.text import counted
from imucald.inputs.router import Router
from imucald.inputs.wiring import compile_router
from imucald.runtime.consumer import events_of
from imucald.runtime.consumers import TravelConsumer
from imucald.runtime.timebase import TimeBase
from imucald.travel_direction.direction import Step, TravelDirection

_ANGLES = (
    "heading_deg", "compass_deg", "alternative_deg", "published_deg", "tilt_deg",
    "correlation_deg", "deviation_deg",
)  # fmt: skip
STEP_COLUMNS = (
    TableColumn("t_s", "s"),
    *(TableColumn(name, "deg") for name in _ANGLES),
    TableColumn("ahead_probability", "1"),
    TableColumn("ambiguous", "", "bool"),
    TableColumn("chosen", "", "text"),
)


@dataclass(frozen=True, eq=False, repr=False)
class WalkResult(NamedTables):
    """The steps of a walk and their directions. Angles are clockwise from north.

    steps, cadence_hz, method, frames, track: as in `walk --json`, see docs/json.md. problems: the
    first bad lines. tables: one table "steps" with one row per step (`arrow("steps")`,
    `to_pandas("steps")`).
    """

    steps: int
    cadence_hz: float | None
    method: str
    frames: Mapping[str, Any]
    track: Sequence[Mapping[str, Any]]
    problems: tuple[str, ...]
    summary: Mapping[str, Any]
    tables: Mapping[str, Columns]

    def to_dict(self) -> dict[str, Any]:
        """Return a copy of the output of `imucald walk --json`, as plain data."""
        return copy.deepcopy(dict(self.summary))

    def __repr__(self) -> str:
        cadence = "-" if self.cadence_hz is None else f"{self.cadence_hz:.2f} Hz"
        steps = counted(self.steps, "step")
        return f"Walk({steps}, cadence {cadence}, heading by the {self.method} method)"


def walk(
    config: Configuration | PathLike,
    log: LogSource | Sequence[LogSource],
    *,
    progress: Progress | None = None,
    strict: bool = False,
) -> WalkResult:
    """Find the direction of travel of a carried terminal, step by step.

    The result is the same as the result of `imucald walk`. config: a configuration, or the name of
    its file. log: a file's name, an open file, or a list of the pieces of one recording. strict:
    the first bad line raises LogError. Raises ConfigError for a configuration without a compass.
    Raises LogError for a log that cannot be read or contains no CAN frame.
    """
    loaded = Configuration.of(config).loaded
    _need_compass(loaded)
    router = compile_router(loaded)
    travel = TravelDirection(loaded.config.travel_direction)
    sources = [opened(one) for one in pieces(log)]
    reader = LogReader(sources, router.matches, strict, progress)
    steps = list(_steps(reader, router, travel))
    refuse_empty(reader.frames_read, sources)
    rejected = router.rejected + Counter(reader.rejected)
    frames = {
        "read": reader.frames_read,
        "used": router.used,
        "rejected": dict(sorted(rejected.items())),
    }
    track = [_step(step) for step in steps]
    cadence, method = _cadence(steps), travel.settings.method
    summary: dict[str, Any] = {
        "steps": travel.steps,
        "cadence_hz": cadence,
        "method": method,
        "frames": frames,
        "track": track,
    }
    tables = {"steps": _table(track)}
    return WalkResult(**summary, problems=tuple(reader.problems), summary=summary, tables=tables)


def _need_compass(loaded: LoadedConfig) -> None:
    signals = loaded.config.signals
    if signals.magnetometer is None and signals.heading is None:
        raise loaded.error(("signals",), "walk needs a magnetometer or a heading")


def _steps(reader: LogReader, router: Router, travel: TravelDirection) -> Iterator[Step]:
    timebase = TimeBase()
    for chunk in reader:
        for segment in timebase.segments(chunk.t):
            if segment.gap:
                travel.gap()
            part = chunk.take(slice(segment.start, segment.stop))
            samples = router.columns(segment.t, part).samples
            for _, t, channel, values in events_of(samples, TravelConsumer.channels):
                step = travel.sample(t, channel, values)
                if step is not None:
                    yield step


def _cadence(steps: Sequence[Step]) -> float | None:
    times = sorted(step.duration for step in steps)
    return round(1.0 / times[len(times) // 2], 3) if times else None


def _degrees(angle: float | None) -> float | None:
    return None if angle is None else round(math.degrees(angle), 2)


def _step(step: Step) -> dict[str, Any]:
    published = step.published
    found: dict[str, Any] = {
        "t_s": round(step.t, 3),
        "heading_deg": _degrees(step.heading),
        "compass_deg": _degrees(step.compass),
        "alternative_deg": _degrees(step.alternative),
        "published_deg": None,
        "deviation_deg": _degrees(step.deviation),
        "ahead_probability": None if step.ahead is None else round(step.ahead, 4),
        "ambiguous": step.ambiguous,
    }
    if published is not None:
        found.update(
            published_deg=_degrees(published.heading),
            tilt_deg=_degrees(published.tilt_heading),
            correlation_deg=_degrees(published.correlation_heading),
            chosen="tilt" if published.used_tilt else "correlation",
            turn=published.is_turn,
        )
    return found


def _table(track: Sequence[Mapping[str, Any]]) -> Columns:
    def cell(row: Mapping[str, Any], column: TableColumn) -> Any:
        value = row.get(column.name)
        if column.kind == "text":
            return value or ""
        return math.nan if value is None else value

    return columns_from(STEP_COLUMNS, [[cell(row, c) for row in track] for c in STEP_COLUMNS])
