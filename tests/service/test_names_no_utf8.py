"""A daemon whose files have names that are no UTF-8: whoever asks gets an answer, nothing ends."""

from __future__ import annotations

import io
import json
import os
import shutil
import socket
import time
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from imucald.core.errors import LinkError
from imucald.core.text import encodable
from imucald.service.asking import ask
from imucald.service.exposition import gathered
from imucald.service.journal import Journal
from imucald.service.line_server import LineServer
from imucald.service.notify import Notifier
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service
from imucald.service.status import StatusServer
from service_bench import Bench, running

BYTE = os.fsdecode(b"\xff")


@pytest.fixture
def service(tmp_path: Path) -> Service:
    """Configuration, database, channel and state folder have such names."""
    bench = Bench(tmp_path)
    config = tmp_path / f"car-{BYTE}.yaml"
    shutil.move(bench.config, config)
    database = tmp_path / f"car-{BYTE}.dbc"
    shutil.move(tmp_path / "shuttle.dbc", database)
    options = ServiceOptions(
        config,
        databases=[database],
        interface="virtual",
        channel=f"can{BYTE}-{time.monotonic_ns()}",
        state_folder=tmp_path / f"state-{BYTE}",
        status_socket=tmp_path / "s",
    )
    return Service(options, Journal(io.StringIO()))


def test_status_events_metrics_and_orders_are_answered(service, tmp_path):
    config = service.options.config
    with running(service):
        status = json.loads(ask(tmp_path / "s", "status"))
        assert status["config"] == encodable(str(config))
        assert status["saved_state"]["folder"] == encodable(str(service.options.state_folder))
        metrics = ask(tmp_path / "s", "metrics")
        families = list(text_string_to_metric_families(metrics))
        assert families[0].samples[0].labels["bus"] == encodable(service.link.channel)
        assert gathered([tmp_path / "s"]).splitlines()[2].endswith(" 1")
        config.write_text("[")
        service.ask_reload()
        end = time.monotonic() + 5.0
        while "not reloaded" not in (events := ask(tmp_path / "s", "events")):
            assert time.monotonic() < end
        assert any(encodable(config.name) in e["text"] for e in json.loads(events)["events"])
        assert service.sockets.control is not None
        answer = json.loads(ask(service.sockets.control.path, '{"order": "release"}'))
        assert "not held" in answer["error"]


def test_an_order_that_is_refused_with_such_a_name_is_answered(service, tmp_path):
    def reset(_: str) -> str:
        raise LinkError(f"{service.options.config} is to blame")

    service.orders.reset = reset  # type: ignore[method-assign]
    with running(service):
        assert service.sockets.control is not None
        answer = json.loads(ask(service.sockets.control.path, '{"order": "reset"}'))
        assert answer["error"] == encodable(f"{service.options.config} is to blame")


def test_the_metrics_of_a_daemon_that_does_not_answer_can_be_written(tmp_path):
    text = gathered([tmp_path / f'imucald-{BYTE}"x.sock'])
    text.encode()
    (family,) = text_string_to_metric_families(text)
    assert family.samples[0].labels["bus"] == encodable(f'{BYTE}"x')


def test_systemd_gets_every_status_line(tmp_path):
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(str(tmp_path / "n"))
        Notifier({"NOTIFY_SOCKET": str(tmp_path / "n")}).status(f"bus {BYTE}")
        assert systemd.recv(100) == b"STATUS=bus \\udcff"


def test_a_status_that_cannot_be_made_costs_its_client_the_answer_and_is_reported_once(tmp_path):
    said: list[str] = []
    failures = iter([ZeroDivisionError("1/0"), ZeroDivisionError("2/0"), KeyError("x")])

    def status() -> dict[str, object]:
        raise next(failures)

    server = StatusServer(tmp_path / "s", status, say=lambda text, _: said.append(text))
    try:
        for expected in (1, 1, 2):
            assert asked(server, b"status\n") == b""
            assert len(said) == expected
        assert "could not be answered (ZeroDivisionError: 1/0)" in said[0]
        assert b'"events"' in asked(server, b"events\n")
    finally:
        server.close()


def asked(server: LineServer, line: bytes) -> bytes:
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.connect(str(server.path))
        client.sendall(line)
        server.poll()
        client.settimeout(1.0)
        return client.recv(4096)
