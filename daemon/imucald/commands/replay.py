"""`imucald replay`: run recorded logs through the same engine as the live daemon."""

from __future__ import annotations

import argparse
import math
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imucald.commands.options import (
    LOG_HELP,
    add_config,
    add_quiet,
    add_strict,
    configuration,
    print_problems,
)
from imucald.core.libraries import how_to_install

if TYPE_CHECKING:
    from imucald.api.configuration import Configuration
    from imucald.api.drive import DriveResult
    from imucald.api.run import ReplayRun
    from imucald.can.columns import FrameColumns
    from imucald.commands.report_pages import ReplayReport
    from imucald.runtime.replay import Sink


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `replay`."""
    parser.epilog = (
        "Several logs are several drives of one vehicle, each replayed on its own. Logs that "
        "overlap in time are reported, and the mounts of successive drives are compared. For "
        "several vehicles use 'imucald fleet'. With --joined the logs are pieces of "
        "one recording. A frame that is in two pieces counts twice, and such frames are reported. "
        "Exit status: 0 done (with any state of the mount), 1 a log could not be read or has no "
        "frame that can be used.\n\n"
        "  imucald replay --config car.yaml drive.log\n"
        "  imucald replay --config car.yaml drive.log --report page --write drive.csv\n"
        "  imucald replay --config car.yaml logs/ --json all.json"
    )
    parser.add_argument(
        "logs",
        nargs="+",
        metavar="LOG",
        help=f"{LOG_HELP}; a folder or a pattern means all logs in it",
    )
    add_config(parser)
    parser.add_argument(
        "--joined", action="store_true", help="the logs are pieces of one recording, in this order"
    )
    parser.add_argument(
        "--out", metavar="FILE", help="write the frames that imucald would send (candump log)"
    )
    parser.add_argument(
        "--write",
        type=Path,
        metavar="FILE",
        help="write corrected signals, history and events as .parquet, .csv, .mf4 or .mcap "
        "(several drives get a file each)",
    )
    parser.add_argument(
        "--quantities",
        metavar="NAMES",
        help=(
            "with --write: names of the tables, such as accel,gyro,raw/speed. 'raw' means all "
            "samples as the sensors sent them (default: all tables except 'raw')"
        ),
    )
    parser.add_argument(
        "--json", metavar="FILE", help="write the result as JSON ('-': standard output)"
    )
    parser.add_argument(
        "--report",
        type=Path,
        metavar="DIR",
        help="write a page about the drive into DIR; several drives get a folder each and an "
        "index (needs "
        f"{how_to_install('report')})",
    )
    add_strict(parser)
    parser.add_argument(
        "--speed",
        type=float,
        metavar="X",
        help="SENDS the corrected frames on a bus, at X times real time (default: nothing is sent, "
        "and the log is replayed as fast as possible)",
    )
    parser.add_argument(
        "--interface", help="with --speed: python-can interface of the bus to send on"
    )
    parser.add_argument("--channel", help="with --speed: channel of the bus to send on")
    add_quiet(parser, "print no progress and no table")


def run(options: argparse.Namespace) -> int:
    """Replay the logs, then print the results."""
    from imucald.api.logs import found_names
    from imucald.core import compiled
    from imucald.core.file_cache import keep_databases

    logs = found_names(options.logs)
    _check(options, logs)
    if (slow := compiled.slow_words()) and not options.quiet:
        print_problems([slow])
    keep_databases(os.environ)
    config = configuration(options)
    if len(logs) > 1 and not options.joined:
        return _several(options, config, logs)
    return _one(options, config, logs)


def _one(options: argparse.Namespace, config: Configuration, logs: Sequence[str]) -> int:
    from imucald.api.run import is_unused, require_frames
    from imucald.commands.files import STANDARD, write_text
    from imucald.runtime.summary import as_json

    page = _page(options, logs, options.report)  # checked before a file is opened
    with _sink(options, config) as sink:
        drive, written = _replayed(options, config, logs, options.write, sink, page)
    _print_problems(options, drive)
    result = drive.to_dict()
    if options.json:
        write_text(options.json, as_json(result))
    require_frames(drive)
    is_shown = STANDARD not in (options.json, options.out) and not options.quiet
    why = _causes(options, config, logs, result) if is_shown or page is not None else []
    if page is not None:
        page.write(result, drive.problems, why)
    if is_shown:
        from imucald.commands.terminal import print_summary

        print_summary(result, why)
        _print_written(written)
    return 1 if is_unused(drive) else 0


def _causes(
    options: argparse.Namespace,
    config: Configuration,
    logs: Sequence[str],
    result: Mapping[str, Any],
) -> list[str]:
    """Return the likely causes of the contradictions in a replayed drive.

    The estimator compares pairs of signals while it runs, so it cannot say which signal of a pair
    is wrong. `check` judges the whole drive. result: as in docs/json.md.
    """
    import shlex

    from imucald.api.checking import check
    from imucald.can.logs.text_blocks import STDIN
    from imucald.mount.estimate import GOOD_NAMES

    if result["state"] in GOOD_NAMES or not result["details"].get("faults"):
        return []
    names = ["LOG" if log == STDIN else log for log in logs]
    command = shlex.join(["imucald", "check", "--config", str(options.config), *names])
    if STDIN in logs:
        return [f"two signals contradict each other: save the log, then run '{command}'"]
    found = check(config, logs).findings
    for level in ("error", "warning"):
        if texts := [f"{f['quantity']}: {f['text']}" for f in found if f["level"] == level]:
            return texts
    return [
        "not known: two signals contradict each other in a part of the drive, but over the whole "
        f"drive no sign, axis or unit is wrong. The sensor may move in its holder. '{command}' "
        "shows every signal"
    ]


def _several(options: argparse.Namespace, config: Configuration, logs: Sequence[str]) -> int:
    """Replay each log as a drive. A log that cannot be read is reported, and the rest continues."""
    from imucald.api.drives import DriveSet, between_drives, names_apart
    from imucald.api.run import is_unused, require_frames
    from imucald.commands.files import STANDARD, write_text
    from imucald.core.errors import LogError
    from imucald.runtime.summary import as_json

    drives, written, folders = [], list[Path](), list[str]()
    failed = list[tuple[str, str]]()
    explained = list[str]()
    if options.report:
        from imucald.commands.report_pages import check_report_folder, make_folder

        check_report_folder(options.report)
        make_folder(options.report)
    for log, name in zip(logs, names_apart(logs), strict=True):
        path = _named(options.write, name)
        folder = options.report / name if options.report else None
        try:
            page = _page(options, [log], folder)
            drive, files = _replayed(options, config, [log], path, None, page)
            _print_problems(options, drive, f"{log}: ")
            require_frames(drive)
            why = _causes(options, config, [log], drive.to_dict())
            explained += (f"{log}: {text}" for text in why)
            if page is not None:
                page.write(drive.to_dict(), drive.problems, why)
        except LogError as error:
            if options.strict:
                raise
            print(f"imucald: {error}", file=sys.stderr)
            failed.append((log, str(error)))
            continue
        drives.append(drive)
        folders.append("" if folder is None else folder.name)
        written += files
    found = DriveSet(tuple(drives), *between_drives(drives), tuple(failed))
    broken = [f"not read: {reason}" for _, reason in failed]
    if options.report is not None and drives:
        from imucald.commands.report_pages import write_index

        file = write_index(
            options.report,
            list(zip(folders, found.rows(), strict=True)),
            [*broken, *explained, *found.notes],
            found.agreements,
        )
        if not options.quiet:
            print(f"imucald: written: {file}", file=sys.stderr)
    if options.json:
        write_text(options.json, as_json(found.to_dict()))
    if options.json != STANDARD and not options.quiet:
        from imucald.commands.terminal import print_drives

        print_drives(found.rows(), [*explained, *found.notes, *found.agreements])
        _print_written(written)
    return 1 if failed or any(map(is_unused, drives)) else 0


def _replayed(
    options: argparse.Namespace,
    config: Configuration,
    logs: Sequence[str],
    path: Path | None,
    sink: Sink | None,
    page: ReplayReport | None,
) -> tuple[DriveResult, list[Path]]:
    from imucald.api.run import ReplayRun
    from imucald.commands.terminal import progress_bar

    with progress_bar("replay", options.quiet) as progress:
        watcher = None if page is None else page.history
        signals, strict, speed = path is not None, options.strict, options.speed
        run = ReplayRun(config, logs, signals, progress, strict, sink, speed, watcher)
        if path is not None:
            return _written(run, path, options)
        for _ in run.chunks():
            pass
        return run.result(), []


def _written(
    run: ReplayRun, path: Path, options: argparse.Namespace
) -> tuple[DriveResult, list[Path]]:
    from imucald.api.streaming import DriveStream
    from imucald.core.errors import LogError

    stream, files = DriveStream(run), list[Path]()
    names = options.quantities.split(",") if options.quantities else None
    try:
        files = stream.write(path, names)
    except LogError:
        if not stream.ended:  # a log without a frame has a result, and is reported later
            raise
    return stream.result, files


def _named(path: Path | None, name: str) -> Path | None:
    """Return the path of the output file of one of several drives."""
    return path and path.with_name(f"{path.stem}.{name}{path.suffix}")


def _page(
    options: argparse.Namespace, logs: Sequence[str], folder: Path | None
) -> ReplayReport | None:
    if folder is None:
        return None
    from imucald.commands.report_pages import ReplayReport

    return ReplayReport(options, logs, folder)


def _print_problems(options: argparse.Namespace, drive: DriveResult, log: str = "") -> None:
    """log: name of the log, printed before each note if there are several logs."""
    from imucald.api.run import UNUSED

    print_problems(drive.problems)
    notes = (text for text in drive.notes if text == UNUSED or not options.quiet)
    print_problems(f"{log}{text}" for text in notes)


def _print_written(files: Sequence[Path]) -> None:
    for path in files:
        print(f"written: {path}")


def _check(options: argparse.Namespace, logs: Sequence[str]) -> None:
    from imucald.commands.files import check_files
    from imucald.core.errors import ConfigError

    if options.speed is None:
        if options.interface or options.channel:
            raise ConfigError("--interface and --channel need --speed (1 is real time)")
    elif not (options.speed > 0 and math.isfinite(options.speed)):
        raise ConfigError("--speed must be positive")
    if options.quantities and options.write is None:
        raise ConfigError("--quantities needs --write")
    inputs = (options.config, *options.database, *logs)
    several = len(logs) > 1 and not options.joined
    if options.write is not None:
        from imucald.api.files.written import require_format

        require_format(options.write)
    written = [options.write]
    if several:
        from imucald.api.drives import names_apart

        written = [_named(options.write, name) for name in names_apart(logs)]
    check_files(inputs, (options.out, options.json, *written))
    if several and (options.out or options.speed is not None):
        raise ConfigError(
            "--out and --speed take one drive, but several logs are several drives; give one "
            "log, or --joined if the logs are pieces of one recording"
        )


@contextmanager
def _sink(options: argparse.Namespace, config: Configuration) -> Iterator[Sink | None]:
    """Yield the receiver of the frames: a file, a bus, both, or None."""
    from contextlib import ExitStack

    from imucald.can.logs.log_reader import CandumpWriter
    from imucald.commands.files import reported_when_cut

    with ExitStack() as stack:
        sinks: list[Sink] = []
        if options.speed is not None:  # first the bus: if it fails, no file is made
            from imucald.service.live import open_link, send_columns

            link = stack.enter_context(
                open_link(config.loaded, [], frozenset(), options.interface, options.channel)
            )
            sinks.append(lambda frames: send_columns(link, frames))
        if options.out:
            writer = stack.enter_context(CandumpWriter(options.out))
            stack.enter_context(reported_when_cut(options.out))
            sinks.append(writer.write_columns)

        def everywhere(frames: FrameColumns) -> None:
            for sink in sinks:
                sink(frames)

        yield everywhere if sinks else None
