"""The bus link on a kernel's CAN, with can-utils as the other nodes."""

from __future__ import annotations

import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_SFF_MASK, IdMatch
from imucald.can.link.link import Link, LinkEvent, LinkState
from imucald.core.errors import LinkError

pytestmark = pytest.mark.slow

WANTED = IdMatch(0x123, CAN_SFF_MASK)
OWN = 0x600
RESUME_LIMIT_S = 1.0


def open_link(channel: str, **options: Any) -> Link:
    return Link("socketcan", channel, **{"receive": [WANTED], "own_ids": [OWN], **options})


def wait_for_frame(link: Link, limit: float = 5.0) -> list[Any]:
    end = time.monotonic() + limit
    while not (frames := link.receive(0.1)) and time.monotonic() < end:
        pass
    return frames


@contextmanager
def running(*command: str) -> Iterator[None]:
    """Another program beside us until the block ends."""
    program = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield
    finally:
        program.terminate()
        program.wait(10)


@contextmanager
def sender(channel: str, period: float = 0.01) -> Iterator[None]:
    """Another node that sends 0x123 whenever the interface is there, however often it goes."""
    stop = threading.Event()

    def work() -> None:
        frame = struct.pack("=IB3x8s", 0x123, 1, b"\x01")
        while not stop.wait(period):
            try:
                with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
                    bus.bind((channel,))
                    bus.send(frame)
            except OSError:
                continue

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def frames_matched_by_the_kernel(channel: str) -> list[tuple[int, int, int]]:
    """(id, mask, frames delivered) of each receive filter that the kernel keeps for a channel."""
    rows = []
    for kind in ("all", "fil", "inv", "sff", "eff"):
        for line in Path(f"/proc/net/can/rcvlist_{kind}").read_text().splitlines():
            words = line.split()
            if words[:1] == [channel]:
                rows.append((int(words[1], 16), int(words[2], 16), int(words[5])))
    return rows


def test_the_kernel_itself_keeps_foreign_frames_away(vcan: Any) -> None:
    j1939 = IdMatch(0x18FEF100 | CAN_EFF_FLAG, 0x00FFFF00)
    with open_link(vcan.name, receive=[WANTED, j1939]) as link:
        vcan.send("124#01")
        vcan.send("00000123#02")  # 29 bits
        vcan.send("123#R2")  # remote
        vcan.send("123#03")
        vcan.send("0CFEF127#04")
        vcan.send("123##105")  # CAN FD, which this link does not speak
        kept = frames_matched_by_the_kernel(vcan.name)
        frames = wait_for_frame(link)
    assert [(can_id, data) for _, can_id, data in frames] == [
        (0x123, b"\x03"),
        (0x0CFEF127 | CAN_EFF_FLAG, b"\x04"),
    ]
    assert link.counters.foreign == 0
    masks = {(can_id, mask) for can_id, mask, _ in kept}
    assert (0x123, 0xC00007FF) in masks
    assert (0x98FEF100 & 0x80FFFF00, 0xC0FFFF00) in masks
    assert (OWN, 0xC00007FF) in masks


def test_stamps_are_those_that_candump_writes(vcan: Any) -> None:
    candump = subprocess.Popen(
        ["candump", "-L", "-n", "20", "-T", "5000", vcan.name], stdout=subprocess.PIPE, text=True
    )
    with open_link(vcan.name) as link:
        frames = []
        while candump.poll() is None:
            vcan.send("123#AABB")
            frames += link.receive(0.01)
    assert candump.stdout is not None
    written = [float(line.split()[0].strip("()")) for line in candump.stdout]
    assert len(written) == 20
    stamps = [t for t, _, _ in frames]
    assert stamps == sorted(stamps)
    assert set(written) <= set(stamps)  # the same doubles


def test_candump_hears_us_and_we_do_not(vcan: Any) -> None:
    everything = [IdMatch(0, 0), IdMatch(CAN_EFF_FLAG, 0)]
    with open_link(vcan.name, receive=everything) as link:
        ours = len(frames_matched_by_the_kernel(vcan.name))
        candump = subprocess.Popen(
            ["candump", "-L", "-n", "3", "-T", "5000", vcan.name], stdout=subprocess.PIPE, text=True
        )
        while len(frames_matched_by_the_kernel(vcan.name)) == ours and candump.poll() is None:
            time.sleep(0.02)  # until it listens
        assert link.send(OWN, b"\x01\x02")
        assert link.send(0x18FF0001 | CAN_EFF_FLAG, b"")
        assert link.send(0x601, bytes(8))
        assert link.receive(0.1) == []
    assert candump.stdout is not None
    heard = [line.split()[2] for line in candump.stdout]
    assert heard == ["600#0102", "18FF0001#", "601#0000000000000000"]
    assert (link.counters.sent, link.counters.conflicts) == (3, 0)


def test_a_second_node_on_our_ids_is_a_conflict(vcan: Any) -> None:
    events: list[LinkEvent] = []
    own = [OWN, 0x18FF0001 | CAN_EFF_FLAG]
    with open_link(vcan.name, own_ids=own, on_event=events.append) as link:
        link.send(OWN, b"\x01")
        vcan.send("600#01")
        vcan.send("18FF0001#01")
        vcan.send("00000600#01")  # 29 bits: not ours
        vcan.send("123#01")
        frames = wait_for_frame(link)
    assert [data for _, _, data in frames] == [b"\x01"]
    assert link.counters.conflicts == 2
    assert [event.kind for event in events] == ["up", "conflict"]


def test_fd_frames_both_ways(vcan: Any) -> None:
    candump = subprocess.Popen(
        ["candump", "-L", "-n", "1", "-T", "5000", f"{vcan.name},600:7FF"],
        stdout=subprocess.PIPE,
        text=True,
    )
    with open_link(vcan.name, fd=True) as link:
        vcan.send("123##1" + "5A" * 64)
        vcan.send("123#5A")
        frames = wait_for_frame(link)
        assert [data for _, _, data in frames] == [b"\x5a" * 64, b"\x5a"]
        while candump.poll() is None:
            assert link.send(OWN, bytes(range(33)))  # padded to the next length that FD has
            time.sleep(0.05)
    assert candump.stdout is not None
    heard = candump.stdout.read().split()[2]
    assert heard == "600##5" + bytes(range(33)).hex().upper() + "00" * 15


def test_an_fd_frame_is_refused_by_a_classic_interface(vcan: Any) -> None:
    vcan.down()
    subprocess.run(["ip", "link", "set", "dev", vcan.name, "mtu", "16"], check=True)
    vcan.up()
    with open_link(vcan.name, fd=True) as link:
        assert not link.send(OWN, bytes(12))
        assert link.send(OWN, bytes(8))
    assert link.counters.send_errors == {"refused": 1}


def test_frames_resume_within_a_second_after_each_down_and_up(vcan: Any) -> None:
    cycles, slowest = 20, 0.0
    with open_link(vcan.name) as link, sender(vcan.name):
        assert wait_for_frame(link)
        for _ in range(cycles):
            vcan.down()
            end = time.monotonic() + 0.05
            while time.monotonic() < end:
                link.receive(0.05)
            assert link.state is LinkState.DOWN
            assert not link.send(OWN, b"\x01")
            vcan.up()
            start = time.monotonic()
            assert wait_for_frame(link)
            slowest = max(slowest, time.monotonic() - start)
            assert link.state is LinkState.UP
    assert link.counters.went_down == cycles
    assert link.counters.reopened == 0
    assert link.counters.send_errors == {"down": cycles}
    assert slowest < RESUME_LIMIT_S


def test_down_and_up_faster_than_anybody_looks(vcan: Any) -> None:
    with open_link(vcan.name) as link:
        for _ in range(30):
            vcan.down()
            vcan.up()
        vcan.send("123#01")
        assert wait_for_frame(link, 1.0)
        assert link.send(OWN, b"\x01")
        assert link.state is LinkState.UP


@pytest.mark.parametrize("absence", [0.0, 0.25])
def test_frames_resume_within_a_second_after_delete_and_create(vcan: Any, absence: float) -> None:
    cycles, slowest = 10, 0.0
    with open_link(vcan.name) as link, sender(vcan.name):
        assert wait_for_frame(link)
        for _ in range(cycles):
            vcan.delete()
            if absence:
                assert link.receive(absence) is not None
                link.receive(0)
                assert link.state is LinkState.ABSENT
                assert not link.send(OWN, b"\x01")
            vcan.create()
            start = time.monotonic()
            assert wait_for_frame(link)
            slowest = max(slowest, time.monotonic() - start)
            assert link.send(OWN, b"\x01")
    assert link.counters.reopened == cycles
    assert slowest < RESUME_LIMIT_S


def test_a_flooded_bus_with_a_slow_reader_counts_what_was_lost(vcan: Any) -> None:
    everything = [IdMatch(0, 0), IdMatch(CAN_EFF_FLAG, 0)]
    count = 5000
    with open_link(vcan.name, receive=everything, receive_buffer=20_000) as link:
        flood = ["cangen", vcan.name, "-g", "0", "-n", str(count), "-I", "i", "-L", "8"]
        subprocess.run(flood, check=True, capture_output=True)
        early = link.receive(0.1)
        while more := link.receive(0.1):
            early += more
        vcan.send("123#01")  # the kernel tells the drops with the next frame that it delivers
        assert len(wait_for_frame(link)) == 1
        assert 0 < len(early) < count
        assert link.counters.lost == count - len(early)
        assert link.counters.received == len(early) + 1
    assert link.receive_buffer == 0  # closed


def test_what_was_lost_before_the_interface_went_is_counted_too(vcan: Any) -> None:
    """The socket's error comes before what waits, and no frame tells the drops any more."""
    count = 2000
    with open_link(vcan.name, receive_buffer=20_000) as link:
        flood = ["cangen", vcan.name, "-g", "0", "-n", str(count), "-I", "123", "-L", "8"]
        subprocess.run(flood, check=True, capture_output=True)
        vcan.delete()
        received = len(link.receive(0.1))
        assert link.state is LinkState.ABSENT
        assert received + link.counters.lost == count


def test_a_flood_of_foreign_frames_costs_none_of_ours(vcan: Any) -> None:
    """The filter keeps the flood out of our buffer, however small that is."""
    flood = ("cangen", vcan.name, "-g", "0", "-I", "555", "-L", "8")
    count, got = 25, []
    with open_link(vcan.name, receive_buffer=20_000) as link, running(*flood):
        for number in range(count):
            vcan.send(f"123#{number:02X}")
            got += link.receive(0.0)
        while frames := link.receive(0.3):
            got += frames
    assert [data[0] for _, _, data in got] == list(range(count))
    assert link.counters.lost == 0


def test_error_frames_tell_of_bus_off_and_restart(vcan: Any) -> None:
    with open_link(vcan.name) as link:
        vcan.send("20000040#0000000000000000")
        link.receive(0.2)
        assert link.state is LinkState.BUS_OFF
        vcan.send("20000100#0000000000000000")
        link.receive(0.2)
        assert link.state is LinkState.UP
    assert (link.counters.bus_off, link.counters.error_frames) == (1, 2)


def test_opening_what_is_not_there_is_an_error_with_a_remedy() -> None:
    with pytest.raises(LinkError, match="ip link add dev nocan type vcan"):
        open_link("nocan")
    with pytest.raises(LinkError, match="lo is not a CAN interface"):
        open_link("lo")


def test_waiting_for_an_interface_that_comes_later(make_vcan: Any) -> None:
    vcan = make_vcan()
    vcan.delete()
    with open_link(vcan.name, wait=True) as link:
        assert link.receive(0.1) == []
        assert link.state is LinkState.ABSENT
        vcan.create()
        with sender(vcan.name):
            assert wait_for_frame(link, 1.0)
    assert link.counters.reopened == 0


def test_opening_an_interface_that_is_down_waits_for_it(vcan: Any) -> None:
    vcan.down()
    events: list[LinkEvent] = []
    with open_link(vcan.name, on_event=events.append) as link:
        assert link.receive(0.1) == []
        assert link.state is LinkState.DOWN
        assert f"ip link set up {vcan.name}" in events[0].text
        vcan.up()
        with sender(vcan.name):
            assert wait_for_frame(link, 1.0)
    assert [event.kind for event in events] == ["down", "up"]
    assert link.counters.went_down == 0


def test_two_thousand_ids_are_more_than_the_kernel_filters_and_still_sorted(vcan: Any) -> None:
    matches = [IdMatch(can_id, CAN_SFF_MASK) for can_id in range(0, 0x400)]
    extended = [IdMatch(i | CAN_EFF_FLAG, CAN_EFF_MASK) for i in range(1000)]
    with open_link(vcan.name, receive=matches + extended) as link:
        for frame in ("3FF#01", "400#02", "000003E7#03", "000003E8#04"):
            vcan.send(frame)
        frames = wait_for_frame(link)
    assert [data[0] for _, _, data in frames] == [1, 3]
