"""Find the logs that a run must evaluate: the logs without a known outcome."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import msgspec

from imucald.core.text import encodable
from imucald.fleet.bundle import code_hash
from imucald.fleet.compaction import read_tables
from imucald.fleet.fleet_file import Fleet
from imucald.fleet.listing import Log, is_since
from imucald.fleet.store import Store
from imucald.fleet.tables import read_with_parts
from imucald.fleet.task import EVALUATE, OK, LogLimits, Task

SAMPLE = 20
"""If this number of first logs all fail for the same reason, the run is aborted: the cause is not
in the logs."""
Redo = Literal["nothing", "failed", "config", "all"]


class Options(msgspec.Struct, frozen=True, kw_only=True):
    """Options of a run. The defaults are the same as on the command line."""

    limits: LogLimits = LogLimits()
    redo: Redo = "nothing"
    since: str | None = None
    limit: int | None = None
    signals: bool = False
    function: str = EVALUATE


class Known(msgspec.Struct, frozen=True):
    """The known result of the log at an address, from an earlier run."""

    fingerprint: str
    run_key: str
    outcome: str


class Plan(msgspec.Struct):
    """The work of a run. other_configuration: number of logs that were evaluated earlier with
    another run_key."""

    tasks: list[tuple[Task, Log]]
    listed: int
    done: int = 0
    failed_before: int = 0
    other_configuration: int = 0

    @property
    def bytes(self) -> int:
        """Total size of the logs to evaluate."""
        return sum(log.bytes for _, log in self.tasks)


def known_sources(store: Store) -> dict[str, Known]:
    """Return the known results by address, from the tables. An address is missing if its row was
    lost with a damaged file (`set_damaged_aside`)."""
    table = read_tables(store, ("sources",))["sources"]
    names = ("source", "fingerprint", "run_key", "outcome", "log_key")
    columns = [table.column(n).to_pylist() for n in names]
    drives, failed = _values(store, "drives", "log_key"), _values(store, "failures", "source")
    return {
        s: Known(f, r, o)
        for s, f, r, o, key in zip(*columns, strict=True)
        if (key in drives if o == OK else s in failed)
    }


def _values(store: Store, table: str, column: str) -> set[str]:
    return set(read_with_parts(store, table, (column,))[0].column(column).to_pylist())


def planned(fleet: Fleet, store: Store, logs: Iterable[Log], options: Options) -> Plan:
    """Compare the listed logs with the known results, and return the plan. The first tasks are a
    sample of logs; the other tasks are sorted by size, the largest first."""
    known = known_sources(store)
    plan = Plan([], 0)
    for log in logs:
        task = task_of(fleet, log.source, log.bytes, options, store.url)
        task = msgspec.structs.replace(task, within=log.within)
        if options.since is not None and not is_since(log, task.date, options.since):
            continue
        plan.listed += 1
        if not _is_done(known.get(encodable(log.source)), log, task.bundle, options.redo, plan):
            plan.tasks.append((task, log))
    plan.tasks.sort(key=lambda pair: (-pair[1].bytes, pair[1].source))
    _sample_first(plan.tasks)
    if options.limit is not None:
        del plan.tasks[options.limit :]
    return plan


def task_of(fleet: Fleet, source: str, size: int, options: Options, out: str = "") -> Task:
    """Return the task of a log. Its vehicle and its configuration follow from the rules of the
    fleet."""
    vehicle, day, vehicle_type = fleet.named(source)
    vehicle_type = vehicle_type or fleet.facts(vehicle, day).get("type")
    return Task(
        source,
        fleet.bundle(vehicle_type).name,
        code_hash(),
        vehicle,
        day,
        size,
        options.limits,
        options.function,
        out if options.signals else None,
        fleet.settings.storage,
    )


def _sample_first(tasks: list[tuple[Task, Log]]) -> None:
    """Move a sample of logs of all sizes to the beginning. If all logs of the sample fail, the
    other logs will fail too."""
    step = len(tasks) // SAMPLE
    if step > 1:
        chosen = range(0, step * SAMPLE, step)
        tasks[:] = [tasks[i] for i in chosen] + [t for i, t in enumerate(tasks) if i not in chosen]


def _is_done(before: Known | None, log: Log, bundle: str, redo: Redo, plan: Plan) -> bool:
    if before is None or before.fingerprint != log.fingerprint or redo == "all":
        return False
    if before.run_key != bundle:
        if redo == "config" or before.outcome != OK:
            return False
        plan.other_configuration += 1
    elif before.outcome != OK:
        if redo == "failed":
            return False
        plan.failed_before += 1
    plan.done += 1
    return True
