"""What a stranger can hand to imucald, as bytes: one function an entry, for fuzzing.

A target returns for every input: what the package refuses on purpose is caught here, anything else
that escapes (or a crash, a hang, memory without bound) is a defect.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import hashlib
import io
import itertools
import json
import os
import shutil
import socket
import struct
import tempfile
import unicodedata
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import zstandard

import imucald
import shuttle
from both_ways import assert_same
from fuzz.edited_drive import Frame, edited
from imucald.can.columns import CAN_EFF_FLAG, IdMatch
from imucald.can.dbc.bits import Field
from imucald.can.dbc.database import load_database
from imucald.can.e2e.checksums import crc8_j1850
from imucald.can.e2e.protection import REASONS, MessageChecker
from imucald.can.e2e.protection_spec import CounterSpec, ProtectionSpec
from imucald.can.logs.log_reader import LogReader
from imucald.cli import main
from imucald.config import parse_config
from imucald.core import compiled
from imucald.core.errors import ImucaldError
from imucald.core.files import with_checksum
from imucald.fleet.fleet_file import load_fleet
from imucald.fleet.listing import list_logs
from imucald.inputs.expression import Expression
from imucald.inputs.wiring import compile_router
from imucald.model.model import load_model
from imucald.runtime.flow import ALARMS
from imucald.runtime.session import make_engine, open_config
from imucald.service.control import ControlServer
from imucald.service.journal import Journal
from imucald.service.line_server import Peer
from imucald.service.parts import ServiceOptions
from imucald.service.records import VERSION
from imucald.service.saved_state import KIND, SavedState, StateKey, StateStore
from imucald.service.service import Service
from imucald.service.status import StatusServer
from imucald.service.uds_records import DTC_KIND, AttemptStore, DtcStore
from imucald.uds.isotp_channel import IsoTpChannel
from log_text import frames_of

ROOT = Path(__file__).parents[2]
FOLDER = Path(tempfile.mkdtemp(prefix="imucald-fuzz-"))
EXAMPLE = ROOT / "config" / "examples" / "passenger_car.yaml"
DATABASE_FORMATS = ("dbc", "kcd", "sym", "arxml")
LOG_ENDINGS = (".log", ".asc", ".trc", ".csv", ".blf", ".log.gz")
KEEP = [
    None,
    [IdMatch(0x123, 0x7FF), IdMatch(0x1ABCDE + CAN_EFF_FLAG, 0x1FFFFFFF)],
    [IdMatch(0x100, 0x700, "can0"), IdMatch(0x7F0, 0x7F0, "vcan1")],
    [IdMatch(0x18FF0000 + CAN_EFF_FLAG, 0x1FFF0000)],
]
MAX_FRAMES = 200
DRIVE_S = 10.0
COUNTER = CounterSpec(Field(8, 4, "little_endian"), 15, max_jump=2)
FRAME_SPECS = (
    ProtectionSpec(8, COUNTER, crc8_j1850(8, 0, b"\x02\x00"), 0.01),
    ProtectionSpec(13, COUNTER, crc8_j1850(13, 0, b""), 0.01),
    ProtectionSpec(64, None, crc8_j1850(64, 0, b""), None),
    ProtectionSpec(20, COUNTER, None, 0.02, recovery=1),
    ProtectionSpec(0),
)
LINK_COUNTERS = "received lost late sent conflicts error_frames bus_off went_down reopened rejected"
STATUS: dict[str, Any] = {
    "state": "fine",
    "quality": 3,
    "mount": {
        **{f"{angle}_deg": 1.5 for angle in ("roll", "pitch", "yaw")},
        "std_deg": dict.fromkeys("xyz", 0.1),
        "angle_std_deg": dict.fromkeys(("roll", "pitch", "yaw"), 0.1),
    },
    "signals": {"accel": {"samples": 100}},
    "frames": {"rejected": {"checksum": 2}},
    "link": {
        **dict.fromkeys(LINK_COUNTERS.split(), 0),
        "send_errors": {},
        "state": "up",
        "channel": "can0",
    },
    "saved_state": {"saves": 1, "failures": 0, "remounts": 0},
    "health": dict.fromkeys(ALARMS, False),
    "version": "0.2.0",
    "held": False,
    "frames_given_out": 7,
    "uptime_s": 10.0,
    "process": {"cpu_s": 0.5, "rss_bytes": 50_000_000},
}
"""As much of a status as the answers need."""


def configuration(data: bytes) -> None:
    """A configuration file; where it is whole, its signals are looked up too."""
    text = data.decode("utf-8", "surrogateescape")
    with contextlib.suppress(ImucaldError):
        compile_router(parse_config(text, ROOT / "config" / "imucald.yaml"))


def model(data: bytes) -> None:
    """A model file."""
    path = FOLDER / "model.yaml"
    path.write_bytes(data)
    with contextlib.suppress(ImucaldError):
        load_model(path)


def database(data: bytes) -> None:
    """A database; the first byte chooses its format."""
    if not data:
        return
    ending = DATABASE_FORMATS[data[0] % len(DATABASE_FORMATS)]
    path = FOLDER / f"car.{ending}"
    path.write_bytes(data[1:])
    with contextlib.suppress(ImucaldError):
        load_database(path)


def log(data: bytes) -> None:
    """A recorded log; the first byte chooses its format and which frames are asked for."""
    if not data:
        return
    which, ending = divmod(data[0], len(LOG_ENDINGS))
    path = FOLDER / f"drive{LOG_ENDINGS[ending]}"
    path.write_bytes(data[1:])
    _same_without_the_compiled_part(lambda: _frames(path, KEEP[which % len(KEEP)]))


def packed_log(data: bytes) -> None:
    """The bytes of a Zstandard file, then those of one with a right frame around them."""
    path = FOLDER / "drive.log.zst"
    for content in (data, zstandard.compress(data)):
        path.write_bytes(content)
        _frames(path, None)


def mf4_log(data: bytes) -> None:
    """An MF4 file, whatever its first bytes are."""
    path = FOLDER / "drive.mf4"
    path.write_bytes(data)
    _frames(path, None)


def capture(data: bytes) -> None:
    """A capture."""
    path = FOLDER / "drive.pcap"
    path.write_bytes(data)
    _frames(path, None)


def _is_harmless(character: str) -> bool:
    """Whether a terminal neither acts on it nor turns the direction of writing by it."""
    turns = {"LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI"}
    acts = unicodedata.category(character) in {"Cc", "Cs", "Zl", "Zp"}
    return character in "\n\t" or not (acts or unicodedata.bidirectional(character) in turns)


def file_names(data: bytes) -> None:
    """Names of logs, parted by NUL, on a screen and in a fleet's listing."""
    folder = FOLDER / "names"
    folder.mkdir(exist_ok=True)
    names = {part.replace(b"/", b"_")[:200] for part in data.split(b"\0")[:8]} - {b"", b".", b".."}
    for name in names:
        (folder / os.fsdecode(name)).write_bytes(b"no log")
    fleet_file = FOLDER / "fleet.yaml"
    fleet_file.write_text(f"logs: 'names/*'\nconfig: {EXAMPLE}\n")
    try:
        with contextlib.suppress(ImucaldError):
            assert len(list_logs(load_fleet(fleet_file))) <= len(names)
        for path in folder.iterdir():
            out = io.StringIO()
            with contextlib.redirect_stderr(out), contextlib.redirect_stdout(out):
                assert main(["check", "--config", str(EXAMPLE), str(path)]) == 1
            assert all(map(_is_harmless, out.getvalue())), out.getvalue()
    finally:
        shutil.rmtree(folder)


def _frames(path: Path, keep: list[IdMatch] | None) -> Any:
    reader = LogReader([path], keep)
    try:
        chunks = list(reader)
    except ImucaldError as error:
        return str(error)
    assert all(len(columns) > 0 for columns in chunks)
    return frames_of(*chunks), reader.frames_read, reader.rejected, reader.problems, reader.ignored


def _same_without_the_compiled_part(function: Callable[[], Any]) -> None:
    found = function()
    if compiled.kernels is not None:
        with compiled.left_out():
            assert_same(found, function(), "result")


def expression(data: bytes) -> None:
    """A raw expression of a configuration, and eight bytes of a frame to compute it from."""
    with contextlib.suppress(ImucaldError):
        compiled = Expression(data[8:].decode("utf-8", "replace"))
        payload = data[:8].ljust(8, b"\0")
        with contextlib.suppress(ZeroDivisionError):
            compiled.number(payload)


def saved_state(data: bytes) -> None:
    """A saved state: any bytes, and any JSON content under a right head and checksum."""
    key = StateKey("car", "imu")
    body = data
    with contextlib.suppress(ValueError, RecursionError):
        content = json.loads(data)
        if isinstance(content, dict):
            body = json.dumps(_whole_state() | content).encode()
    marks = f"{KIND} {VERSION}"
    head = f"{marks} {len(body)} {hashlib.sha256(body).hexdigest()}\n"
    folder = FOLDER / "state"
    folder.mkdir(exist_ok=True)
    store = StateStore(folder, key)
    store.path(0).write_bytes(data)
    store.path(1).write_bytes(head.encode() + body)
    store.load()
    for path in folder.iterdir():
        path.unlink()


def _whole_state() -> dict[str, Any]:
    rotation = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    variance = 1e-4
    covariance = tuple(variance * number for number in rotation)
    good = SavedState(rotation, covariance, "fine")
    encoded = StateStore(FOLDER, StateKey("car", "imu")).encoded(3, good)
    found: dict[str, Any] = json.loads(encoded.partition(b"\n")[2])
    return found


def saved_dtcs(data: bytes) -> None:
    """A file of saved DTCs under a right checksum, restored into the memory."""
    path = FOLDER / "dtcs"
    path.write_bytes(with_checksum(f"{DTC_KIND} 1", data))
    store = DtcStore(path, lambda _line, _priority: None)
    store.close()
    for file in FOLDER.glob("dtcs*"):
        file.unlink()


def isotp_frames(data: bytes) -> None:
    """Frames of a tester, cut from the bytes, through transport and server."""
    from uds_bench import Bench

    bench = Bench()
    channel = IsoTpChannel(0x7E0, 0x7E8, 0x7DF, bench.server.handle, bench.clock)
    ids = sorted(channel.ids)
    for _ in range(MAX_FRAMES):
        if not data:
            break
        head, data = data[0], data[1:]
        payload, data = data[: head & 15], data[head & 15 :]
        bench.clock.now += (head >> 6) * 0.3
        for _, frame in channel.frame(ids[head >> 4 & 1], payload) + channel.poll():
            assert len(frame) <= 8
    assert bench.host.done == []


@functools.cache
def _status_server() -> StatusServer:
    return StatusServer(FOLDER / "status.sock", lambda: STATUS)


def status_request(data: bytes) -> None:
    """A request to the status socket."""
    server = _status_server()
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as client:
        client.connect(str(server.path))
        server.poll()
        client.setblocking(False)
        with contextlib.suppress(BlockingIOError, BrokenPipeError, ConnectionResetError):
            client.send(data[:8192])
        server.poll()


@functools.cache
def _control_server() -> ControlServer:
    service, _ = _service()
    ticks = itertools.count()
    path = FOLDER / "control.sock"
    return ControlServer(path, service.orders, lambda *_: None, lambda: float(next(ticks)))


def control_order(data: bytes) -> None:
    """A request to the control socket of a running daemon."""
    answer = json.loads(_control_server()._answer(data[:4096], Peer(1, os.geteuid(), 0)))
    assert len(answer) == 1
    assert answer.keys() <= {"done", "error"}


@functools.cache
def _config() -> Any:
    return open_config(EXAMPLE)


def bus_frames(data: bytes) -> None:
    """Frames from the bus through a whole engine: index of the id, length, time step, payload."""
    engine = make_engine(_config())
    ids = sorted({match.can_id for match in engine.router.matches})
    stamp = 1.6e9
    for _ in range(MAX_FRAMES):
        if len(data) < 3:
            break
        which, length, step = data[0], data[1] & 15, data[2]
        payload, data = data[3 : 3 + length], data[3 + length :]
        stamp += struct.unpack("b", bytes([step]))[0] ** 3 * 1e-5
        for out in engine.frame(stamp, ids[which % len(ids)], payload):
            assert len(out[1]) <= 64
    engine.idle(0.5)


@functools.cache
def _service() -> tuple[Service, Path]:
    """A daemon on a virtual bus, and its configuration file."""
    path = shuttle.write(FOLDER, cycles=1)
    options = ServiceOptions(path, interface="virtual", channel="fuzz")
    service = Service(options, Journal(io.StringIO()))
    atexit.register(service.close)
    return service, path


def reload(data: bytes) -> None:
    """Another configuration for a running daemon: taken, or nothing has changed."""
    service, path = _service()
    good = path.read_bytes()
    before = service.engine, service.loaded, service.link
    path.write_bytes(data)
    try:
        service.reload()
    finally:
        path.write_bytes(good)
    if service.loaded is before[1]:
        assert (service.engine, service.link) == (before[0], before[2])


def frame_check(data: bytes) -> None:
    """Frames of any length of CAN FD through a message's checks, one by one and in columns.

    The first byte chooses what the message has; then length, time step and payload of each frame.
    """
    if not data:
        return
    spec = FRAME_SPECS[data[0] % len(FRAME_SPECS)]
    t, rest, frames = 0.0, data[1:], []
    while len(rest) >= 2 and len(frames) < MAX_FRAMES:
        length = rest[0] % 65
        t += rest[1] * 1e-3
        frames.append((t, rest[2 : 2 + length]))
        rest = rest[2 + length :]
    if not frames:
        return
    one, columns = MessageChecker(spec), MessageChecker(spec)
    reasons = [one.check(at, payload) or "" for at, payload in frames]
    block = np.zeros((len(frames), 64), np.uint8)
    for row, (_, payload) in zip(block, frames, strict=True):
        row[: len(payload)] = list(payload)
    lengths = np.array([len(payload) for _, payload in frames], np.uint8)
    codes = columns.check_columns(np.array([at for at, _ in frames]), block, lengths)
    assert reasons == [REASONS[code] for code in codes.tolist()]
    assert (one.accepted, one.rejected, one.lost) == (
        columns.accepted,
        columns.rejected,
        columns.lost,
    )
    for reason, (_, payload) in zip(reasons, frames, strict=True):
        assert reason or spec.size <= len(payload) <= spec.longest


def wrong_keys(data: bytes) -> None:
    """A file with the count of wrong keys."""
    path = FOLDER / "security.keys"
    path.write_bytes(data)
    store = AttemptStore(path, lambda *_: None)
    assert 0 <= store.wrong <= 255
    for file in FOLDER.glob("security.keys*"):
        file.unlink()


@functools.cache
def _drive() -> list[Frame]:
    """The frames of a short simulated drive."""
    path = FOLDER / "simulated.log"
    minutes = str(DRIVE_S / 60.0)
    with contextlib.redirect_stdout(io.StringIO()):
        assert main(["simulate", "--out", str(path), "--seed", "5", "--minutes", minutes]) == 0
    lines = [line.split() for line in path.read_text().splitlines()]
    parts = [(stamp, *frame.partition("#")) for stamp, _, frame in lines]
    return [
        Frame(float(stamp[1:-1]), can_id, bytes.fromhex(text)) for stamp, can_id, _, text in parts
    ]


def replayed_drive(data: bytes) -> None:
    """Edits of a drive, through a whole replay."""
    path = FOLDER / "edited.log"
    path.write_text(edited(_drive(), data), "latin-1")
    _same_without_the_compiled_part(lambda: _replayed(path))


def _replayed(path: Path) -> Any:
    try:
        drive = imucald.replay(imucald.Config.load(EXAMPLE), path)
    except ImucaldError as error:
        return str(error)
    return drive.to_dict(), {name: table.as_dict() for name, table in drive.tables.items()}


TARGETS: dict[str, Callable[[bytes], None]] = {
    target.__name__: target
    for target in (
        configuration,
        model,
        database,
        log,
        packed_log,
        mf4_log,
        capture,
        file_names,
        expression,
        saved_state,
        saved_dtcs,
        isotp_frames,
        status_request,
        control_order,
        bus_frames,
        reload,
        frame_check,
        wrong_keys,
        replayed_drive,
    )
}
"""Entries by name; a new one is added here and gets seeds in corpus/NAME."""
