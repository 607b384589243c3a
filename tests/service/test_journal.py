"""The log: closed, blocked or full, it neither ends nor holds up who writes it."""

from __future__ import annotations

import io
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

import shuttle
from imucald.can.link.link import LinkEvent, LinkState
from imucald.commands.run import LOG_LEVELS
from imucald.runtime.session import make_engine, open_config
from imucald.service.announcements import Announcements
from imucald.service.asking import ask
from imucald.service.journal import (
    ERROR,
    INFO,
    LINE_BYTES,
    NOTICE,
    PRIORITIES,
    WARNING,
    Journal,
)


def pipe_journal() -> tuple[int, Journal]:
    """A journal into a pipe that nobody reads yet, and the end to read."""
    reader, writer = os.pipe()
    return reader, Journal(os.fdopen(writer, "w"), {})


def test_a_pipe_that_nobody_reads_drops_lines_and_shows_their_number_later():
    reader, journal = pipe_journal()
    began = time.monotonic()
    for i in range(2000):
        journal.say(f"{i} " + "x" * 200)
    assert time.monotonic() - began < 1.0
    assert 1000 < journal.dropped < 2000
    written = 2000 - journal.dropped
    assert os.read(reader, 1 << 20).count(b"\n") == written
    journal.say("again")
    said = os.read(reader, 1 << 20).decode()
    assert said == f"imucald: {journal.dropped} lines could not be written\nimucald: again\n"


def test_a_socket_that_nobody_reads_does_not_block_either():
    ours, theirs = socket.socketpair()
    journal = Journal(os.fdopen(os.dup(ours.fileno()), "w"), {})
    began = time.monotonic()
    for _ in range(20_000):
        journal.say("x" * 200)
    assert time.monotonic() - began < 5.0
    assert journal.dropped > 0
    assert theirs.recv(209) == b"imucald: " + b"x" * 200
    assert ours.getblocking(), "others may write to the same file"


def test_a_closed_and_a_broken_log_are_counted_and_raise_nothing(monkeypatch):
    monkeypatch.setattr(sys, "stderr", None)
    closed = Journal()
    closed.say("nobody hears this")
    reader, broken = pipe_journal()
    os.close(reader)
    broken.say("nor this")
    with Path("/dev/full").open("w") as nowhere:
        full = Journal(nowhere, {})
        full.say("nor this")
    assert [journal.dropped for journal in (closed, broken, full)] == [1, 1, 1]


def test_a_level_writes_what_is_as_important_and_events_keep_every_line():
    text = io.StringIO()
    journal = Journal(text, {}, level=WARNING)
    for priority in (ERROR, WARNING, NOTICE, INFO):
        journal.say(f"priority {priority}", priority)
    assert text.getvalue() == "imucald: priority 3\nimucald: priority 4\n"
    assert [event.level for event in journal.events] == ["error", "warning", "notice", "info"]
    assert tuple(PRIORITIES) == LOG_LEVELS


def test_a_line_is_cut_where_a_pipe_could_block():
    reader, journal = pipe_journal()
    journal.say("x" * 100_000)
    assert len(os.read(reader, 1 << 20)) == LINE_BYTES + 1
    journal.say("\udcff is no UTF-8")
    assert os.read(reader, 100) == b"imucald: \\udcff is no UTF-8\n"


@pytest.mark.slow
@pytest.mark.parametrize("how", ["closed", "blocked"])
def test_the_daemon_runs_whatever_becomes_of_standard_error(how, tmp_path):
    config = shuttle.write(tmp_path, cycles=1)
    options = f"run --config {config} --interface virtual --channel x --seconds 1.5"
    command = f"exec {sys.executable} -m imucald {options} --status-socket {tmp_path}/s"
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    try:
        while True:
            os.write(writer, b"x" * 4096)
    except BlockingIOError:
        os.set_blocking(writer, True)
    end = "2>&-" if how == "closed" else ""
    began = time.monotonic()
    process = subprocess.Popen(
        ["/bin/sh", "-c", f"{command} {end}"], stderr=writer, stdout=subprocess.DEVNULL
    )
    try:
        while not (tmp_path / "s").exists():
            assert time.monotonic() - began < 20.0
            assert process.poll() is None, "it ended before its first frame"
            time.sleep(0.02)
        said = ask(tmp_path / "s", "status")
        assert process.wait(20.0) == 0
    finally:
        process.kill()
        process.wait()
        os.close(reader)
        os.close(writer)
    assert '"log_lines_dropped": ' in said
    assert '"log_lines_dropped": 0' not in said


def test_an_interface_that_comes_and_goes_for_hours_writes_few_lines_and_its_last_state(tmp_path):
    now, hours, log = [0.0], 1, io.StringIO()
    announcements = Announcements(Journal(log, {}, clock=lambda: now[0]))
    engine = make_engine(open_config(shuttle.write(tmp_path, cycles=1)))

    def lines() -> list[str]:
        return [line for line in log.getvalue().splitlines() if "can0" in line]

    for second in range(hours * 3600):
        now[0] = float(second)
        for state in (LinkState.DOWN, LinkState.UP):
            announcements.link_event(LinkEvent(str(state), f"can0 is {state}, flap {second}"))
        announcements.update(engine, 0, now[0])
    assert 20 < len(lines()) < hours * 3600 / 30 + 25
    assert "such lines omitted before" in lines()[-1]
    now[0] += 31.0
    announcements.update(engine, 0, now[0])
    assert f"can0 is up, flap {hours * 3600 - 1} (" in lines()[-1]
    announcements.link_event(LinkEvent("conflict", "another node"))
    assert "another node" in log.getvalue().splitlines()[-1]
