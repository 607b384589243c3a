"""Read recorded logs as the daemon does, and return the samples of one drive."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from msgspec.structs import replace

from imucald.can.logs.log_reader import LogReader, Progress
from imucald.config import LoadedConfig
from imucald.core.errors import LogError
from imucald.core.samples import QUANTITIES, TRIADS, Samples, Series
from imucald.inputs.quantities import wanted_numbers
from imucald.inputs.router import Router
from imucald.inputs.routes import MessageRoute, SignalRoute
from imucald.inputs.wiring import compile_router
from imucald.runtime.timebase import TimeBase

SAME_CHANGES = 64
"""Number of successive new values of sensor noise that never occur twice. The module
`can.logs.recording_files` uses the same number for frames. A sensor that shows one constant value
at standstill cannot show that two recordings are equal."""


@dataclass(frozen=True)
class Recording:
    """One drive as recorded in a log. Times are stream times: seconds since the first configured
    frame."""

    name: str
    """File name of the log. If the recording has several logs, the name of the first log."""
    samples: Samples
    """Samples in SI units, by channel (see `imucald.core.samples`). A channel without samples is
    absent."""
    duration_s: float
    """Stream time of the last configured frame [s]."""
    frames_read: int
    """Number of all valid frames of the log, including frames that are not configured."""
    rejected: Mapping[str, int]
    """Number of bad lines, rejected frames and rejected samples, by reason."""
    gaps: tuple[float, ...] = ()
    """Stream times [s] at which a new segment begins, after a gap or a step of the clock."""
    cycle_s: Mapping[str, float] = field(default_factory=dict)
    """Cycle time of the message, by channel [s], as the database states it; absent if the database
    has no cycle time."""
    problems: tuple[str, ...] = ()
    """The first bad lines, as texts with file and line number."""


def read_samples(
    loaded: LoadedConfig,
    paths: Sequence[Path | str],
    progress: Progress | None = None,
    strict: bool = False,
) -> Recording:
    """Read one recording with the guards, checksums, units and signs that the configuration states.

    paths: one log, or the pieces of one recording in their order. progress: function that is called
    with the number of bytes read and the total number of bytes. If there are several
    accelerometers, gyroscopes or magnetometers, only the first is read, because each sensor has
    axes of its own. Frames are read in chunks, and only samples are kept. Raises ConfigError.
    Raises LogError for logs without a usable frame and, with `strict`, at the first bad line.
    """
    router = _first_sensors(loaded)
    reader = LogReader(paths, router.matches, strict, progress)
    timebase, gaps, kept = TimeBase(), list[float](), dict[str, list[Series]]()
    for chunk in reader:
        for segment in timebase.segments(chunk.t):
            if segment.gap:
                gaps.append(float(segment.t[0]))
            whole = segment.stop - segment.start == len(chunk)
            frames = chunk if whole else chunk.take(slice(segment.start, segment.stop))
            for channel, series in router.columns(segment.t, frames).samples.items():
                kept.setdefault(channel, []).append(series)
    _refuse_empty(paths, reader, router)
    rejected = Counter(reader.rejected)
    rejected.update(router.rejected)
    return Recording(
        name=Path(paths[0]).name,
        samples={name: _joined(kept.pop(name)) for name in QUANTITIES if name in kept},
        duration_s=timebase.now,
        frames_read=reader.frames_read,
        rejected=dict(sorted(rejected.items())),
        gaps=tuple(gaps),
        cycle_s=_cycles(router.routes, router.channels),
        problems=tuple(reader.problems),
    )


def is_same_recording(one: Recording, other: Recording) -> bool:
    """True if two recordings begin with the same samples of the accelerometer.

    Differences in the names, interfaces, time stamps, formats and ends of the logs are ignored.
    """
    if "accel" not in one.samples or "accel" not in other.samples:
        return False
    first, second = one.samples["accel"].values, other.samples["accel"].values
    n = min(len(first), len(second))
    differs = (first[:n] != second[:n]).any(axis=1)
    same = int(np.argmax(differs)) if differs.any() else n
    changes = (np.diff(first[:same], axis=0) != 0.0).any(axis=1)
    return int(np.count_nonzero(changes)) >= SAME_CHANGES


def _joined(parts: Sequence[Series]) -> Series:
    return Series(np.concatenate([s.t for s in parts]), np.concatenate([s.values for s in parts]))


def _first_sensors(loaded: LoadedConfig) -> Router:
    """Return the router of the configuration without fallback sensors and parallel sensors."""
    router = compile_router(loaded)  # reports all mistakes of the configuration
    signals = loaded.config.signals
    # Each of several sensors has axes of its own.
    keys = [QUANTITIES[channel].key for channel in TRIADS]
    first = {key: triads[:1] for key in keys if len(triads := getattr(signals, key) or ()) > 1}
    if not first and not signals.parallel:
        return router
    signals = replace(signals, **first, parallel=())
    named = (wanted.source.signal or "" for wanted in wanted_numbers(signals))
    used = {name.partition(".")[0] for name in named}
    messages = {name: m for name, m in loaded.config.messages.items() if name in used}
    reduced = loaded.with_databases(loaded.config.database)
    reduced.config = replace(loaded.config, signals=signals, messages=messages)
    return compile_router(reduced)


def _refuse_empty(paths: Sequence[Path | str], reader: LogReader, router: Router) -> None:
    names = ", ".join(map(str, paths))
    if reader.frames_read == 0:
        raise LogError(f"{names}: the log holds no CAN frame")
    if router.used == 0:
        why = ", ".join(f"{reason} {n}" for reason, n in router.rejected.items())
        rejected = f" (rejected: {why})" if why else ""
        raise LogError(
            f"{names}: the log has no usable frame of this configuration{rejected}; 'imucald "
            "check' shows more"
        )


def _cycles(routes: Sequence[SignalRoute], channels: frozenset[str]) -> dict[str, float]:
    """Return the cycle time of the preferred source, by channel."""
    found: dict[str, tuple[int, float]] = {}
    for route in routes:
        cycle = route.plan.message.cycle_time if isinstance(route, MessageRoute) else None
        for tap in route.taps:
            if cycle is not None and tap.rank <= found.get(tap.channel, (tap.rank, 0.0))[0]:
                found[tap.channel] = (tap.rank, cycle)
    cycles = {channel: cycle for channel, (_, cycle) in sorted(found.items())}
    for derived, source in (("speed", "wheel_speeds"), ("reverse", "speed")):
        if derived in channels and source in cycles:
            cycles.setdefault(derived, cycles[source])
    return cycles
