"""The service around the loop: warm start, reload, status, what systemd hears."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

import shuttle
from imucald.can.logs.log_reader import LogReader
from imucald.commands.status import find_socket
from imucald.core.errors import LinkError
from imucald.mount.restored import RestoredEstimator
from imucald.service.asking import ask, default_socket
from imucald.service.journal import Journal
from imucald.service.line_server import KEPT_FOR_OWNER
from imucald.service.notify import Notifier
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service
from imucald.service.status import StatusServer
from service_bench import Bench, running

ACCEL = bytes.fromhex("0000000027130000")


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def calibrated(bench: Bench) -> tuple[float, ...]:
    """Drive, stop in order, and return the rotation that was in force."""
    service = bench.service()
    bench.drive(service)
    correction = service.engine.pipeline.estimator.estimate().R_vehicle_from_sensor
    assert correction is not None
    service.close()
    return tuple(correction.ravel().tolist())


def first_frame(service: Service) -> tuple[int, bytes]:
    """The corrected frame that the first accelerometer frame gives."""
    out = service.engine.frame(1.7e9, 0x200, ACCEL)
    return next((can_id, data) for can_id, data in out if can_id == 0x640)


def quality(frame: tuple[int, bytes]) -> int:
    return frame[1][6] & 0xF


def test_a_warm_start_corrects_the_first_frame_and_marks_it_restored(bench):
    cold = bench.service()
    assert quality(first_frame(cold)) == 0
    cold.close()
    rotation = calibrated(bench)
    warm = bench.service()
    assert quality(first_frame(warm)) == 1
    assert warm.engine.pipeline.correction.rotation == pytest.approx(rotation, abs=1e-12)
    assert warm.status()["state"] == "restored"
    assert warm.status()["saved_state"]["restored_at_start"]
    bench.drive(warm)  # the same again: new evidence agrees
    assert warm.status()["details"]["restored"]["phase"] in {"confirmed", "handing_over", "new"}
    assert warm.status()["state"] in {"usable", "fine"}
    warm.close()


def test_a_sensor_that_was_turned_meanwhile_is_found_out(bench):
    calibrated(bench)
    shuttle.write(bench.folder, cycles=6, yaw_deg=60.0)
    warm = bench.service()
    states = set()
    for chunk in LogReader([bench.folder / "shuttle.log"]):
        for start in range(0, len(chunk), 500):
            warm.engine.columns(chunk.take(slice(start, min(start + 500, len(chunk)))), keep=False)
            states.add(warm.engine.pipeline.estimator.state.name)
    assert {"RESTORED", "SUSPECT"} <= states
    assert states & {"USABLE", "FINE"}
    assert abs(warm.status()["mount"]["yaw_deg"] - 60.0) < 3.0
    warm.close()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("database:", "vehicle: {id: another}\ndatabase:"),
        ("{x: IMU_A.AX, y: IMU_A.AY", "{x: IMU_A.AY, y: IMU_A.AX"),
        ("x: IMU_A.AX", "x: {signal: IMU_A.AX, sign: -1}"),
    ],
)
def test_the_state_of_another_vehicle_or_sensor_is_not_used(bench, old, new):
    calibrated(bench)
    bench.edit(old, new)
    other = bench.service()
    assert quality(first_frame(other)) == 0
    other.close()


def test_another_layout_in_the_database_is_another_sensor(bench):
    calibrated(bench)
    database = bench.folder / "shuttle.dbc"
    database.write_text(database.read_text().replace("AX : 0|16@1- (0.002", "AX : 0|16@1- (-0.002"))
    other = bench.service()
    assert quality(first_frame(other)) == 0
    other.close()


def test_what_does_not_touch_the_sensor_leaves_the_state_in_use(bench):
    calibrated(bench)
    bench.edit("status_rate: 10", "status_rate: 5\n  ids: {acceleration: 0x640, mount: 0x6F3}")
    bench.edit("  speed: SPEED.V\n", "")
    same = bench.service()
    assert quality(first_frame(same)) == 1
    same.close()


def test_reloading_keeps_the_estimator_where_its_settings_are_the_same(bench):
    service = bench.service()
    bench.drive(service)
    before, correction = service.engine.pipeline.estimator, service.engine.pipeline.correction
    bench.edit("status_rate: 10", "status_rate: 1\n  ids: {acceleration: 0x650}")
    service.reload()
    assert service.engine.pipeline.estimator is before
    assert service.engine.pipeline.correction == correction
    out = service.engine.frame(1.6e9 + 60.0, 0x200, ACCEL)
    assert 0x650 in [can_id for can_id, _ in out]
    service.close()


def test_reloading_other_settings_keeps_the_mount_as_restored(bench):
    service = bench.service()
    bench.drive(service)
    bench.edit("accelerometer_bias: 0.02", "accelerometer_bias: 0.03")
    service.reload()
    assert isinstance(service.engine.pipeline.estimator, RestoredEstimator)
    assert service.engine.pipeline.quality == 1
    assert abs(service.status()["mount"]["yaw_deg"] - 25.0) < 3.0
    service.close()


def test_reloading_another_vehicle_takes_that_ones_state(bench):
    service = bench.service()
    bench.drive(service)
    bench.edit("database:", "vehicle: {id: another}\ndatabase:")
    service.reload()
    assert service.engine.pipeline.correction is None
    bench.edit("vehicle: {id: another}\n", "")
    service.reload()
    assert service.engine.pipeline.quality == 1
    service.close()


def test_a_wrong_configuration_changes_nothing_on_reload(bench):
    service = bench.service()
    bench.drive(service)
    engine, link = service.engine, service.link
    bench.edit("speed: SPEED.V", "speed: SPEED.NONE")
    service.reload()
    assert (service.engine, service.link) == (engine, link)
    assert "not reloaded" in bench.log.getvalue()
    assert "shuttle.yaml:" in bench.log.getvalue()
    service.close()


def test_a_state_that_cannot_be_written_is_reported_once_and_stops_nothing(bench):
    (bench.folder / "state").write_text("a file where a folder should be")
    service = bench.service()
    bench.drive(service)
    for _ in range(3):
        service._every_second(time.monotonic())
        service.parts.calibration_store.writer.flush(2.0)
    service._every_second(time.monotonic())
    saved = service.status()["saved_state"]
    assert saved["failures"] >= 2
    assert saved["last_error"]
    assert bench.log.getvalue().count("cannot be saved") == 1
    assert service.engine.pipeline.correction is not None
    service.close()


def test_an_estimate_that_does_not_change_is_saved_once(bench):
    service = bench.service()
    bench.drive(service)
    for _ in range(3):
        service._every_second(time.monotonic())
        assert service.parts.calibration_store.writer.flush(2.0)
    assert service.status()["saved_state"]["saves"] == 1
    service.close()
    assert service.parts.calibration_store.writer.saves == 1


def test_a_disk_that_hangs_does_not_hold_the_loop_or_the_stop(bench, monkeypatch):
    service = bench.service()
    bench.drive(service)
    release = threading.Event()
    monkeypatch.setattr(service.parts.calibration_store.store, "save", lambda _: release.wait(10.0))
    began = time.monotonic()
    service._every_second(began)
    assert time.monotonic() - began < 0.2
    service.close()
    assert time.monotonic() - began < 1.0
    release.set()
    assert "did not write the state in time" in bench.log.getvalue()


def test_status_and_metrics_come_over_the_socket_while_it_runs(bench):
    path = bench.folder / "status.sock"
    with running(bench.service()) as service:
        status = json.loads(ask(path, "status"))
        assert status["vehicle"] == "vehicle"
        assert status["link"]["channel"] == service.link.channel
        text = ask(path, "metrics")
        http = ask(path, "GET /metrics HTTP/1.1\r\nHost: x\r\n\r")
        assert http.startswith("HTTP/1.1 200 OK\r\n")
        assert http.partition("\r\n\r\n")[2].splitlines()[:8] == text.splitlines()[:8]
        assert ask(path, "GET /other HTTP/1.1").startswith("HTTP/1.1 404")
        assert ask(path, "rm -rf").startswith("error")
    assert not path.exists()
    line = re.compile(r'(# (HELP|TYPE) imucald_\w+ .+|imucald_\w+{(,?\w+="[-.\w]+")+} [-+.e\d]+)')
    assert all(line.fullmatch(one) for one in text.splitlines())
    assert f'imucald_state{{bus="{status["link"]["channel"]}",state="waiting"}} 1' in text
    named = [one.split()[2] for one in text.splitlines() if one.startswith("# TYPE")]
    assert len(named) == len(set(named))


def test_clients_that_dawdle_babble_or_crowd_hold_up_nobody(tmp_path):
    now = [0.0]
    server = StatusServer(tmp_path / "s", lambda: {"x": "y" * 3_000_000}, lambda: now[0])

    def client(data: bytes) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.connect(str(tmp_path / "s"))
        connection.sendall(data)
        return connection

    silent, babbling = client(b""), client(b"x" * 5000)
    deaf = client(b"status\n")  # never reads: the answer is larger than any buffer
    gone = client(b"status\n")
    gone.close()
    began = time.monotonic()
    for _ in range(5):
        server.poll()
    assert time.monotonic() - began < 0.5
    assert babbling.recv(10) == b""
    crowd = [client(b"") for _ in range(7 + KEPT_FOR_OWNER)]
    server.poll()
    assert sum(_is_closed(c) for c in crowd) == 1  # eight at a time, and those of our own user
    now[0] = 2.0
    server.poll()
    assert _is_closed(silent)
    assert all(_is_closed(c) for c in crowd)
    assert len(server._clients) == 0
    for connection in (silent, babbling, deaf, *crowd):
        connection.close()
    server.close()


def _is_closed(connection: socket.socket) -> bool:
    connection.settimeout(0.05)
    try:
        return connection.recv(1) == b""
    except TimeoutError:
        return False


def test_the_socket_of_a_killed_daemon_is_replaced_that_of_a_living_one_is_not(tmp_path):
    path = tmp_path / "s"
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as dead:
        dead.bind(str(path))
    living = StatusServer(path, dict)
    with pytest.raises(LinkError, match="in use"):
        StatusServer(path, dict)
    living.close()


class Manager:
    """The service manager's end of the notification socket."""

    def __init__(self, folder: Path) -> None:
        self.path = str(folder / "notify")
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(self.path)
        self.socket.setblocking(False)

    def heard(self) -> list[str]:
        found = []
        while True:
            try:
                found.append(self.socket.recv(4096).decode())
            except BlockingIOError:
                return found


@pytest.mark.slow
def test_systemd_hears_ready_status_reload_stop_and_the_watchdog_from_the_loop(bench):
    manager = Manager(bench.folder)
    notifier = Notifier({"NOTIFY_SOCKET": manager.path, "WATCHDOG_USEC": "400000"})
    service = bench.service(notifier)
    bench.drive(service)
    with running(service):
        time.sleep(0.5)
        service.ask_reload()
        wait_until(lambda: "was read again" in bench.log.getvalue())
        hang = threading.Event()
        service.engine.idle = lambda _: hang.wait(1.0) and []
        service.engine.heartbeat = lambda: hang.wait(1.0) and []
        service.daemon._last_frame = -100.0
        time.sleep(0.2)
        before = manager.heard()
        time.sleep(0.4)
        assert manager.heard() == [], "a loop that hangs fed the watchdog"
        hang.set()
    heard = before + manager.heard()
    assert heard[0] == "READY=1"
    assert heard.count("WATCHDOG=1") >= 4
    reloading = next(i for i, text in enumerate(heard) if text.startswith("RELOADING=1\nMONO"))
    assert "READY=1" in heard[reloading:]
    assert heard[-1] == "STOPPING=1"
    assert any(text.startswith("STATUS=") and "yaw" in text for text in heard)


def wait_until(condition: Callable[[], bool], limit: float = 5.0) -> None:
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_no_manager_or_one_that_does_not_listen_is_no_reason_to_stop(tmp_path):
    for environment in ({}, {"NOTIFY_SOCKET": "@imucald-nobody"}):
        notifier = Notifier(environment)
        notifier.ready()
        notifier.status("x")
        notifier.stopping()
    late = Notifier({"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "1"})
    late.ready()
    late.feed()
    manager = Manager(tmp_path)
    late.status("x")
    late.feed()
    assert manager.heard() == ["STATUS=x", "WATCHDOG=1"], "a manager that comes later is told"


@pytest.mark.parametrize(
    "watchdog", [{}, {"WATCHDOG_USEC": "x"}, {"WATCHDOG_USEC": "1", "WATCHDOG_PID": "1"}]
)
def test_a_watchdog_that_is_not_ours_is_not_fed(tmp_path, watchdog):
    manager = Manager(tmp_path)
    notifier = Notifier({"NOTIFY_SOCKET": manager.path, **watchdog})
    notifier.ready()
    notifier.feed()
    assert manager.heard() == ["READY=1"]


def test_log_lines_of_one_kind_are_reported_seldom_with_their_number():
    now, log = [0.0], io.StringIO()
    journal = Journal(log, clock=lambda: now[0])
    for _ in range(1000):
        journal.seldom("flood", "a flood\nin lines")
    now[0] = 31.0
    journal.seldom("flood", "a flood")
    assert log.getvalue().splitlines() == [
        "imucald: a flood in lines",
        "imucald: a flood (999 such lines omitted before)",
    ]


def test_the_journal_gets_priorities(tmp_path):
    with (tmp_path / "log").open("w") as log:
        found = Path(log.name).stat()
        environment = {"JOURNAL_STREAM": f"{found.st_dev}:{found.st_ino}"}
        Journal(log, environment).say("hot", 3)
        Journal(log, {"JOURNAL_STREAM": "1:2"}).say("cold", 3)
    assert (tmp_path / "log").read_text() == "<3>hot\nimucald: cold\n"


@pytest.mark.slow
def test_the_command_answers_status_reloads_and_stops_within_a_second(bench):
    calibrated(bench)
    path = bench.folder / "socket" / "s"
    command = [sys.executable, "-m", "imucald"]
    options = ["--config", str(bench.config), "--interface", "virtual", "--channel", "x"]
    options += ["--state-dir", str(bench.folder / "state"), "--status-socket", str(path)]
    daemon = subprocess.Popen([*command, "run", *options], stderr=subprocess.PIPE, text=True)
    try:
        wait_until(path.exists, 20.0)
        asked = ["--socket", str(path)]
        shown = output_of(*command, "status", *asked, status=(4, 5, 7))  # restored; nothing comes
        assert "mount  restored" in shown
        daemon.send_signal(signal.SIGHUP)
        watched = output_of(*command, "monitor", *asked, "--seconds", "0.1")
        assert "restored" in watched
        time.sleep(0.3)
        daemon.send_signal(signal.SIGTERM)
        began = time.monotonic()
        assert daemon.wait(5.0) == 0
        assert time.monotonic() - began < 1.0
        assert daemon.stderr is not None
        assert "was read again" in daemon.stderr.read()
        assert "Is the daemon running" in output_of(*command, "status", *asked, status=(3,))
    finally:
        daemon.kill()


def output_of(*command: str, status: tuple[int, ...] = (0,)) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode in status, done.stderr
    return done.stdout + done.stderr


def test_the_daemon_that_is_meant_is_found_or_the_choice_is_reported(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    with pytest.raises(LinkError, match="no running daemon found"):
        find_socket(None, "can7")
    (tmp_path / "imucald-can7.sock").touch()
    assert find_socket(None, "can7") == tmp_path / "imucald-can7.sock"
    (tmp_path / "imucald-can8.sock").touch()
    with pytest.raises(LinkError, match="several daemons run"):
        find_socket(None, None)
    assert find_socket(Path("x"), None) == Path("x")
    assert default_socket("can7") == tmp_path / "imucald-can7.sock"
    assert default_socket("can7", {"RUNTIME_DIRECTORY": "/run/a:/run/b"}) == Path(
        "/run/a/status.sock"
    )
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert default_socket("can7", {}) is None
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert default_socket("can7", {}) == Path("/run/imucald/can7/status.sock")
    assert default_socket("/dev/ttyACM0", {}) == Path("/run/imucald/dev-ttyACM0/status.sock")
    assert default_socket("can7") == tmp_path / "imucald-can7.sock", "where there is one, there"


def test_a_status_socket_that_nobody_asked_for_is_no_reason_not_to_start(bench):
    blocked = bench.folder / "file" / "s"
    (bench.folder / "file").write_text("")
    options = ServiceOptions(
        bench.config, interface="virtual", channel="nosocket", status_socket=blocked
    )
    with pytest.raises(LinkError, match="--status-socket"):
        Service(options, Journal(bench.log))
    service = Service(dataclasses.replace(options, socket_needed=False), Journal(bench.log))
    assert "continuing without it" in bench.log.getvalue()
    service.close()


def test_a_save_that_fails_for_any_reason_is_seen_and_made_up_for(bench, monkeypatch):
    service = bench.service()
    bench.drive(service)
    store = service.parts.calibration_store
    with monkeypatch.context() as broken:
        broken.setattr(store.store, "save", lambda *_: float("no number"))
        service._every_second(time.monotonic())
        assert not store.writer.flush(2.0)
        service._every_second(time.monotonic())
        saved = service.status()["saved_state"]
    assert saved["last_error"].startswith("ValueError: could not convert")
    assert saved["failures"] > 0
    assert "cannot be saved: ValueError" in bench.log.getvalue()
    assert store.writer.flush(5.0), "the same state, once the reason is gone"
    assert service.status()["saved_state"]["last_error"] == ""
    service.close()
    assert store.store.load().content is not None
