"""`imucald diagnose`: find errors of the simulation from measured drives, with their causes and
effects."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

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
    from imucald.diagnosis.recording import Recording
    from imucald.diagnosis.result import Diagnosis


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `diagnose`."""
    parser.epilog = (
        "Several logs must be drives of one vehicle, with the sensor at the same place. Some "
        "whole drives are then excluded from the fit and used to test it. Exit status: 0 "
        "there is a verdict (of any kind), 1 no diagnosis was possible."
    )
    parser.add_argument(
        "logs",
        nargs="+",
        metavar="LOG",
        help=f"one drive each: {LOG_HELP}",
    )
    add_config(parser)
    parser.add_argument(
        "--model",
        type=Path,
        metavar="FILE",
        help="model file to test (default: a plain car, with the values of the configuration and "
        "the mount found in the drives)",
    )
    parser.add_argument(
        "--json", metavar="FILE", help="write the diagnosis as JSON ('-': standard output)"
    )
    parser.add_argument(
        "--report",
        type=Path,
        metavar="DIR",
        help="write a page with pictures into this folder (index.html; needs "
        f"{how_to_install('report')})",
    )
    parser.add_argument(
        "--write-model",
        metavar="FILE",
        help=(
            "write the extended model file. Use the file with 'simulate --model', or with the key "
            "'model:' of a configuration"
        ),
    )
    parser.add_argument(
        "--time-limit",
        type=float,
        metavar="S",
        help="processor time after which the search ends with the causes found so far (default: 40 "
        "s for each hour of driving, at least 30 s)",
    )
    add_strict(parser)
    add_quiet(parser, "print no progress and no summary")


def run(options: argparse.Namespace) -> int:
    """Read the drives, diagnose them, and write all requested reports."""
    from imucald.api.diagnosing import diagnosis_of
    from imucald.commands.files import STANDARD, write_text, write_yaml
    from imucald.commands.schema import MODEL
    from imucald.commands.terminal import share_bar
    from imucald.runtime.summary import as_json
    from imucald.simulation import load_model

    _check(options)
    model = load_model(options.model) if options.model else None
    config = configuration(options)
    recordings = [_read(config, log, options) for log in options.logs]
    with share_bar("diagnosis", options.quiet) as progress:
        limit = options.time_limit
        found = diagnosis_of(config, options.logs, recordings, model, limit, progress)
    if options.json:
        write_text(options.json, as_json(found.to_dict()))
    if options.write_model:
        write_yaml(options.write_model, found.model_text(), MODEL)
    files = [options.json, options.write_model]
    if options.report:
        files.append(_write_report(found.diagnosis, options))
    if STANDARD not in (options.json, options.write_model) and not options.quiet:
        from imucald.commands.diagnose_view import print_diagnosis

        print_diagnosis(found.diagnosis, has_file=bool(options.model or options.write_model))
        for file in filter(None, files):
            print(f"written: {file}")
    return 0


def _check(options: argparse.Namespace) -> None:
    from imucald.commands.files import STANDARD, check_files
    from imucald.core.errors import ConfigError

    seen: dict[object, str] = {}
    for log in options.logs:
        place = log if log == STANDARD else Path(log).resolve()
        if place in seen:
            raise ConfigError(f"{log} is given twice; give each log once")
        seen[place] = log
    outputs = [options.json, options.write_model]
    if options.report:
        from imucald.commands.report_pages import PAGE, check_report_folder

        folder = options.report
        check_report_folder(folder)
        # A folder that is made only at the end is checked through its parent folder.
        outputs.append(folder / PAGE if folder.exists() else folder)
    models = [options.model] if options.model else []
    inputs = (options.config, *options.database, *models, *options.logs)
    check_files(inputs, outputs)


def _read(config: Configuration, log: str, options: argparse.Namespace) -> Recording:
    from imucald.commands.terminal import progress_bar
    from imucald.diagnosis.recording import read_samples

    with progress_bar(f"reading {Path(log).name}", options.quiet) as progress:
        recording = read_samples(config.loaded, [log], progress, options.strict)
    print_problems(recording.problems)
    return recording


def _write_report(diagnosis: Diagnosis, options: argparse.Namespace) -> Path:
    from imucald.commands.report_pages import about_now, write_page
    from imucald.report.page import report_page

    model = options.model.name if options.model else "plain car, mount from these drives"
    about = about_now(options.logs, options.config, model)
    return write_page(options.report, report_page(diagnosis, about))
