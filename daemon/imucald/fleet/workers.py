"""Workers that evaluate logs: processes on this machine, any `concurrent.futures.Executor`, or a
Dask cluster.

A task never raises, hangs or kills its worker: it runs in its own child process, and its result is
an `Outcome`. Therefore all kinds of workers behave in the same way, and each failure belongs to
exactly one log.
"""

from __future__ import annotations

import queue
import socket
from collections.abc import Mapping, Sequence
from concurrent.futures import CancelledError, Executor, ThreadPoolExecutor
from typing import Any, Protocol

import msgspec

from imucald.core.text import encodable
from imucald.fleet.bundle import Bundle, unpack
from imucald.fleet.task import Outcome, Task
from imucald.fleet.template_client import close_templates, template_for


def run_one_log(task: Task) -> Outcome:
    """Evaluate one log in a child of this process. Always returns an outcome and never raises an
    error."""
    if encodable(task.source) != task.source:  # it cannot be sent to the child as JSON
        text = f"{encodable(task.source)}: a file or folder name in it is not UTF-8; rename it"
        return Outcome("unreadable", text)
    outcome = template_for(task.function).run(task)
    cost = msgspec.structs.replace(outcome.cost, worker=socket.gethostname())
    return msgspec.structs.replace(outcome, cost=cost)


class Workers(Protocol):
    """Interface of all workers: they accept tasks and return outcomes in any order."""

    @property
    def slots(self) -> int:
        """Approximate number of tasks that run at the same time. The number of a cluster may
        change."""
        ...

    def submit(self, tasks: Sequence[Task]) -> None:
        """Submit tasks. The call returns at once."""
        ...

    def finished(self, timeout: float) -> list[tuple[Task, Outcome | None]]:
        """Return the outcomes since the last call. Wait for the first outcome for at most `timeout`
        [s].

        An outcome is None if its task was cancelled before it began.
        """
        ...

    def call_back(self) -> None:
        """Cancel waiting tasks. Running tasks are finished."""
        ...

    def close(self) -> None:
        """Release all resources."""
        ...


class Futures:
    """The pending and finished futures of tasks, of the standard library or of Dask."""

    def __init__(self) -> None:
        self._ended: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._tasks: dict[int, tuple[Any, Task]] = {}

    def add_future(self, future: Any, task: Task) -> None:
        """Wait for a task's future."""
        self._tasks[id(future)] = future, task
        future.add_done_callback(self._ended.put)

    def ended(self, timeout: float) -> list[tuple[Any, Task]]:
        """Return the futures that ended since the last call. Wait for the first future for at most
        `timeout` [s]."""
        found: list[tuple[Any, Task]] = []
        try:
            while True:
                future = self._ended.get(timeout=0.0 if found else timeout)
                known = self._tasks.pop(id(future), None)
                if known is not None:
                    found.append(known)
        except queue.Empty:
            return found

    def cancel(self) -> None:
        """Cancel all tasks that have not begun."""
        for future, _ in list(self._tasks.values()):
            future.cancel()


class ExecutorWorkers:
    """Workers of any `concurrent.futures.Executor`.

    The function `here` returns workers that are threads on this machine.
    """

    def __init__(self, executor: Executor, slots: int) -> None:
        self.slots = slots
        self._executor = executor
        self._futures = Futures()

    @classmethod
    def here(cls, slots: int, bundles: Mapping[str, Bundle]) -> ExecutorWorkers:
        """Return workers on this machine: threads of this process, each of which waits for a child
        process."""
        unpack(bundles)
        return cls(ThreadPoolExecutor(slots, thread_name_prefix="log"), slots)

    def submit(self, tasks: Sequence[Task]) -> None:
        """Submit tasks to the executor."""
        for task in tasks:
            self._futures.add_future(self._executor.submit(run_one_log, task), task)

    def finished(self, timeout: float) -> list[tuple[Task, Outcome | None]]:
        """Return the outcomes since the last call."""
        return [(task, outcome_of(future)) for future, task in self._futures.ended(timeout)]

    def call_back(self) -> None:
        """Cancel waiting tasks."""
        self._futures.cancel()

    def close(self) -> None:
        """Begin no more tasks, and end the tasks that still run on this machine, because the
        interpreter waits for its threads."""
        self._executor.shutdown(wait=False, cancel_futures=True)
        close_templates()


def outcome_of(future: Any) -> Outcome | None:
    """Return the outcome of a task; None if the task was cancelled before it began."""
    try:
        found: Outcome = future.result()
    except CancelledError:
        return None
    except Exception as error:  # of the executor itself, such as KilledWorker
        text = "its worker process ended several times while this log was evaluated or waiting"
        return Outcome("crashed", f"{text}: {type(error).__name__}")
    return found
