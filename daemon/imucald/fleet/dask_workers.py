"""A Dask cluster as workers: `--scheduler tcp://HOST:PORT` or `tls://HOST:PORT`."""

from __future__ import annotations

import contextlib
import logging
import platform
import time
import uuid
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy
from distributed import Client, Worker, WorkerPlugin
from distributed.security import Security

from imucald import __version__
from imucald.core.errors import ImucaldError
from imucald.fleet.bundle import Bundle, code_hash, unpack
from imucald.fleet.task import Outcome, Task
from imucald.fleet.template_client import close_templates
from imucald.fleet.workers import Futures, outcome_of, run_one_log

WORKERS_S = 60.0
"""Longest wait for the first worker [s]."""
TRIES, AGAIN_S = 5, 1.0
"""Number of tries, and pause between them, to prepare the workers of a changing cluster."""
GONE = ("closed", "closing", "failed", "connecting")
"""States of a client that has lost its scheduler. The client would wait for a new scheduler, but a
new scheduler does not know the tasks."""
SCHEDULER_GONE = (
    "the Dask scheduler has ended; start it again, then run the same command to continue"
)


@dataclass(frozen=True)
class TlsFiles:
    """Paths of PEM files: certificate authority, certificate of this client, key of this client."""

    ca: str
    certificate: str
    key: str

    def security(self) -> Security:
        """Return the files as the object `Security` of Dask. All connections are encrypted."""
        return Security(  # type: ignore[no-untyped-call]
            tls_ca_file=self.ca,
            tls_client_cert=self.certificate,
            tls_client_key=self.key,
            require_encryption=True,
        )


_client: Any = Client
"""The class of Dask's client, as Any because it has no type hints."""


class BundlePlugin(WorkerPlugin):
    """Sends the bundles to each worker, including workers that join later."""

    name = "imucald-fleet"

    def __init__(self, bundles: Mapping[str, Bundle]) -> None:
        self._bundles = dict(bundles)

    def setup(self, worker: Worker) -> None:
        """Unpack the bundles in the folder from which the child processes of this worker read
        them."""
        unpack(self._bundles)
        close_templates()  # a template that runs already does not know the folder


def about_worker() -> dict[str, str]:
    """Return the versions that must be equal on driver and workers, so that all rows are computed
    in the same way."""
    return {
        "imucald": __version__,
        "code of imucald": code_hash(),
        "Python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


class DaskWorkers:
    """The workers of one Dask cluster. Raises ImucaldError if the cluster cannot be used."""

    def __init__(
        self, address: str, bundles: Mapping[str, Bundle], tls: TlsFiles | None = None
    ) -> None:
        if address.startswith("tls://") and tls is None:
            raise ImucaldError(f"{address}: needs --tls-ca, --tls-cert and --tls-key")
        self._futures = Futures()
        # our own errors contain the important facts
        for name in ("distributed", "distributed.client", "tornado.application"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
        security = None if tls is None else tls.security()
        try:
            self._client: Any = _client(address, security=security, timeout=30.0)
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            raise ImucaldError(f"{address}: no Dask scheduler answers: {error}") from None
        try:
            self._prepared(address, bundles)
        except BaseException:
            self._client.close()
            raise

    def _prepared(self, address: str, bundles: Mapping[str, Bundle]) -> None:
        """Prepare the workers. If a worker disappears in the meantime, try again."""
        for left in reversed(range(TRIES)):
            try:
                self._prepare(address, bundles)
            except OSError as error:  # Dask's CommClosedError is one
                if left == 0:
                    text = f"{address}: every worker left before it was prepared: {error}"
                    raise ImucaldError(text) from None
                time.sleep(AGAIN_S)
            else:
                return

    def _prepare(self, address: str, bundles: Mapping[str, Bundle]) -> None:
        try:
            self._client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError:
            raise ImucaldError(f"{address}: has no workers") from None
        mine = about_worker()
        try:
            answers: dict[str, Any] = self._client.run(about_worker)
        except OSError:
            raise
        except Exception as error:
            raise ImucaldError(
                f"{address}: its workers do not have this version of imucald "
                f"({type(error).__name__}: {error}); install it there"
            ) from None
        for worker, theirs in sorted(answers.items()):
            for what, version in mine.items():
                if theirs.get(what) != version:
                    raise ImucaldError(
                        f"{address}: {worker} has {what} {theirs.get(what)}, but this machine "
                        f"has {version}, so results would depend on the worker; install the "
                        "same version everywhere"
                    )
        self._client.register_plugin(BundlePlugin(bundles))

    @property
    def slots(self) -> int:
        """Number of threads of all present workers."""
        with self._scheduler_asked():
            threads: dict[str, int] = self._client.nthreads()
        return max(1, sum(threads.values()))

    def submit(self, tasks: Sequence[Task]) -> None:
        """Submit tasks to the cluster."""
        # not the path of a log: for an equal key, Dask would return the old result
        keys = [f"imucald-log-{uuid.uuid4().hex}" for _ in tasks]
        with self._scheduler_asked():
            futures = self._client.map(run_one_log, list(tasks), key=keys, pure=False)
        for future, task in zip(futures, tasks, strict=True):
            self._futures.add_future(future, task)

    def finished(self, timeout: float) -> list[tuple[Task, Outcome | None]]:
        """Return the outcomes since the last call, and release their data on the cluster."""
        found = []
        with self._scheduler_asked():
            pass
        for future, task in self._futures.ended(timeout):
            is_cancelled = future.status == "cancelled"
            found.append((task, None if is_cancelled else outcome_of(future)))
            future.release()
        return found

    def call_back(self) -> None:
        """Do nothing, because Dask does not report which of its few waiting tasks have begun."""

    def close(self) -> None:
        """Disconnect from the cluster. Do not wait if the scheduler is gone."""
        is_gone = self._client.status in GONE
        with contextlib.suppress(OSError, TimeoutError, RuntimeError):
            self._client.close(timeout=0 if is_gone else 5.0)

    @contextlib.contextmanager
    def _scheduler_asked(self) -> Iterator[None]:
        """Context for requests to the scheduler. Raises ImucaldError if the scheduler is gone
        (Dask's CommClosedError, an OSError)."""
        if self._client.status in GONE:
            raise ImucaldError(SCHEDULER_GONE)
        try:
            yield
        except (OSError, TimeoutError, RuntimeError):
            raise ImucaldError(SCHEDULER_GONE) from None
