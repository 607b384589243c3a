"""The driver of a run: it distributes logs, collects their outcomes, and is the only writer of
tables."""

from __future__ import annotations

import time
from collections import Counter, deque
from collections.abc import Callable
from typing import Any

import msgspec

from imucald.core.errors import ImucaldError
from imucald.fleet.columns import row_of
from imucald.fleet.compaction import compact
from imucald.fleet.drive_row import drive_values
from imucald.fleet.fleet_file import Fleet
from imucald.fleet.lease import Lease
from imucald.fleet.listing import Log
from imucald.fleet.plan import SAMPLE, Plan
from imucald.fleet.store import Store
from imucald.fleet.tables import parts, table_of, write_part
from imucald.fleet.task import OK, ONCE_MORE, OTHER_CODE, Outcome, Task
from imucald.fleet.workers import Workers

AHEAD = 2
"""Number of submitted tasks per running task. With this number, no worker waits, and few tasks wait
at the end."""
FLUSH_S = 60.0
"""Longest time between two flushes [s]."""
FLUSH_SHARE = 0.1
"""Longest time between two flushes, as a share of the run's time. A run that is killed after some
seconds therefore keeps most of its results, and a long run writes no more parts."""
LOOK_S = 0.5
TRIES = 2

ORDER_OF_WRITING = ("costs", "events", "failures", "drives", "sources")


class Counts(msgspec.Struct):
    """Progress of a run."""

    logs: int
    bytes: int
    done: int = 0
    bytes_done: int = 0
    failed: Counter[str] = msgspec.field(default_factory=Counter)
    began: float = msgspec.field(default_factory=time.monotonic)
    stopping: bool = False

    @property
    def left_s(self) -> float | None:
        """Estimated remaining time [s], from the number of bytes processed so far; None before the
        first log is finished."""
        if self.bytes_done <= 0 or self.done < 1:
            return None
        passed = time.monotonic() - self.began
        return passed * max(self.bytes - self.bytes_done, 0) / self.bytes_done


class AllFailedError(ImucaldError):
    """Raised when the first logs all failed for one reason."""


class FleetRun:
    """One run that writes to one folder. `go` performs the run. An object is used only once."""

    def __init__(
        self,
        fleet: Fleet,
        store: Store,
        workers: Workers,
        plan: Plan,
        report: Callable[[Counts], None] = lambda _: None,
    ) -> None:
        self._fleet, self._store, self._workers, self._report = fleet, store, workers, report
        self._logs: dict[str, Log] = {task.source: log for task, log in plan.tasks}
        self._waiting = deque(task for task, _ in plan.tasks)
        self._again: deque[Task] = deque()
        self._running = 0
        self._attempts: Counter[str] = Counter()
        self._rows: dict[str, list[dict[str, Any]]] = {name: [] for name in ORDER_OF_WRITING}
        self._flushed = time.monotonic()
        self._number = 0
        self.counts = Counts(len(plan.tasks), plan.bytes)

    def stop(self) -> None:
        """Begin no further logs. Logs in progress are finished. Called by a signal handler."""
        self.counts.stopping = True

    def go(self, lease: Lease) -> bool:
        """Evaluate all logs. Return whether no log is left. Raises AllFailedError, and ImucaldError
        for storage errors."""
        self._store.tidy()
        self._number = max(
            (n for name in self._rows for n, _ in parts(self._store, name)), default=0
        )
        try:
            self._rounds(lease, self._waiting)
            self._rounds(lease, self._again, alone=True)  # alone: no other log is the reason
        finally:
            self._flush()
        compact(self._store)
        return not (self._waiting or self._again)

    def _rounds(self, lease: Lease, waiting: deque[Task], alone: bool = False) -> None:
        called_back = False
        while self._running or (waiting and not self.counts.stopping):
            if self.counts.stopping and not called_back:
                self._workers.call_back()
                called_back = True
            free = 0
            if waiting and not self.counts.stopping:
                free = (1 if alone else AHEAD * self._workers.slots) - self._running
            tasks = [waiting.popleft() for _ in range(min(free, len(waiting)))]
            if tasks:
                self._workers.submit(tasks)
                self._running += len(tasks)
            for task, outcome in self._workers.finished(LOOK_S):
                self._running -= 1
                if outcome is None:
                    waiting.appendleft(task)
                else:
                    self._take(task, outcome)
            now = time.monotonic()
            if now - self._flushed > min(FLUSH_S, FLUSH_SHARE * (now - self.counts.began)):
                self._flush()
            lease.beat()
            self._report(self.counts)

    def _take(self, task: Task, outcome: Outcome) -> None:
        if outcome.kind == OTHER_CODE:
            raise ImucaldError(
                f"{outcome.cost.worker}: this worker has another version of imucald than this "
                "machine; install the same version there, then run the same command to "
                "continue"
            )
        outcome = self._fitting_or_bug(task, outcome)
        self._attempts[task.source] += 1
        attempt = self._attempts[task.source]
        cost = msgspec.structs.asdict(outcome.cost)
        self._add(
            "costs", task, **cost, outcome=outcome.kind, attempt=attempt, finished=time.time()
        )
        if outcome.kind in ONCE_MORE and attempt < TRIES:
            self._again.append(task)
            return
        self.counts.done += 1
        self.counts.bytes_done += task.bytes
        self._add(
            "sources",
            task,
            fingerprint=self._logs[task.source].fingerprint,
            outcome=outcome.kind,
            log_key=outcome.log_key,
        )
        if outcome.kind == OK and outcome.drive is not None:
            self._take_drive(task, outcome, outcome.drive)
        else:
            self._take_failure(task, outcome, attempt)

    def _fitting_or_bug(self, task: Task, outcome: Outcome) -> Outcome:
        """Return the outcome. If its rows do not fit a table, return an outcome of the kind `bug`
        instead, so that the rows of other logs can be written."""
        if outcome.drive is None:
            return outcome
        try:
            values = drive_values(self._fleet, task, outcome.log_key, outcome.drive)
            table_of("drives", [row_of("drives", values)])
            table_of("events", [row_of("events", event) for event in outcome.events])
        except Exception as error:  # any error from the values of a log
            text = f"{task.source}: its row does not fit the table: {type(error).__name__}: {error}"
            return Outcome("bug", text, outcome.log_key, cost=outcome.cost)
        return outcome

    def _take_drive(self, task: Task, outcome: Outcome, drive: dict[str, Any]) -> None:
        twice = any(row["log_key"] == outcome.log_key for row in self._rows["drives"])
        self._add("drives", task, **drive_values(self._fleet, task, outcome.log_key, drive))
        if not twice:
            for event in outcome.events:
                self._add("events", task, **event, log_key=outcome.log_key)

    def _take_failure(self, task: Task, outcome: Outcome, attempt: int) -> None:
        self.counts.failed[outcome.kind] += 1
        self._add(
            "failures",
            task,
            kind=outcome.kind,
            log_key=outcome.log_key,
            message=outcome.message,
            traceback=outcome.traceback or None,
            exit_code=outcome.exit_code,
            attempts=attempt,
        )
        failed = self.counts.failed
        if self.counts.done == failed[outcome.kind] == SAMPLE:
            self.stop()
            raise AllFailedError(
                f"the first {SAMPLE} logs all failed: {outcome.kind}. The last of them: "
                f"{outcome.message}. Correct this, then run the same command to continue"
            )

    def _add(self, table: str, task: Task, **values: object) -> None:
        about = {"source": task.source, "vehicle": task.vehicle, "run_key": task.bundle}
        self._rows[table].append(row_of(table, {**about, "bytes": task.bytes, **values}))

    def _flush(self) -> None:
        self._flushed = time.monotonic()
        if not any(self._rows.values()):
            return
        self._number += 1
        for name in ORDER_OF_WRITING:
            write_part(self._store, name, self._number, self._rows[name])
            self._rows[name].clear()
