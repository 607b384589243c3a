"""`imucald fleet run` and `retry`."""

from __future__ import annotations

import argparse
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import date
from types import FrameType
from typing import TYPE_CHECKING

from imucald.commands.interrupting import interrupt
from imucald.core.errors import ConfigError, ImucaldError
from imucald.core.libraries import how_to_install
from imucald.core.text import counted, size

if TYPE_CHECKING:
    from imucald.fleet.driver import Counts, FleetRun
    from imucald.fleet.fleet_file import Fleet
    from imucald.fleet.plan import Plan
    from imucald.fleet.workers import Workers

SOME_FAILED = 3
INTERRUPTED = 130
_SIZES = {"": 1.0, "K": 2.0**10, "M": 2.0**20, "G": 2.0**30}
_TIMES = {"s": 1.0, "": 1.0, "min": 60.0, "h": 3600.0}


def retry(options: argparse.Namespace) -> int:
    """Evaluate the failed logs again."""
    options.redo = "failed"
    return run(options)


def run(options: argparse.Namespace) -> int:
    """Evaluate the logs that are not evaluated yet."""
    stopping = _Stopping()
    try:
        with _signals_call(stopping):
            return _run(options, stopping)
    except KeyboardInterrupt:
        print("imucald: interrupted. Run the same command to continue", file=sys.stderr)
        return INTERRUPTED


def _run(options: argparse.Namespace, stopping: _Stopping) -> int:
    from imucald.fleet.bundle import unpack
    from imucald.fleet.task import DIAGNOSE, EVALUATE
    from imucald.fleet.template_client import template_for

    function = DIAGNOSE if options.diagnose else EVALUATE
    if options.scheduler is None and not options.dry_run:
        unpack({})  # makes the folder whose name the template inherits
        template_for(function).begin()  # imports while this process does
    from imucald.commands.options import print_problems
    from imucald.fleet.driver import FleetRun
    from imucald.fleet.fleet_file import load_fleet
    from imucald.fleet.lease import Lease
    from imucald.fleet.listing import list_logs
    from imucald.fleet.plan import Options, planned
    from imucald.fleet.store import Store
    from imucald.fleet.tables import set_damaged_aside
    from imucald.fleet.task import LogLimits

    memory = _amount("--memory", options.memory, _SIZES, "(?:i?B)?",
                     "size; write for example 512MiB or 2GiB")  # fmt: skip
    time_limit = _amount("--time-limit", options.time_limit, _TIMES, "",
                         "time; write for example 90s or 15min")  # fmt: skip
    limits = LogLimits(round(memory), time_limit)
    if options.since is not None and not _is_date(options.since):
        raise ConfigError(f"--since {options.since}: this is not a date; write YYYY-MM-DD")
    fleet = load_fleet(options.fleet, {"logs": options.logs} if options.logs else None)
    for bundle in fleet.bundles.values():
        print_problems(f"warning: {text}" for text in bundle.warnings)
    store = Store(options.out, fleet.settings.storage)
    how = Options(limits=limits, redo=options.redo, since=options.since, limit=options.limit,
                  signals=options.signals == "corrected",
                  function=function)  # fmt: skip
    logs = list_logs(fleet)
    if options.dry_run:
        print(_said(planned(fleet, store, logs, how)))
        return 0
    with Lease(store) as lease:
        print_problems(f"warning: {text}" for text in set_damaged_aside(store))
        plan = planned(fleet, store, logs, how)
        print(_said(plan), file=sys.stderr)
        workers = _workers(options, fleet)
        with _progress(options.quiet) as report:
            work = FleetRun(fleet, store, workers, plan, report)
            try:
                stopping.work = work
                whole = work.go(lease)
            finally:
                workers.close()
    return _print_end(work.counts, whole)


def _is_date(text: str) -> bool:
    try:
        return date.fromisoformat(text).isoformat() == text
    except ValueError:
        return False


def _amount(option: str, text: str, units: Mapping[str, float], after: str, form: str) -> float:
    """Return a number with one of the units, and what may stand after it. form: text about what
    the option takes."""
    match = re.fullmatch(rf"([\d.]+)\s*({'|'.join(units)}){after}", text.strip())
    if match is None or float(match[1]) <= 0:
        raise ConfigError(f"{option} {text}: this is not a {form}")
    return float(match[1]) * units[match[2]]


def _workers(options: argparse.Namespace, fleet: Fleet) -> Workers:
    from imucald.fleet.workers import ExecutorWorkers

    if options.scheduler is None:
        slots = options.workers or len(os.sched_getaffinity(0))
        if slots < 1:
            raise ConfigError("--workers must be 1 or more")
        return ExecutorWorkers.here(slots, fleet.bundles)
    try:
        from imucald.fleet.dask_workers import DaskWorkers, TlsFiles
    except ModuleNotFoundError:
        text = f"--scheduler needs distributed: {how_to_install('fleet')}"
        raise ImucaldError(text) from None
    files = (options.tls_ca, options.tls_cert, options.tls_key)
    if any(files) and not all(files):
        raise ConfigError("give --tls-ca, --tls-cert and --tls-key together, or none of them")
    return DaskWorkers(options.scheduler, fleet.bundles, TlsFiles(*files) if all(files) else None)


def _said(plan: Plan) -> str:
    text = (
        f"imucald: {counted(plan.listed, 'log')}, {plan.done} known, {len(plan.tasks)} to evaluate"
    )
    text += f" ({size(plan.bytes)})"
    if plan.failed_before:
        text += f"; {plan.failed_before} failed before ('imucald fleet retry' tries them again)"
    if plan.other_configuration:
        text += f"; {plan.other_configuration} were evaluated with another configuration or version"
        text += " (--redo config evaluates them again)"
    return text


class _Stopping:
    """Handler of Ctrl-C and SIGTERM. After the first signal, only the logs in progress are
    finished; the second signal aborts."""

    work: FleetRun | None = None
    """The run; None if it has not started. In that case, the first signal aborts."""

    def __call__(self, number: int, frame: FrameType | None) -> None:
        if self.work is None or self.work.counts.stopping:
            interrupt(number, frame)
            return
        text = "finishing the logs that are being evaluated; press Ctrl-C again to stop at once"
        print(f"\nimucald: {text}", file=sys.stderr)
        self.work.stop()


@contextmanager
def _signals_call(stop: _Stopping) -> Iterator[None]:
    before = {s: signal.signal(s, stop) for s in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _line(counts: Counts) -> str:
    failed = sum(counts.failed.values())
    left = counts.left_s
    text = f"{counts.done}/{counts.logs} logs, {size(counts.bytes_done)}"
    text += f" of {size(counts.bytes)}, {failed} failed"
    if left is not None:
        hours, rest = divmod(round(left), 3600)
        text += f", {hours}:{rest // 60:02}:{rest % 60:02} left"
    return text


@contextmanager
def _progress(quiet: bool) -> Iterator[Callable[[Counts], None]]:
    """Yield a callback that shows progress: a live line on a terminal, else a line per minute."""
    import time

    terminal = sys.stderr.isatty()
    last = [0.0 if terminal else time.monotonic()]

    def report(counts: Counts) -> None:
        now = time.monotonic()
        if quiet or now - last[0] < (0.5 if terminal else 60.0):
            return
        last[0] = now
        end = "" if terminal else "\n"
        start = "\r\x1b[K" if terminal else "imucald: "
        print(f"{start}{_line(counts)}", end=end, file=sys.stderr, flush=True)

    yield report
    if terminal and not quiet:
        print("\r\x1b[K", end="", file=sys.stderr)


def _print_end(counts: Counts, whole: bool) -> int:
    failed = ", ".join(f"{kind} {n}" for kind, n in sorted(counts.failed.items()))
    text = f"imucald: {counted(counts.done, 'log')} evaluated"
    print(f"{text}{f'; failed: {failed}' if failed else ''}", file=sys.stderr)
    if not whole:
        left = counts.logs - counts.done
        print(
            f"imucald: stopped; {counted(left, 'log')} not evaluated. Run the same "
            "command to continue",
            file=sys.stderr,
        )
        return INTERRUPTED
    return SOME_FAILED if failed else 0
