"""The thread that saves: whatever a save raises, it is recorded, tried again and seen."""

from __future__ import annotations

import threading
import time

import pytest

from imucald.service.background_writer import StateWriter
from imucald.service.uds_records import DtcStore
from imucald.uds.host import FrameCounts, Symptoms


class Disk:
    """Takes contents, or raises what it was told to; one outcome a save."""

    def __init__(self, *outcomes: BaseException | None) -> None:
        self.outcomes = list(outcomes)
        self.written: list[str] = []
        self.attempts: list[str] = []

    def save(self, content: str) -> None:
        self.attempts.append(content)
        outcome = self.outcomes.pop(0) if self.outcomes else None
        if outcome is not None:
            raise outcome
        self.written.append(content)


class Log(list[str]):
    """Lines of the log."""

    def say(self, text: str, priority: int = 6) -> None:
        self.append(text)


def writer(disk: Disk, retry: float = 60.0) -> tuple[StateWriter[str], Log]:
    log = Log()
    return StateWriter(disk.save, "the state", log.say, retry), log


def wait_for_failure(saver: StateWriter[str]) -> None:
    end = time.monotonic() + 5.0
    while saver.failures == 0:
        assert time.monotonic() < end
        time.sleep(0.002)


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (OSError(28, "No space left on device"), "No space left on device"),
        (ValueError("Out of range float values"), "ValueError: Out of range float values"),
        (RecursionError("too deep"), "RecursionError: too deep"),
        (MemoryError(), "MemoryError"),
        (SystemExit(1), "SystemExit: 1"),
    ],
)
def test_whatever_a_save_raises_is_recorded_and_the_next_is_written(error, text):
    disk = Disk(error)
    saver, log = writer(disk)
    saver.put("a")
    wait_for_failure(saver)
    assert saver.status() == {"saves": 0, "failures": 1, "last_error": text}
    saver.report()
    saver.report()
    assert log == [f"the state cannot be saved: {text}; continuing without it"]
    saver.put("b")
    assert saver.flush(5.0)
    saver.report()
    assert disk.written == ["b"]
    assert saver.status() == {"saves": 1, "failures": 1, "last_error": ""}
    assert log[1:] == ["the state can be saved again"]


def test_what_failed_is_tried_again_by_itself():
    saved = threading.Event()
    disk = Disk(OSError("once"), ValueError("twice"))

    def save(content: str) -> None:
        disk.save(content)
        saved.set()

    saver = StateWriter(save, "the state", Log().say, retry=0.01)
    saver.put("a")
    assert saved.wait(5.0)
    assert saver.close(5.0)
    assert disk.attempts == ["a", "a", "a"]
    assert saver.failures == 2


def test_something_newer_takes_the_place_of_what_failed():
    disk = Disk(OSError("once"))
    saver, _ = writer(disk)
    saver.put("old")
    wait_for_failure(saver)
    saver.put("new")
    assert saver.close(5.0)
    assert disk.attempts == ["old", "new"]


def test_a_stop_tries_once_more_what_failed():
    disk = Disk(OSError("once"))
    saver, _ = writer(disk)
    saver.put("last")
    wait_for_failure(saver)
    assert saver.close(5.0)
    assert disk.written == ["last"]


def test_what_was_discarded_is_not_tried_again():
    disk = Disk(OSError("once"))
    saver, _ = writer(disk)
    saver.put("reset by a tester")
    wait_for_failure(saver)
    saver.discard()
    assert saver.flush(5.0)
    assert disk.written == []


def test_what_was_discarded_while_it_failed_is_not_tried_again():
    began, go_on = threading.Event(), threading.Event()
    attempts = []

    def save(content: str) -> None:
        attempts.append(content)
        began.set()
        go_on.wait(5.0)
        raise OSError("slow, then not at all")

    saver = StateWriter(save, "the state", Log().say, retry=0.0)
    saver.put("reset by a tester")
    assert began.wait(5.0)
    saver.discard()
    go_on.set()
    assert saver.close(5.0)
    assert attempts == ["reset by a tester"]


def test_a_flush_says_whether_the_newest_is_on_the_disk():
    disk = Disk(*[OSError("full")] * 3)
    saver, _ = writer(disk)
    saver.put("a")
    assert not saver.flush(5.0)
    assert disk.written == []


def test_a_thread_that_cannot_be_started_is_a_failure_and_is_tried_again(monkeypatch):
    disk = Disk()
    saver, log = writer(disk)
    with monkeypatch.context() as full:

        def refuse(_: threading.Thread) -> None:
            raise RuntimeError("can't start new thread")

        full.setattr(threading.Thread, "start", refuse)
        saver.put("a")
        saver.report()
    assert saver.failures == 1
    assert "can't start new thread" in log[0]
    saver.put("b")
    assert saver.close(5.0)
    assert disk.written == ["b"]


def test_codes_that_could_not_be_written_are_written_later_without_a_change(tmp_path):
    folder = tmp_path / "state"
    folder.write_text("a file where a folder should be")
    store = DtcStore(folder / "car.dtcs", Log().say)
    store.memory.update(0.0, Symptoms(usable=True, moved=True, missing={}, counts=FrameCounts()))
    store.update()
    assert store.writer is not None
    wait_for_failure(store.writer)
    assert store.status()["last_error"]
    folder.unlink()
    store.close()
    assert (folder / "car.dtcs").exists()
