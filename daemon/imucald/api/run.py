"""A replay of logs through an engine, as a whole or in parts. The command line uses this module
too."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TypeVar

import numpy as np

from imucald.api.columns import (
    EVENT_COLUMNS,
    EVENTS,
    HISTORY,
    HISTORY_COLUMNS,
    RAW,
    Columns,
    TableColumn,
    corrected_columns,
    no_rows,
    raw_columns,
)
from imucald.api.configuration import Configuration
from imucald.api.drive import DriveResult, drive_result
from imucald.api.logs import LogSource, opened
from imucald.api.mount import MountResult
from imucald.api.recorder import Recorder, microseconds
from imucald.can.logs.log_reader import LogReader
from imucald.core.errors import NoFramesError
from imucald.core.text import counted
from imucald.report.drive_history import DriveHistory
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.replay import Replay, Sink
from imucald.runtime.segment_samples import SegmentSamples
from imucald.runtime.session import make_engine

_T = TypeVar("_T")

Progress = Callable[[int, int | None], None]
"""Callback for progress. Arguments: bytes read, and total bytes (None if not known)."""

UNUSED = "the log has no usable frame of this configuration; 'imucald check' shows more"


def _both(first: Callable[[_T], None], second: Callable[[_T], None]) -> Callable[[_T], None]:
    def both(what: _T) -> None:
        first(what)
        second(what)

    return both


def is_unused(drive: DriveResult) -> bool:
    """Return whether no frame of the drive could be used."""
    return UNUSED in drive.notes


def require_frames(drive: DriveResult) -> DriveResult:
    """Return the drive. Raises NoFramesError if the logs of the drive contain no frame."""
    refuse_empty(drive.frames["read"], drive.logs)
    return drive


def refuse_empty(frames: int, logs: Iterable[object]) -> None:
    """Raise NoFramesError with the names of the logs if frames is 0."""
    if not frames:
        raise NoFramesError(f"{', '.join(map(str, logs))}: holds no CAN frame")


class ReplayRun:
    """The replay of the pieces of one recording through a new engine.

    sink: receives the frames that the daemon would send. speed: 1 is real time, None means as fast
    as possible.
    watcher: gets samples and estimates, for the HTML page.
    Raises ConfigError.
    """

    def __init__(
        self,
        config: Configuration,
        logs: Sequence[LogSource],
        signals: bool = True,
        progress: Progress | None = None,
        strict: bool = False,
        sink: Sink | None = None,
        speed: float | None = None,
        watcher: DriveHistory | None = None,
    ) -> None:
        sources = [opened(log) for log in logs]
        self.logs = tuple(str(source) for source in sources)
        self._signals = signals
        self._recorder = Recorder(signals)
        snapshot: Callable[[Snapshot], None] = self._recorder.snapshot
        samples: Callable[[SegmentSamples], None] = self._recorder.samples
        if watcher is not None:
            snapshot = _both(snapshot, watcher.snapshot)
            samples = _both(samples, watcher.samples)
        self.engine = make_engine(config.loaded, snapshot, on_samples=samples)
        router = self.engine.router
        reading = sources, router.matches, strict, progress, router.stated_cycles
        self._reader = LogReader(*reading)
        self._replay = Replay(self.engine, self._reader, sink, speed)
        self._watcher = watcher
        self._kinds = self.engine.output.sensor_of

    def chunks(self) -> Iterator[None]:
        """Yield after each chunk of frames. With strict, the first bad line raises LogError."""
        yield from self._replay.chunks()

    @property
    def rows(self) -> int:
        """Number of sample rows of all tables that `take_signals` has not returned yet."""
        return self._recorder.rows

    def table_columns(self) -> dict[str, tuple[TableColumn, ...]]:
        """Return the columns of all possible tables."""
        kinds, found = self._kinds, {}
        for name in self.engine.output.triads:
            found[name] = corrected_columns(kinds.get(name, name))
        for channel in sorted(self.engine.router.channels):
            found[f"{RAW}{channel}"] = raw_columns(channel, kinds.get(channel))
        return {**found, HISTORY: HISTORY_COLUMNS, EVENTS: EVENT_COLUMNS}

    def take_signals(self) -> dict[str, Columns]:
        """Return the samples since the last call, by table. The returned samples are not stored any
        longer."""
        return self._recorder.take_signals(self._replay.lead, self._kinds)

    def history(self) -> Columns:
        """Return the history: the estimate once per second, up to the current time of the
        replay."""
        return self._recorder.history(self._replay.lead)

    def result(self) -> DriveResult:
        """Return the result of the frames so far, with the samples since the last call of
        `take_signals`."""
        engine, reader = self.engine, self._reader
        lead = self._replay.lead
        if self._watcher is not None:
            self._watcher.lead = lead
        left_out = self._recorder.events_left_out
        notes = [] if engine.preprocessing is None else list(engine.preprocessing.notes)
        notes = [f"part of the model that is not used: {note}" for note in notes]
        notes += reader.overlaps
        notes += [UNUSED] if engine.router.used == 0 else []
        notes += (
            [f"{counted(left_out, 'more event was', 'more events were')} left out"]
            if left_out
            else []
        )
        tables = self.take_signals()
        return drive_result(
            logs=self.logs,
            mount=MountResult.from_estimate(engine.pipeline.estimator.estimate()),
            summary=self._replay.summary(),
            span_us=self._span_us(),
            problems=tuple(reader.problems),
            notes=tuple(notes),
            tables={
                **self._in_order(tables),
                HISTORY: self.history(),
                EVENTS: self._recorder.events(lead, engine),
            },
        )

    def _in_order(self, tables: Mapping[str, Columns]) -> dict[str, Columns]:
        """Sort tables, corrected samples first. A sensor without samples gets an empty table."""
        if not self._signals:
            return {}
        corrected = {
            name: tables.get(name, no_rows(corrected_columns(self._kinds.get(name, name))))
            for name in self.engine.output.triads
        }
        return {
            **corrected,
            **{name: tables[name] for name in sorted(set(tables) - set(corrected))},
        }

    def _span_us(self) -> tuple[int, int] | None:
        span = self._replay.span
        if span is None:
            return None
        first, last = microseconds(np.array(span)).tolist()
        return first, last
