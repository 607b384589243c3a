"""Diagnostics of the daemon on a kernel's CAN: udsoncan asks, hostile nodes try."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from udsoncan.client import Client
from udsoncan.exceptions import NegativeResponseException

from imucald.can.python_can import can
from uds_bus import REQUEST, RESPONSE, asking, guarded_config, with_diagnostics

pytestmark = pytest.mark.slow

CALIBRATE, RESET = 0xF010, 0xF011
TESTS = Path(__file__).parent.parent


@contextmanager
def running_daemon(
    folder: Path, channel: str, config: Path | None = None
) -> Iterator[subprocess.Popen[str]]:
    """`imucald run` with diagnostics; the key function is in the folder of the tests."""
    config = config or with_diagnostics(folder, cycles=1)
    options = ["--config", str(config), "--interface", "socketcan", "--channel", channel]
    state = ["--state-dir", str(folder / "state"), "--status-socket", str(folder / "status.sock")]
    process = subprocess.Popen(
        [sys.executable, "-m", "imucald", "run", *options, *state],
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(TESTS)},
    )
    lines: list[str] = []

    def read() -> None:
        assert process.stderr is not None
        lines.extend(process.stderr)

    threading.Thread(target=read, daemon=True).start()
    try:
        end = time.monotonic() + 20
        while not any("listening" in line for line in lines):
            assert process.poll() is None, lines
            assert time.monotonic() < end, lines
            time.sleep(0.02)
        yield process
        assert process.poll() is None, lines
    finally:
        process.terminate()
        process.wait(10)


@contextmanager
def asking_on(channel: str) -> Iterator[Client]:
    bus = can.Bus(
        interface="socketcan",
        channel=channel,
        can_filters=[{"can_id": RESPONSE, "can_mask": 0x7FF, "extended": False}],
    )
    try:
        with asking(bus) as client:
            yield client
    finally:
        bus.shutdown()


@contextmanager
def standing_vehicle(channel: str) -> Iterator[None]:
    """IMU and a speed of zero, ten times a second, until the block ends."""
    stop = threading.Event()

    def work() -> None:
        with can.Bus(interface="socketcan", channel=channel) as bus:
            while not stop.wait(0.1):
                for can_id, data in (
                    (0x200, "0000000027130000"),
                    (0x201, "00" * 8),
                    (0x202, "0000"),
                ):
                    bus.send(
                        can.Message(
                            arbitration_id=can_id, is_extended_id=False, data=bytes.fromhex(data)
                        )
                    )

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def codes(client: Client) -> set[int]:
    return {d.id for d in client.get_dtc_by_status_mask(0x08).service_data.dtcs}


def memory_kib(process: subprocess.Popen[str]) -> int:
    status = Path(f"/proc/{process.pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0])


def test_a_tester_reads_unlocks_and_resets_when_the_vehicle_stands(vcan, tmp_path):
    with running_daemon(tmp_path, vcan.name), asking_on(vcan.name) as client:
        assert client.read_data_by_identifier_first(0xF190) == (b"WVWZZZ1JZXW000001",)
        client.change_session(3)
        with pytest.raises(NegativeResponseException, match="0x33"):
            client.start_routine(RESET)
        client.unlock_security_access(1)
        with pytest.raises(NegativeResponseException, match="0x22"):
            client.start_routine(RESET)  # no speed was heard
        with standing_vehicle(vcan.name):
            time.sleep(1.0)
            client.start_routine(CALIBRATE)
            answer = client.get_routine_result(CALIBRATE).service_data.routine_status_record
            assert answer[0] == 1
            assert len(answer) == 18
            client.stop_routine(CALIBRATE)
            client.start_routine(RESET)


def test_a_node_on_our_identifiers_sets_its_code_and_it_can_be_cleared(vcan, tmp_path):
    with (
        running_daemon(tmp_path, vcan.name),
        asking_on(vcan.name) as client,
        standing_vehicle(vcan.name),
    ):
        time.sleep(1.0)
        client.clear_dtc()
        assert 0xDA1181 not in codes(client)
        vcan.send("640#0102030405060708")
        time.sleep(0.5)
        assert 0xDA1181 in codes(client)
        client.clear_dtc()
        time.sleep(0.5)
        assert codes(client) == set()


def test_hostile_testers_at_the_pace_of_the_bus(vcan, tmp_path):
    """Random frames on our request identifiers: it lives, answers, and has grown by nothing."""
    with (
        running_daemon(tmp_path, vcan.name) as process,
        standing_vehicle(vcan.name),
    ):
        sizes = []
        for _ in range(3):
            for can_id in (REQUEST, 0x7DF):
                subprocess.run(
                    f"cangen {vcan.name} -I {can_id:X} -L i -D r -g 0.3 -n 2500".split(),
                    check=False,
                    capture_output=True,
                )
            sizes.append(memory_kib(process))
        time.sleep(0.5)
        with asking_on(vcan.name) as client:
            counted = client.read_data_by_identifier_first(0xFD0C)
            assert counted[0] > 1000, "frames that were looked at"
            assert client.read_data_by_identifier_first(0xFD0B)[1] > 10, "refused"
            client.change_session(3)
            with pytest.raises(NegativeResponseException, match="0x33"):
                client.start_routine(RESET)
        assert sizes[-1] - sizes[0] < 1024, sizes


def test_a_recording_beside_the_real_sensor_and_forged_frames_set_their_codes(vcan, tmp_path):
    command = [sys.executable, "-m", "imucald", "simulate", "--minutes", "0.2", "--seed", "3"]
    log = tmp_path / "drive.log"
    subprocess.run([*command, "--out", str(log)], check=True, capture_output=True)
    lines = [line for line in log.read_text().splitlines() if " 200#" in line]
    real, old = tmp_path / "real.log", tmp_path / "old.log"
    real.write_text("\n".join(lines[300:700]) + "\n")
    old.write_text("\n".join(lines[:200]) + "\n")
    play = ["canplayer", f"{vcan.name}=can0", "-I"]
    config = guarded_config(tmp_path)
    with running_daemon(tmp_path, vcan.name, config), asking_on(vcan.name) as client:
        sensor = subprocess.Popen([*play, str(real)])
        time.sleep(1.0)
        client.clear_dtc()
        assert not codes(client) & {0xDA1082, 0xDA1083}
        subprocess.run([*play, str(old)], check=True)
        time.sleep(0.3)
        assert codes(client) & {0xDA1082, 0xDA1083} == {0xDA1082}
        for _ in range(4):
            vcan.send("200#" + "7F" * 6 + "0000")
        time.sleep(0.5)
        assert codes(client) >= {0xDA1082, 0xDA1083}
        assert client.read_data_by_identifier_first(0xFD09)[1] >= 4
        assert sensor.wait(20) == 0
