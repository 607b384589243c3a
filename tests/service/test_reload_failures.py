"""A reload that fails, in whatever way and wherever, changes nothing; the loop goes on in it."""

from __future__ import annotations

import io
import itertools
import os
import threading
import time
from pathlib import Path

import pytest

import shuttle
from imucald.can.dbc import bounded_parser, database
from imucald.service import parts as parts_module
from imucald.service.calibration_store import CalibrationStore
from imucald.service.journal import Journal
from imucald.service.notify import Notifier
from imucald.service.parts import ServiceOptions
from imucald.service.reloading import LONG_S, Reloading
from imucald.service.service import Service

OTHER_VEHICLE = "vehicle: {id: another}\ndatabase:"


class Bench:
    def __init__(self, folder: Path) -> None:
        self.config = shuttle.write(folder, cycles=1)
        self.good = self.config.read_text()
        self.log = io.StringIO()
        options = ServiceOptions(
            self.config,
            interface="virtual",
            channel=f"reload-{time.monotonic_ns()}",
            state_folder=folder / "state",
        )
        self.service = Service(options, Journal(self.log))

    def everything(self) -> tuple[object, ...]:
        """All that a reload may put another in the place of."""
        service = self.service
        return (
            service.engine,
            service.engine.pipeline.estimator,
            service.link,
            service.daemon.link,
            service.loaded,
            service.parts.diagnostics.uds,
            service.parts.diagnostics.dtc_store,
            service.parts.calibration_store,
            service.daemon.stopping,
        )

    def write(self, old: str, new: str) -> None:
        assert old in self.good
        self.config.write_text(self.good.replace(old, new))


@pytest.fixture
def bench(tmp_path):
    made = Bench(tmp_path)
    yield made
    made.service.close()


def refuse(*_: object, **__: object) -> None:
    raise RuntimeError("something nobody thought of")


@pytest.mark.parametrize(
    "text", ["[" * 30_000, "database: [" * 5000, "a: 1" + ":1" * 400_000, "\0", "", "&a [*a]"]
)
def test_a_hostile_configuration_changes_nothing(text, bench):
    before = bench.everything()
    bench.config.write_text(text)
    bench.service.reload()
    assert bench.everything() == before
    assert bench.log.getvalue().count("not reloaded") >= 1


@pytest.mark.parametrize("what", ["pipe", "device", "folder", "nothing"])
def test_a_configuration_that_is_no_file_any_more_changes_nothing(what, bench):
    before = bench.everything()
    bench.config.unlink()
    if what == "pipe":
        os.mkfifo(bench.config)
    elif what == "device":
        bench.config.symlink_to("/dev/zero")
    elif what == "folder":
        bench.config.mkdir()
    bench.service.reload()
    assert bench.everything() == before
    assert "not reloaded" in bench.log.getvalue()


@pytest.mark.parametrize(
    ("owner", "name"),
    [
        (parts_module, "open_config"),
        (parts_module, "make_engine"),
        (parts_module, "open_link"),
        (parts_module, "behind_the_known"),
        (CalibrationStore, "restore"),
        (parts_module.PartsMaker, "_new_diagnostics"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_wherever_it_breaks_nothing_has_changed_and_the_next_one_works(
    owner, name, bench, monkeypatch
):
    before = bench.everything()
    change = "accelerometer_bias: 0.03" if name == "behind_the_known" else None
    if change:
        bench.write("accelerometer_bias: 0.02", change)
    else:
        bench.write("database:", OTHER_VEHICLE)
        bench.config.write_text(
            bench.config.read_text().replace("status_rate: 10", "ids: {acceleration: 0x650}")
        )
    with monkeypatch.context() as broken:
        broken.setattr(owner, name, refuse)
        bench.service.reload()
    if "not reloaded" not in bench.log.getvalue():
        pytest.skip(f"{name} was not needed")
    assert bench.everything() == before
    assert "RuntimeError: something nobody thought of" in bench.log.getvalue()
    bench.service.reload()
    assert "was read again" in bench.log.getvalue()
    assert bench.service.engine is not before[0]


@pytest.mark.slow
def test_the_loop_goes_on_while_a_large_database_is_read(bench, monkeypatch):
    """A parser that takes long (here: until it is let go) holds up no turn of the loop."""
    database._remembered.cache_clear()  # else nothing is parsed
    go_on, asked = threading.Event(), threading.Event()
    parse = bounded_parser.parse

    def slow(*arguments: str):
        asked.set()
        assert go_on.wait(20.0)
        return parse(*arguments)

    monkeypatch.setattr(bounded_parser, "parse", slow)
    service = bench.service
    before = service.engine
    turns: list[float] = []
    feed = service.notifier.feed
    monkeypatch.setattr(service.notifier, "feed", lambda: (turns.append(time.monotonic()), feed()))
    loop = threading.Thread(target=service.run)
    loop.start()
    try:
        service.ask_reload()
        assert asked.wait(5.0)
        time.sleep(1.0)
        assert service.engine is before
        during = [b - a for a, b in itertools.pairwise(turns)]
        assert len(during) > 3
        assert max(during) < 0.5
        go_on.set()
        end = time.monotonic() + 10.0
        while service.engine is before:
            assert time.monotonic() < end
            time.sleep(0.02)
    finally:
        go_on.set()
        service.stop()
        loop.join(5.0)


def test_a_key_without_effect_is_in_the_log_after_a_reload(bench):
    bench.write("calibration:", "calibration:\n  straight: {steering_limit_deg: 5}")
    assert "has no effect" not in bench.log.getvalue()
    bench.service.reload()
    assert "steering_limit_deg: has no effect without signals" in bench.log.getvalue()


def test_a_bus_before_that_cannot_be_closed_is_reported_and_the_reload_is_done(bench, monkeypatch):
    before = bench.service.link
    bench.write("status_rate: 10", "ids: {acceleration: 0x650}")
    monkeypatch.setattr(before, "close", refuse)
    bench.service.reload()
    assert bench.service.link is not before
    assert "not reloaded" not in bench.log.getvalue()
    assert "was read again" in bench.log.getvalue()
    assert (
        "the tasks from before the reload could not be stopped (RuntimeError"
        in bench.log.getvalue()
    )
    monkeypatch.undo()
    before.close()


class Hanging:
    """Reading that takes until it is let go, and a clock that moves when told."""

    def __init__(self) -> None:
        self.log = io.StringIO()
        self.go_on = threading.Event()
        self.now = 0.0
        self.taken: list[str] = []
        self.reloading = Reloading(
            self.read, self.taken.append, Journal(self.log), Notifier({}), lambda: self.now
        )

    def read(self) -> str:
        assert self.go_on.wait(20.0)
        return "read"

    def wait_for(self, count: int) -> None:
        end = time.monotonic() + 5.0
        while len(self.taken) < count:
            self.reloading.poll()
            assert time.monotonic() < end
            time.sleep(0.005)


def test_a_reload_that_waits_for_one_that_hangs_is_reported_once_and_done_in_the_end():
    made = Hanging()
    made.reloading.ask()
    for _ in range(3):
        made.reloading.poll()
    assert made.log.getvalue() == ""
    made.now = 7.0
    made.reloading.ask()
    for _ in range(5):
        made.reloading.poll()
    assert made.log.getvalue().count("the reload must wait") == 1
    assert "still being read after 7 s" in made.log.getvalue()
    made.go_on.set()
    made.wait_for(2)
    assert "not reloaded" not in made.log.getvalue()


def test_a_reload_that_hangs_is_reported_though_nobody_asks_for_another():
    made = Hanging()
    made.reloading.ask()
    made.reloading.poll()
    made.now = LONG_S - 1.0
    made.reloading.poll()
    assert made.log.getvalue() == ""
    made.now = LONG_S + 1.0
    for _ in range(5):
        made.reloading.poll()
    assert made.log.getvalue().count("perhaps a disk or network drive does not answer") == 1
    made.go_on.set()
    made.wait_for(1)
