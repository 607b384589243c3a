"""Services on a virtual bus, with a drive and a state folder, for the tests of the service."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import shuttle
from imucald.can.logs.log_reader import LogReader
from imucald.service.journal import Journal
from imucald.service.notify import Notifier
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service
from threads import in_a_thread

CHANNELS = itertools.count()


class Bench:
    """A folder with a drive, and services on a virtual bus, one after the other."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.config = shuttle.write(folder, cycles=3)
        self.log = io.StringIO()

    def service(self, notifier: Notifier | None = None) -> Service:
        options = ServiceOptions(
            self.config,
            interface="virtual",
            channel=f"service-{next(CHANNELS)}",
            state_folder=self.folder / "state",
            status_socket=self.folder / "status.sock",
            save_period=0.0,
        )
        return Service(options, Journal(self.log), notifier)

    def drive(self, service: Service) -> None:
        for chunk in LogReader([self.folder / "shuttle.log"]):
            service.engine.columns(chunk, keep=False)

    def edit(self, old: str, new: str) -> None:
        text = self.config.read_text()
        assert old in text
        self.config.write_text(text.replace(old, new))

    def another_drive(self, yaw_deg: float) -> None:
        """The next drive is of a sensor that sits otherwise."""
        text = self.config.read_text()
        shuttle.write(self.folder, cycles=6, yaw_deg=yaw_deg)
        self.config.write_text(text)


@contextmanager
def running(service: Service) -> Iterator[Service]:
    try:
        with in_a_thread(service.run, service.stop):
            yield service
    finally:
        service.close()
