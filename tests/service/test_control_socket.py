"""The control socket: who is listened to, and that no client disturbs the loop."""

from __future__ import annotations

import contextlib
import json
import os
import random
import socket
import stat
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest

from feed_bench import sensor_frame, traffic, wait_until
from imucald.core.errors import LinkError
from imucald.service.asking import ask
from imucald.service.control import BURST, ControlServer
from imucald.service.line_server import CLIENT_S, CLIENTS_MAX, REQUEST_MAX, LineServer, Peer
from paths import ROOT
from service_bench import Bench, running


class Orders:
    """Writes down what it is asked for."""

    def __init__(self) -> None:
        self.done: list[tuple[str, ...]] = []

    def reset(self, who: str) -> str:
        self.done.append(("reset", who))
        return "done"

    def set_mount(self, mount: object, who: str) -> str:
        self.done.append(("set-mount", who))
        return "done"

    hold = release = reset


class Desk:
    """A control server with a clock that moves when told."""

    def __init__(self, folder: Path) -> None:
        self.now = 100.0
        self.orders = Orders()
        self.said: list[str] = []
        say = lambda text, _: self.said.append(text)  # noqa: E731
        self.server = ControlServer(folder / "c", self.orders, say, lambda: self.now)  # type: ignore[arg-type]

    def client(self, data: bytes) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.connect(str(self.server.path))
        connection.sendall(data)
        return connection

    def asked(self, data: bytes) -> dict[str, str]:
        self.now += 10.0  # whatever the rate was
        with self.client(data) as connection:
            self.server.poll()
            connection.settimeout(1.0)
            return dict(json.loads(connection.recv(65536) or b"{}"))


@pytest.fixture
def desk(tmp_path: Path) -> Desk:
    return Desk(tmp_path)


def test_every_order_of_the_documentation_is_carried_out(desk):
    text = (ROOT / "docs" / "service.md").read_text()
    block = text.partition("## Orders")[2].partition("```json\n")[2].partition("```")[0]
    lines = block.splitlines()
    kinds = {json.loads(line)["order"] for line in lines}
    assert kinds == {"reset", "hold", "release", "set-mount"}
    for line in lines:
        assert desk.asked(line.encode() + b"\n") == {"done": "done"}, line
    assert len(desk.orders.done) == len(lines)
    assert desk.orders.done[-1][1].endswith("for ann)")
    with desk.client(lines[0].encode()) as without_newline:
        desk.server.poll()
        desk.now += CLIENT_S + 1.0
        desk.server.poll()
        without_newline.settimeout(1.0)
        assert without_newline.recv(64) == b""


def test_the_file_is_for_its_owner_alone_from_the_first_moment(tmp_path, monkeypatch):
    modes = []
    bind = socket.socket.bind

    def watched(self, path):
        bind(self, path)
        modes.append(stat.S_IMODE(Path(path).stat().st_mode))

    monkeypatch.setattr(socket.socket, "bind", watched)
    old = os.umask(0)
    try:
        desk = Desk(tmp_path)
    finally:
        os.umask(old)
    assert modes == [0o600]
    assert stat.S_IMODE(desk.server.path.stat().st_mode) == 0o600
    desk.server.close()
    assert not desk.server.path.exists()


def test_only_root_and_its_own_user_are_listened_to(desk):
    line = b'{"order": "reset"}'
    other = desk.server._answer(line, Peer(pid=5, uid=os.geteuid() + 4242, gid=0))
    assert b"may not give orders" in other
    assert desk.orders.done == []
    assert "was refused" in desk.said[0]
    assert b"done" in desk.server._answer(line, Peer(pid=5, uid=0, gid=0))
    assert desk.orders.done == [("reset", "root (pid 5)")]


def test_the_kernel_says_who_asks_and_sudo_for_whom(desk):
    assert desk.asked(b'{"order": "hold", "sudo_user": "ada"}\n') == {"done": "done"}
    ((_, who),) = desk.orders.done
    assert who.endswith(f"(pid {os.getpid()}, for ada)")


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"reset",
        b"{}",
        b"[]",
        b"null",
        b'{"order": "explode"}',
        b'{"order": ["reset"]}',
        b'{"order": "reset", "more": 1}',
        b'{"order": "reset", "sudo_user": "a b\\n"}',
        b'{"order": "reset", "sudo_user": "' + b"a" * 40 + b'"}',
        b'{"order": "set-mount", "mount": {"roll_deg": 1}}',
        b'{"order": "set-mount", "mount": {"roll_deg": 1e999, "pitch_deg": 0, "yaw_deg": 0, "std_deg": 1}}',  # noqa: E501
        b'{"order": "set-mount", "mount": {"roll_deg": NaN, "pitch_deg": 0, "yaw_deg": 0, "std_deg": 1}}',  # noqa: E501
        b'{"order": "set-mount", "mount": {"roll_deg": 0, "pitch_deg": 91, "yaw_deg": 0, "std_deg": 1}}',  # noqa: E501
        b'{"order": "set-mount", "mount": {"roll_deg": 0, "pitch_deg": 0, "yaw_deg": 0, "std_deg": 0}}',  # noqa: E501
        b'{"order": "set-mount", "mount": {"roll_deg": 0, "pitch_deg": 0, "yaw_deg": 0, "std_deg": [1]}}',  # noqa: E501
        b"\xff\xfe\x00" * 100,
        b"[" * 4000,
        b'{"order": "re_et\xbc"}',
        b'{"a":' * 700,
        b"GET / HTTP/1.1\r",
        bytes(range(11, 256)),
    ],
)
def test_what_is_no_order_is_answered_and_does_nothing(desk, line):
    assert "error" in desk.asked(line + b"\n")
    assert desk.orders.done == []


def test_an_order_that_fails_is_answered_and_reported_and_the_loop_goes_on(desk):
    desk.orders.hold = lambda _: 1 / 0
    assert "ZeroDivisionError" in desk.asked(b'{"order": "hold"}\n')["error"]
    assert "was refused: it failed" in desk.said[-1]
    assert "done" in desk.asked(b'{"order": "reset"}\n')


def test_a_mount_without_numbers_is_refused(desk):
    assert desk.asked(b'{"order": "set-mount"}\n') == {"error": "set-mount needs a mount"}


def test_orders_beyond_the_rate_are_refused_and_cost_nothing(desk):
    answers = [desk.server._answer(b'{"order": "reset"}', Peer(1, 0, 0)) for _ in range(50)]
    assert len(desk.orders.done) == BURST
    assert all(b"too many orders" in answer for answer in answers[BURST:])
    desk.now += 1.0
    assert b"done" in desk.server._answer(b'{"order": "reset"}', Peer(1, 0, 0))


def test_slow_huge_silent_and_gone_clients_take_a_place_for_a_second_at_most(desk):
    slow = [desk.client(b'{"or') for _ in range(CLIENTS_MAX - 2)]
    huge = desk.client(b"x" * (REQUEST_MAX + 1))
    gone = desk.client(b'{"order": "reset"}\n')
    gone.close()
    began = time.monotonic()
    for _ in range(5):
        desk.server.poll()
    assert time.monotonic() - began < 0.5
    assert huge.recv(10) == b""
    desk.now += CLIENT_S + 0.1
    desk.server.poll()
    assert not desk.server._clients
    assert "done" in desk.asked(b'{"order": "reset"}\n')
    for connection in (*slow, huge):
        connection.close()


ATTACK = """
import contextlib, random, socket, sys, time
path, end = sys.argv[1], time.monotonic() + float(sys.argv[2])
kept, tried, n = [], 0, 0
print("begun", flush=True)
data = [b"", b"x" * 100_000, bytes(range(256)) * 20, b'{"order": "reset"', b"status\\n",
        b"\\n" * 5000, b'{"order": "hold"}\\n' * 100]
# a busy machine takes longer than the time for so many: they are what the test is about
while (now := time.monotonic()) < end or (tried <= 1000 or n <= 100) and now < end + 30.0:
    connection = socket.socket(socket.AF_UNIX)
    connection.setblocking(False)
    tried += 1
    with contextlib.suppress(OSError):
        connection.connect(path)
        n += 1
        connection.send(random.choice(data))
    kept.append(connection)
    if len(kept) > 800:
        kept.pop(0).close()
print(tried, n)
"""


@pytest.mark.slow
def test_thousands_of_hostile_connections_hold_up_no_frame(tmp_path):
    bench = Bench(tmp_path)
    service = bench.service()
    with running(service):
        assert service.sockets.control is not None
        assert service.sockets.status is not None
        attacks = [
            subprocess.Popen(
                [sys.executable, "-c", ATTACK, str(server.path), "3"],
                stdout=subprocess.PIPE,
                text=True,
            )
            for server in (service.sockets.control, service.sockets.status)
        ]
        for attack in attacks:  # a busy machine takes its time to start them
            assert attack.stdout is not None
            assert attack.stdout.readline() == "begun\n"
        is_attacked = lambda: any(attack.poll() is None for attack in attacks)  # noqa: E731
        latencies = exchanged(service.link.channel, is_attacked)
        counts = [
            tuple(int(n) for n in attack.communicate(timeout=10)[0].split()) for attack in attacks
        ]
        assert all(tried > 1000 and came > 100 for tried, came in counts), counts
        late = sorted(latencies)
        print(f"{counts} connections; latency {late[len(late) // 2]:.4f} {late[-1]:.4f} s")
        assert late[-1] < 0.5
        # it learns what the frames say: levelled after a standstill of 2 s and half a second more,
        # in tenths of a second that each had a frame. A busy machine leaves holes, so that the
        # attack alone may be too short: the vehicle stands until it is seen
        with traffic(service.link.channel, ahead=0.0):
            wait_until(lambda: answer(service.sockets.status, "status").get("state") == "levelled")
        # the attack has used up the orders that are taken in its last second (BURST, PERIOD_S)
        wait_until(lambda: "done" in answer(service.sockets.control, '{"order": "reset"}'))


def answer(server: LineServer | None, request: str) -> dict[str, Any]:
    """What a socket says; asked again while what the attack has left takes its places."""
    assert server is not None
    found: dict[str, Any] = {}

    def is_answered() -> bool:
        with contextlib.suppress(LinkError, ValueError):  # turned away before or after the question
            found.update(json.loads(ask(server.path, request)))
        return bool(found)

    wait_until(is_answered)
    return found


def exchanged(channel: str, goes_on: Callable[[], bool]) -> list[float]:
    """Send accelerometer frames and wait for the corrected one of each; how long that took [s]."""
    found = []
    noise = random.Random(1)
    with can.Bus(interface="virtual", channel=channel) as bus:
        while goes_on():
            data = sensor_frame(noise, ahead=0.0)
            began = time.monotonic()
            bus.send(can.Message(arbitration_id=0x200, data=data, is_extended_id=False))
            while True:
                answer = bus.recv(2.0)
                assert answer is not None, "no corrected frame within 2 s"
                if answer.arbitration_id == 0x640:
                    break
            found.append(time.monotonic() - began)
            time.sleep(0.01)
    return found


def test_a_control_socket_that_cannot_be_made_is_reported_and_the_daemon_runs(tmp_path):
    bench = Bench(tmp_path)
    (tmp_path / "status.sock.control").mkdir()
    (tmp_path / "control.sock").mkdir()
    service = bench.service()
    assert service.sockets.control is None
    assert "continuing without it" in bench.log.getvalue()
    thread = threading.Thread(target=service.run, args=[0.2])
    thread.start()
    thread.join(5.0)
    assert not thread.is_alive()
    service.close()
