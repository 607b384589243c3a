"""A run as a process of its own that can be killed: FLEET OUT [SCHEDULER CA CERT KEY].

It says "leased" when the folder is its own, and "evaluated" when the first log is.
"""

from __future__ import annotations

import sys
from pathlib import Path

from poison import FUNCTION

from imucald.fleet.dask_workers import DaskWorkers, TlsFiles
from imucald.fleet.driver import Counts, FleetRun
from imucald.fleet.fleet_file import load_fleet
from imucald.fleet.lease import Lease
from imucald.fleet.listing import list_logs
from imucald.fleet.plan import Options, planned
from imucald.fleet.store import Store
from imucald.fleet.task import LogLimits
from imucald.fleet.workers import ExecutorWorkers, Workers


def main(fleet_path: str, out: str, *cluster: str) -> None:
    fleet = load_fleet(Path(fleet_path))
    store = Store(out)
    options = Options(limits=LogLimits(time_s=3.0), function=FUNCTION)
    said = False

    def report(counts: Counts) -> None:
        nonlocal said
        if counts.done and not said:
            said = True
            print("evaluated", flush=True)

    with Lease(store) as lease:
        print("leased", flush=True)
        workers: Workers
        if cluster:
            workers = DaskWorkers(cluster[0], fleet.bundles, TlsFiles(*cluster[1:]))
        else:
            workers = ExecutorWorkers.here(2, fleet.bundles)
        try:
            plan = planned(fleet, store, list_logs(fleet), options)
            FleetRun(fleet, store, workers, plan, report).go(lease)
        finally:
            workers.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
