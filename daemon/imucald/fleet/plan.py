"""Which logs a run has to evaluate: those whose outcome is not known yet."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Literal

import msgspec

from imucald.fleet.bundle import code_hash
from imucald.fleet.compaction import read_tables
from imucald.fleet.fleet_file import Fleet
from imucald.fleet.listing import Log, is_since
from imucald.fleet.store import Store
from imucald.fleet.task import OK, Limits, Task

Redo = Literal["nothing", "failed", "config", "all"]


class Options(msgspec.Struct, frozen=True, kw_only=True):
    """How a run is done; the defaults are those of the command line."""

    limits: Limits = Limits()
    redo: Redo = "nothing"
    since: str | None = None
    limit: int | None = None
    signals: bool = False
    function: str = "imucald.fleet.evaluation:evaluate"


class Known(msgspec.Struct, frozen=True):
    """What an earlier run says of an address."""

    fingerprint: str
    run_key: str
    outcome: str


class Plan(msgspec.Struct):
    """What a run is going to do. other_configuration: done before, with another run_key."""

    tasks: list[tuple[Task, Log]]
    listed: int
    done: int = 0
    failed_before: int = 0
    other_configuration: int = 0

    @property
    def bytes(self) -> int:
        """Of the logs to evaluate."""
        return sum(log.bytes for _, log in self.tasks)


def known_sources(store: Store) -> dict[str, Known]:
    """What the tables say of each address."""
    table = read_tables(store, ("sources",))["sources"]
    columns = [
        table.column(n).to_pylist() for n in ("source", "fingerprint", "run_key", "outcome")
    ]
    return {s: Known(f, r, o) for s, f, r, o in zip(*columns, strict=True)}


def planned(fleet: Fleet, store: Store, logs: Iterable[Log], options: Options) -> Plan:
    """Compare what there is with what is known; the largest logs come first."""
    known = known_sources(store)
    plan = Plan([], 0)
    for log in logs:
        vehicle, day, vehicle_type = fleet.named(log.source)
        if options.since is not None and not is_since(log, day, options.since):
            continue
        plan.listed += 1
        vehicle_type = vehicle_type or fleet.facts(vehicle, day).get("type")
        bundle = fleet.bundle(vehicle_type).name
        if _is_done(known.get(log.source), log, bundle, options.redo, plan):
            continue
        task = Task(
            log.source,
            bundle,
            code_hash(),
            vehicle,
            day,
            log.bytes,
            options.limits,
            options.function,
            f"{store.url}/signals" if options.signals else None,
            fleet.settings.storage,
        )
        plan.tasks.append((task, log))
    plan.tasks.sort(key=lambda pair: (-pair[1].bytes, pair[1].source))
    if options.limit is not None:
        del plan.tasks[options.limit :]
    return plan


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
