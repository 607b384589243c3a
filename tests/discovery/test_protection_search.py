"""Counters and checksums are found by trying, data ids of E2E profiles included."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from imucald.can.dbc.message import Message, Signal
from imucald.can.e2e.checksum_engine import Checksum
from imucald.can.e2e.protector import MessageProtector
from imucald.config import MessageProtection, parse_config
from imucald.discovery.candidates import MessageTraffic
from imucald.discovery.protection_search import find_protection
from imucald.inputs.settings_of_signals import checker_for

FRAMES = 400


def message(can_id: int = 0x123) -> Message:
    """Bytes 0 to 7; the last is a checksum, the low half of the one before it a counter."""
    signals = [Signal(f"B{i}", 8 * i, 8) for i in range(6)]
    signals += [Signal("Count", 48, 4), Signal("Rest", 52, 4), Signal("Check", 56, 8)]
    return Message("M", can_id, 8, {s.name: s for s in signals})


def settings_of(protection: Mapping[str, Any]) -> MessageProtection:
    """What a configuration makes of a message's protection."""
    signals = {"accelerometer": {a: f"M.B{i}" for i, a in enumerate("xyz")}}
    whole = {"database": "x.dbc", "signals": signals, "messages": {"M": dict(protection)}}
    return parse_config(json.dumps(whole)).config.messages["M"]


def traffic(protection: dict[str, Any], seed: int = 1) -> MessageTraffic:
    """Frames of random bytes with a protection, at the end or in an E2E header."""
    data = np.random.default_rng(seed).integers(0, 256, (FRAMES, 8), dtype=np.uint8)
    if protection.get("checksum", {}).get("kind", "").startswith("e2e"):
        data[:, :3] = 0
    else:
        data[:, 6:] = 0
    spec = checker_for(message(), settings_of(protection)).spec
    protected = MessageProtector(spec).protect_columns(data)
    t = np.arange(FRAMES) * 0.01
    return MessageTraffic(message(), "can0", t, protected, np.full(FRAMES, 8, np.uint8))


@pytest.mark.parametrize(
    "protection",
    [
        {"counter": {"signal": "Count"}},
        {"counter": {"signal": "Count", "modulus": 15}},
        {"counter": {"signal": "Count"}, "checksum": {"kind": "xor", "signal": "Check"}},
        {"counter": {"signal": "Count"}, "checksum": {"kind": "crc8_j1850", "signal": "Check"}},
        {
            "counter": {"signal": "Count"},
            "checksum": {"kind": "crc8_j1850", "signal": "Check", "id_bytes": 2},
        },
        {"checksum": {"kind": "e2e_p1", "data_id": 0x5A, "data_id_mode": "low"}},
        {"checksum": {"kind": "e2e_p1", "data_id": 0x1234, "data_id_mode": "alternating"}},
        {"checksum": {"kind": "e2e_p2", "data_id": [(7 * i + 3) % 256 for i in range(16)]}},
        {"checksum": {"kind": "e2e_p5", "data_id": 0xBEEF}},
    ],
    ids=lambda p: str(p.get("checksum", p.get("counter"))),
)
def test_what_protects_a_message_is_found(protection):
    found = find_protection(traffic(protection))
    assert found is not None
    assert found.settings == protection


def test_an_id_of_two_bytes_is_found_as_one_that_gives_the_same_checksums():
    one = traffic({"checksum": {"kind": "e2e_p1", "data_id": 0x1234}})
    found = find_protection(one)
    assert found is not None
    spec = checker_for(message(), settings_of(found.settings)).spec
    assert spec.checksum is not None
    assert Checksum(spec.checksum).are_right(one.data).all()


def test_random_bytes_are_not_protected():
    data = np.random.default_rng(5).integers(0, 256, (FRAMES, 8), dtype=np.uint8)
    t = np.arange(FRAMES) * 0.01
    one = MessageTraffic(message(), "can0", t, data, np.full(FRAMES, 8, np.uint8))
    assert find_protection(one) is None


def test_a_few_damaged_frames_do_not_hide_a_checksum():
    settings = {"kind": "crc8_j1850", "signal": "Check"}
    one = traffic({"counter": {"signal": "Count"}, "checksum": settings})
    one.data[100, 3] ^= 0x40
    found = find_protection(one)
    assert found is not None
    assert found.settings["checksum"] == settings
    assert "99.75 %" in found.evidence["checksum"]


def test_a_stuck_message_has_no_counter():
    one = traffic({"counter": {"signal": "Count"}})
    one.data[:] = one.data[0]
    assert find_protection(one) is None
