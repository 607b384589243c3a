"""`imucald fleet`: evaluate logs of many vehicles, on this machine or on a Dask cluster."""

from __future__ import annotations

import argparse
import importlib
import importlib.util
from pathlib import Path

from imucald.commands.options import add_quiet
from imucald.core.errors import ImucaldError
from imucald.core.libraries import how_to_install

ACTIONS = {
    "run": "evaluate the logs that were not evaluated yet",
    "retry": "evaluate the new logs and the failed logs",
    "status": "show the progress of the runs and the failed logs",
    "why": "show everything that is known about one log",
    "analyse": "analyse all drives together: vehicles, types, batches, remounts, outliers",
    "report": "write the results of the analysis as one HTML page",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of each action of `fleet`."""
    actions = parser.add_subparsers(
        dest="action", metavar="ACTION", required=True, help="what to do"
    )
    for name, text in ACTIONS.items():
        sub = actions.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        sub.add_argument("--out", required=True, metavar="URL", help="folder of the tables")
        if name in ("run", "retry"):
            _add_run(sub)
            continue
        sub.add_argument(
            "--fleet",
            type=Path,
            metavar="FILE",
            help="fleet.yaml with the options of the storage",
        )
        if name == "why":
            sub.add_argument(
                "log",
                metavar="LOG",
                help="address of the log, a part of the address, or its log_key",
            )
        elif name == "analyse":
            sub.add_argument(
                "--group",
                action="append",
                default=[],
                metavar="COLUMN",
                help=(
                    "columns of the drives table; vehicles of one type are compared by their "
                    "values (default: sensor_batch and firmware)"
                ),
            )
        elif name == "report":
            sub.add_argument("--html", type=Path, metavar="FILE", required=True, help="the page")


def _add_run(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--fleet", required=True, type=Path, metavar="FILE", help="fleet.yaml")
    parser.add_argument(
        "--logs",
        metavar="GLOB|LIST",
        help="logs to evaluate, instead of the logs in fleet.yaml",
    )
    where = parser.add_mutually_exclusive_group()
    where.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help=("number of processes on this machine (default: its cores)"),
    )
    where.add_argument(
        "--scheduler", metavar="URL", help="Dask: tcp://HOST:PORT or tls://HOST:PORT"
    )
    for part, what in (
        ("ca", "certificate authority"),
        ("cert", "certificate of this client"),
        ("key", "key of this client"),
    ):
        parser.add_argument(f"--tls-{part}", metavar="FILE", help=f"for tls://: {what} (PEM file)")
    parser.add_argument(
        "--memory", default="1GiB", metavar="SIZE", help="memory limit for one log (default: 1GiB)"
    )
    parser.add_argument(
        "--time-limit",
        default="15min",
        metavar="TIME",
        help="time limit for one log (default: 15min)",
    )
    parser.add_argument("--signals", choices=("none", "corrected"), default="none",
                        help="write corrected signals too")  # fmt: skip
    parser.add_argument("--diagnose", action="store_true", help="run 'imucald diagnose' on each "
                                                                "drive too (takes some seconds "
                                                                "for each log)")  # fmt: skip
    parser.add_argument("--since", metavar="DATE", help="only logs of this day or later")
    parser.add_argument("--redo", choices=("nothing", "failed", "config", "all"),
                        default="nothing", help="which logs to evaluate again: failed logs, "
                                                "logs evaluated with another config"
                                                "uration or version, or all logs")  # fmt: skip
    parser.add_argument("--limit", type=int, metavar="N", help="evaluate N logs at most")
    parser.add_argument(
        "--dry-run", action="store_true", help="only show which logs would be evaluated"
    )
    add_quiet(parser, "no progress")


def run(options: argparse.Namespace) -> int:
    """Run the action. Return 0: done, 3: some logs failed, 1: the run was aborted."""
    missing = [name for name in ("pyarrow", "fsspec") if importlib.util.find_spec(name) is None]
    if missing:
        text = f"fleet needs {' and '.join(missing)}: {how_to_install('fleet')}"
        raise ImucaldError(text)
    module = "run" if options.action in ("run", "retry") else "read"
    action = importlib.import_module(f"imucald.commands.fleet_{module}")
    return int(getattr(action, options.action)(options))
