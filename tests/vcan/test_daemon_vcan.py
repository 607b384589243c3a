"""The daemon on a kernel's CAN: canplayer plays, imucald runs, candump records, replay agrees."""

from __future__ import annotations

import json
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

import shuttle
from imucald.can.dbc.decode import compile_decode
from imucald.can.logs.log_reader import LogReader
from imucald.runtime.output.output_frames import output_database

pytestmark = pytest.mark.slow

CORRECTED = (0x640, 0x641)
STATUS = (0x643, 0x644, 0x64D, 0x64E, 0x645)
RESUME_LIMIT_S = 1.0


class Daemon:
    """A running `imucald run`; what it says on stderr is kept, line by line."""

    def __init__(self, folder: Path, config: Path, channel: str) -> None:
        self.result = folder / "result.json"
        self.lines: list[str] = []
        options = ["--config", str(config), "--interface", "socketcan", "--channel", channel]
        self.process = subprocess.Popen(
            [sys.executable, "-m", "imucald", "run", *options, "--json", str(self.result)],
            stderr=subprocess.PIPE,
            text=True,
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self.process.stderr is not None
        self.lines.extend(line.rstrip() for line in self.process.stderr)

    def wait_for(self, text: str, limit: float = 20.0) -> None:
        end = time.monotonic() + limit
        while not any(text in line for line in self.lines):
            assert self.process.poll() is None, self.lines
            assert time.monotonic() < end, f"no {text!r} in {self.lines}"
            time.sleep(0.02)

    def stop(self) -> dict[str, object]:
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(5) == 0, self.lines
        self._reader.join(5)
        result: dict[str, object] = json.loads(self.result.read_text())
        return result


@contextmanager
def running_daemon(folder: Path, config: Path, channel: str) -> Iterator[Daemon]:
    daemon = Daemon(folder, config, channel)
    try:
        daemon.wait_for("listening")
        yield daemon
    finally:
        if daemon.process.poll() is None:
            daemon.process.kill()
            daemon.process.wait()


@contextmanager
def recorded(channel: str, path: Path) -> Iterator[None]:
    """Candump writes all of the channel to `path` until the block ends.

    On a busy machine its usual buffer is too small; what it drops it says (-d), as a line that
    strict reading refuses.
    """
    with path.open("wb") as file:
        candump = subprocess.Popen(["candump", "-L", "-d", "-r", "8388608", channel], stdout=file)
        time.sleep(0.3)
        try:
            yield
        finally:
            time.sleep(0.3)
            candump.terminate()
            candump.wait(10)


def play(log: Path, channel: str, *options: str) -> None:
    subprocess.run(["canplayer", *options, "-I", str(log), f"{channel}=can0"], check=True)


def frames_of(path: Path) -> dict[int, list[bytes]]:
    """Payloads by id, in order."""
    found: dict[int, list[bytes]] = {}
    for chunk in LogReader([path], strict=True):
        for can_id, length, data in zip(chunk.can_id, chunk.length, chunk.data, strict=True):
            found.setdefault(int(can_id), []).append(bytes(data[:length]))
    return found


def without_protection(can_id: int, payloads: list[bytes]) -> list[tuple[float | None, ...]]:
    """Status frames without counter and checksum, which a heartbeat before the input shifts."""
    names = {m.can_id: m for m in output_database().messages.values()}
    message = names[can_id]
    signals = [s for s in message.signals if s not in ("Counter", "Checksum")]
    plan = compile_decode(message, signals)
    return [plan.decode(p) for p in payloads]


def inputs_of(recording: Path, target: Path) -> Path:
    """The recording without what the daemon sent."""
    lines = recording.read_text().splitlines()
    ours = tuple(f" {i:03X}#" for i in (*CORRECTED, *STATUS))
    target.write_text("\n".join(line for line in lines if not any(o in line for o in ours)) + "\n")
    return target


def good(payloads: list[bytes]) -> list[bytes]:
    """Values and quality, without counter and checksum, of those that have any."""
    return [p[:6] + bytes([p[6] & 0xF]) for p in payloads if p[6] & 0xF]


def are_among(few: list[bytes], all_of_them: list[bytes], missing: int) -> bool:
    """Whether they come in this order, and no more than so many are missing."""
    rest = iter(all_of_them)
    return all(one in rest for one in few) and len(few) >= len(all_of_them) - missing


def test_live_frames_equal_replay_of_what_candump_recorded(vcan, tmp_path):
    config = shuttle.write(tmp_path, cycles=3)
    recording = tmp_path / "recorded.log"
    with (
        running_daemon(tmp_path, config, vcan.name) as daemon,
        recorded(vcan.name, recording),
    ):
        play(tmp_path / "shuttle.log", vcan.name)
        time.sleep(0.2)
        result = daemon.stop()
    replayed = tmp_path / "replayed.log"
    inputs = inputs_of(recording, tmp_path / "inputs.log")
    options = ["--config", str(config), "--out", str(replayed), "--json", "-"]
    done = subprocess.run(
        [sys.executable, "-m", "imucald", "replay", str(inputs), *options],
        capture_output=True,
        text=True,
        check=True,
    )
    live, offline = frames_of(recording), frames_of(replayed)
    late = result["link"]["late"]  # type: ignore[index]
    for can_id in CORRECTED:
        assert len(live[can_id]) > 2900 - late
        assert late or live[can_id] == offline[can_id]
        assert are_among(good(live[can_id]), good(offline[can_id]), late)
    for can_id in STATUS if not late else ():  # health then says that frames were late
        status = without_protection(can_id, offline[can_id])
        heard = without_protection(can_id, live[can_id])
        start = next(i for i in range(len(heard)) if heard[i:][: len(status)] == status)
        # Until the player starts there is a heartbeat a second; a busy machine takes its time.
        assert start <= 10, "more than heartbeats before the first status of the drive"
    said = json.loads(done.stdout)
    assert result["mount"] == said["mount"]
    assert result["state"] == said["state"] != "waiting"
    assert abs(said["mount"]["yaw_deg"] - 25.0) < 3.0
    qualities = {payload[6] & 0xF for payload in live[0x640]}
    assert 0 in qualities
    assert qualities & {2, 3}, "no corrected frame became usable"


def test_corrected_frames_resume_after_down_and_up_and_after_deletion(vcan, tmp_path):
    config = shuttle.write(tmp_path, cycles=1)
    with running_daemon(tmp_path, config, vcan.name) as daemon:
        for way in ("down", "deletion", "down"):
            if way == "down":
                subprocess.run(["ip", "link", "set", vcan.name, "down"], check=True)
                time.sleep(0.3)
                subprocess.run(["ip", "link", "set", vcan.name, "up"], check=True)
            else:
                subprocess.run(["ip", "link", "del", vcan.name], check=True)
                time.sleep(0.3)
                subprocess.run(["ip", "link", "add", vcan.name, "type", "vcan"], check=True)
                subprocess.run(["ip", "link", "set", vcan.name, "up"], check=True)
            back = time.monotonic()
            assert seconds_to_corrected_frame(vcan.name, back) < RESUME_LIMIT_S
        daemon.stop()


def seconds_to_corrected_frame(channel: str, back: float) -> float:
    """Send accelerometer frames until a corrected one is heard; time since `back` [s].

    By sockets of our own: starting other programs takes longer than what is measured.
    """
    sample = struct.pack("=IB3x8s", 0x200, 8, bytes.fromhex("0000000027130000"))
    corrected = struct.pack("=II", CORRECTED[0], 0x7FF)
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as other:
        other.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, corrected)
        other.settimeout(0.01)
        other.bind((channel,))
        while time.monotonic() - back < 5.0:
            other.send(sample)
            with suppress(TimeoutError):
                other.recv(16)
                break
    return time.monotonic() - back


def test_another_node_on_our_ids_is_reported_in_the_health_frame(vcan, tmp_path):
    config = shuttle.write(tmp_path, cycles=1)
    recording = tmp_path / "recorded.log"
    with (
        running_daemon(tmp_path, config, vcan.name) as daemon,
        recorded(vcan.name, recording),
    ):
        for _ in range(30):
            subprocess.run(["cansend", vcan.name, "640#0102030405060708"], check=True)
            subprocess.run(["cansend", vcan.name, "200#0000000027130000"], check=True)
            time.sleep(0.02)
        time.sleep(0.3)
        daemon.stop()
    plan = compile_decode(output_database().message("IMUCALD_Health"), ["IdConflict"])
    # not by the log reader: on a vcan frames of two nodes follow each other faster than on a bus
    lines = recording.read_text().splitlines()
    payloads = [bytes.fromhex(line.partition(" 645#")[2]) for line in lines if " 645#" in line]
    flags = [plan.decode(payload)[0] for payload in payloads]
    assert flags[-1] == 1.0
    assert any("our output id 640" in line for line in daemon.lines)


def test_a_flooded_bus_loses_none_of_ours_or_counts_each_loss(vcan, tmp_path):
    config = shuttle.write(tmp_path, cycles=1)
    recording = tmp_path / "recorded.log"
    subprocess.run(["ip", "link", "set", vcan.name, "txqueuelen", "1000"], check=True)
    with running_daemon(tmp_path, config, vcan.name) as daemon, recorded(vcan.name, recording):
        flood = subprocess.Popen(
            ["cangen", vcan.name, "-g", "0.2", "-I", "3A0", "-L", "8", "-i"],
            stderr=subprocess.DEVNULL,
        )
        try:
            play(tmp_path / "shuttle.log", vcan.name)
            time.sleep(0.5)
        finally:
            flood.terminate()
            flood.wait(10)
        result = daemon.stop()
    sent = sum(
        len(p) for i, p in frames_of(tmp_path / "shuttle.log").items() if i in (0x200, 0x201, 0x202)
    )
    frames = result["frames"]
    assert isinstance(frames, dict)
    flood_frames = len(frames_of(recording).get(0x3A0, []))
    assert flood_frames > 2000, "this was no flood"
    lost = result["link"]["lost"]  # type: ignore[index]
    assert frames["used"] + lost >= sent
