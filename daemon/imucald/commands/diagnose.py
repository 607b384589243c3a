"""`imucald diagnose`: what the simulation gets wrong beside measured drives, why, and the gain."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from imucald.commands.options import add_config

if TYPE_CHECKING:
    from imucald.config import LoadedConfig
    from imucald.diagnosis.recording import Recording
    from imucald.diagnosis.result import Diagnosis
    from imucald.model.model import VehicleModel

PAGE = "index.html"
FEW_REJECTED = 1e-4
"""Share of frames that may be rejected without a word: a damaged line or two."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `diagnose`."""
    parser.epilog = (
        "Several logs are drives of one vehicle with the sensor in its place; whole drives then "
        "serve as data that the fit does not see. Exit status: 0 whatever the verdict, 1 where "
        "nothing could be diagnosed."
    )
    parser.add_argument(
        "logs",
        nargs="+",
        metavar="LOG",
        help="one drive each: candump log (.log, .gz, '-' for standard input), or .asc .blf .trc "
        ".csv .mf4",
    )
    add_config(parser)
    parser.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="model file to put to the test (default: a plain car, with the configuration's "
        "figures and the mount that the drives give)",
    )
    parser.add_argument(
        "--json", metavar="FILE", help="write the diagnosis as JSON ('-': standard output)"
    )
    parser.add_argument(
        "--report",
        type=Path,
        metavar="DIR",
        help=f"write a page with pictures there ({PAGE}; needs the extra 'report')",
    )
    parser.add_argument(
        "--write-model",
        metavar="FILE",
        help="write the extended model file, for 'simulate --model' and the key 'model:'",
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        default=300.0,
        metavar="S",
        help="processor time after which the search ends, with what it found (%(default).0f s)",
    )
    parser.add_argument("--strict", action="store_true", help="stop at the first bad line")
    parser.add_argument("--quiet", action="store_true", help="no progress, no summary")


def run(options: argparse.Namespace) -> int:
    """Read, diagnose, then tell in every way that was asked for."""
    from imucald.commands.files import STANDARD, write_text
    from imucald.runtime.session import open_config
    from imucald.simulation import load_model

    _check(options)
    model = load_model(options.model) if options.model else None
    loaded = open_config(options.config, options.database)
    recordings = [_read(loaded, log, options) for log in options.logs]
    diagnosis = _diagnosed(loaded, recordings, model, options)
    if options.json:
        write_text(options.json, _json(diagnosis, options.logs))
    if options.write_model:
        write_text(options.write_model, _model_text(diagnosis, recordings))
    if options.report:
        _write_report(diagnosis, options)
    if STANDARD not in (options.json, options.write_model) and not options.quiet:
        from imucald.commands.diagnose_view import print_diagnosis

        print_diagnosis(diagnosis)
        _print_written(options)
    return 0


def _check(options: argparse.Namespace) -> None:
    """Raise ImucaldError for what would fail later, before any work."""
    from imucald.commands.files import STANDARD, check_files
    from imucald.core.errors import ConfigError, ImucaldError

    seen: dict[object, str] = {}
    for log in options.logs:
        place = log if log == STANDARD else Path(log).resolve()
        if place in seen:
            raise ConfigError(f"{log} is given twice: a drive counts once")
        seen[place] = log
    outputs = [options.json, options.write_model]
    if options.report:
        folder = options.report
        if folder.exists() and not folder.is_dir():
            raise ImucaldError(f"{folder}: cannot be written: Not a directory")
        # A folder that is made only at the end is checked by its name in the folder above.
        outputs.append(folder / PAGE if folder.exists() else folder)
        from imucald.report.page import require_libraries

        require_libraries()
    models = [options.model] if options.model else []
    inputs = (options.config, *options.database, *models, *options.logs)
    check_files(inputs, outputs)


def _read(loaded: LoadedConfig, log: str, options: argparse.Namespace) -> Recording:
    from imucald.commands.terminal import progress_bar
    from imucald.diagnosis.recording import read_samples

    with progress_bar(f"reading {Path(log).name}", options.quiet) as progress:
        recording = read_samples(loaded, [log], progress, options.strict)
    for text in recording.problems:
        print(f"imucald: {text}", file=sys.stderr)
    return recording


def _diagnosed(
    loaded: LoadedConfig,
    recordings: Sequence[Recording],
    model: VehicleModel | None,
    options: argparse.Namespace,
) -> Diagnosis:
    from imucald.commands.diagnose_view import share_bar
    from imucald.core.errors import EstimateError
    from imucald.diagnosis.diagnose import diagnose

    drives = [recording.samples for recording in recordings]
    notes = [note for recording in recordings for note in _reading_notes(recording)]
    with share_bar("diagnosis", options.quiet) as progress:
        try:
            if model is None:
                from imucald.diagnosis.baseline import baseline_model

                progress(0.0, "baseline model")
                model = baseline_model(loaded, recordings)
            diagnosis = diagnose(drives, model, progress, options.time_limit)
        except EstimateError as error:
            if not notes:
                raise
            raise EstimateError(f"{error} ({'; '.join(notes)})") from None
    return replace(diagnosis, notes=(*diagnosis.notes, *notes))


def _reading_notes(recording: Recording) -> list[str]:
    """What reading a log came to, where it was not all well."""
    notes = []
    bad = sum(recording.rejected.values())
    if bad > FEW_REJECTED * recording.frames_read:
        reasons = ", ".join(f"{reason} {n}" for reason, n in recording.rejected.items())
        notes.append(f"{recording.name}: {bad} frames or samples were rejected ({reasons})")
    if recording.gaps:
        times = ", ".join(f"{t:.0f}" for t in recording.gaps[:5])
        more = ", ..." if len(recording.gaps) > 5 else ""
        notes.append(f"{recording.name}: holes or steps of the clock before {times}{more} s")
    return notes


def _json(diagnosis: Diagnosis, logs: Sequence[str]) -> str:
    """The documented keys, which logs they are of, and what changes in the model file."""
    from imucald.report.model_changes import model_changes

    changes = model_changes(diagnosis.model_before, diagnosis.model_after)
    result: dict[str, Any] = {
        **diagnosis.as_json(),
        "logs": list(logs),
        "model_changes": {c.key: {"before": c.before, "after": c.after} for c in changes},
    }
    return json.dumps(result, indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def _model_text(diagnosis: Diagnosis, recordings: Sequence[Recording]) -> str:
    """The extended model with a head that says where it comes from."""
    from imucald import __version__
    from imucald.report.model_changes import model_changes, value_text
    from imucald.report.numbers import duration
    from imucald.report.wording import verdict

    head = [f"VehicleModel file written by imucald diagnose {__version__} from:"]
    head += [f"  {r.name} ({duration(r.duration_s)})" for r in recordings]
    head.append(verdict(diagnosis).headline)
    changes = model_changes(diagnosis.model_before, diagnosis.model_after)
    head += [f"  {c.key}: {value_text(c.before)} -> {value_text(c.after)}" for c in changes]
    if not changes:
        head.append("  no key was changed")
    lines = ("".join(c if c.isprintable() else "?" for c in line) for line in head)
    return "".join(f"# {line}\n" for line in lines) + diagnosis.model_after.to_yaml()


def _write_report(diagnosis: Diagnosis, options: argparse.Namespace) -> None:
    import time

    from imucald import __version__
    from imucald.commands.files import write_text
    from imucald.core.errors import ImucaldError
    from imucald.report.page import About, report_page

    about = About(
        logs=["/".join(Path(log).parts[-2:]) for log in options.logs],
        config=options.config.name,
        model=options.model.name if options.model else "plain car, mount from these drives",
        made=f"{time.strftime('%Y-%m-%d %H:%M')}, imucald {__version__}",
    )
    page = report_page(diagnosis, about)
    try:
        options.report.mkdir(exist_ok=True)
    except OSError as error:
        raise ImucaldError(
            f"{options.report}: cannot be written: {error.strerror or error}"
        ) from None
    write_text(options.report / PAGE, page)


def _print_written(options: argparse.Namespace) -> None:
    for name in (options.json, options.write_model, options.report and options.report / PAGE):
        if name:
            print(f"written: {name}")
