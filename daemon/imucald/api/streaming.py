"""`imucald.stream`: replay logs that are larger than memory, part by part."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from imucald.api.columns import HISTORY, Columns
from imucald.api.configuration import Configuration, PathLike
from imucald.api.drive import DriveResult, drive_plain
from imucald.api.logs import LogSource, pieces
from imucald.api.run import Progress, ReplayRun, require_frames
from imucald.api.table_access import TableAccess
from imucald.core.errors import ImucaldError

PART_ROWS = 150_000
"""Number of rows of a part, summed over all tables (about 6 MiB)."""


@dataclass(frozen=True, eq=False, repr=False)
class DrivePart(TableAccess):
    """A part of a drive: the samples from `from_s` to `to_s`, as in `DriveResult`.

    A table without samples in this part is absent. History and events are in the final result.
    """

    from_s: float
    to_s: float
    tables: Mapping[str, Columns]

    def __repr__(self) -> str:
        rows = ", ".join(f"{name} {len(table)}" for name, table in self.tables.items())
        return f"DrivePart({self.from_s:.1f} s to {self.to_s:.1f} s; rows: {rows})"[:200]


class DriveStream:
    """A running replay. Iterate over its parts once, then read its `result`."""

    def __init__(self, run: ReplayRun) -> None:
        self._run = run
        self._begun = False
        self._result: DriveResult | None = None

    def __iter__(self) -> Iterator[DrivePart]:
        """Yield parts of a few minutes each. Raises LogError if the log cannot be read."""
        if self._begun:
            raise ImucaldError("a stream can be read only once")
        self._begun = True
        for _ in self._run.chunks():
            if self._run.rows >= PART_ROWS:
                yield _part(self._run.take_signals())
        if self._run.rows:
            yield _part(self._run.take_signals())
        self._result = self._run.result()
        require_frames(self._result)

    @property
    def ended(self) -> bool:
        """True if the last part was yielded. If True, `result` is available."""
        return self._result is not None

    @property
    def result(self) -> DriveResult:
        """The drive's result with history and events, but without the yielded samples.

        Raises ImucaldError if the last part was not read yet.
        """
        if self._result is None:
            raise ImucaldError("the stream has not ended: read all its parts first")
        return self._result

    def write(self, path: PathLike, quantities: Sequence[str] | str | None = None) -> list[Path]:
        """Write the whole drive in bounded memory. Arguments, files and errors are the same as for
        `DriveResult.write`."""
        from imucald.api.files.written import chosen, format_of, write_parts  # noqa: PLC0415

        format_of(Path(path))
        tables = chosen(self._run.table_columns(), quantities)

        def parts() -> Iterator[Mapping[str, Columns]]:
            done = 0
            for part in self:
                history = self._run.history()
                yield {HISTORY: history.from_row(done), **part.tables}
                done = len(history)
            rest = self.result.tables
            yield {**rest, HISTORY: rest[HISTORY].from_row(done)}

        return write_parts(Path(path), tables, parts(), lambda: drive_plain(self.result))


def stream(
    config: Configuration | PathLike,
    log: LogSource | Sequence[LogSource],
    *,
    progress: Progress | None = None,
    strict: bool = False,
) -> DriveStream:
    """Replay one recording part by part. The memory is bounded for a recording of any length.

    Samples, arguments and errors are the same as for `replay`. log: one log, or a list of the
    pieces of one recording in their order.
    """
    return DriveStream(ReplayRun(Configuration.of(config), pieces(log), True, progress, strict))


def _part(tables: dict[str, Columns]) -> DrivePart:
    times = [table["t_s"] for table in tables.values()]
    return DrivePart(min(float(t[0]) for t in times), max(float(t[-1]) for t in times), tables)
