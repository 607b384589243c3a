"""The ground under the vcan tests: frames really pass through a kernel's CAN."""

from __future__ import annotations

import socket
import struct
import subprocess
from typing import Any

import pytest

pytestmark = pytest.mark.slow

FRAME = struct.Struct("=IB3x8s")


def test_a_frame_of_another_program_arrives(vcan: Any) -> None:
    with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
        bus.bind((vcan.name,))
        bus.settimeout(5)
        vcan.send("123#DEADBEEF")
        can_id, length, data = FRAME.unpack(bus.recv(16))
    assert (can_id, data[:length].hex()) == (0x123, "deadbeef")


def test_candump_hears_what_we_send(vcan: Any) -> None:
    command = ["candump", "-L", "-n", "1", "-T", "5000", vcan.name]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as candump:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as bus:
            bus.bind((vcan.name,))
            while candump.poll() is None:  # until it listens
                bus.send(FRAME.pack(0x7FF, 2, b"\x01\x02"))
        assert candump.stdout is not None
        assert candump.stdout.read().split()[1:] == [vcan.name, "7FF#0102"]


def test_interfaces_of_one_test_are_gone_in_the_next(make_vcan: Any) -> None:
    first, second = make_vcan(), make_vcan()
    names = {name for _, name in socket.if_nameindex() if name.startswith("vcan")}
    assert names == {first.name, second.name}
