"""Protection as it is configured, against frames that an independent E2E implementation made."""

from __future__ import annotations

import binascii
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import e2e
import numpy as np
import pytest

from engine_bus import columns_of, load
from imucald.can.e2e import checksums
from imucald.can.e2e.checksum_engine import ChecksumSpec
from imucald.core.errors import ConfigError
from imucald.inputs.wiring import compile_router

SIZE = 20
DBC = f"""VERSION ""
BU_: CAR
BO_ 256 ACC: {SIZE} CAR
 SG_ CNT_LOW : 8|4@1+ (1,0) [0|0] "" CAR
 SG_ CNT_BEHIND : 40|4@1+ (1,0) [0|0] "" CAR
 SG_ AX : 96|16@1- (0.002,0) [-60|60] "m/s^2" CAR
 SG_ AY : 112|16@1- (0.002,0) [-60|60] "m/s^2" CAR
 SG_ AZ : 128|16@1- (0.002,0) [-60|60] "m/s^2" CAR
 SG_ CRC_LOW_FIRST : 144|16@1+ (1,0) [0|0] "" CAR
 SG_ CRC_HIGH_FIRST : 151|16@0+ (1,0) [0|0] "" CAR
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","StandardCAN_FD";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 256 2;
"""
HEAD = "database: bus.dbc\nsignals:\n  accelerometer: {x: ACC.AX, y: ACC.AY, z: ACC.AZ}\n"
IDS = list(range(7, 23))

Protect = Callable[[bytearray], None]

PROFILES: dict[str, tuple[str, Protect]] = {
    f"profile 1 {mode}": (
        f"kind: e2e_p1, data_id: 0x123, data_id_mode: {mode}",
        lambda frame, number=number: e2e.p01.e2e_p01_protect(frame, 0x123, data_id_mode=number),
    )
    for number, mode in enumerate(("both", "alternating", "low", "nibble"))
}
PROFILES |= {
    "profile 2": (
        f"kind: e2e_p2, data_id: {IDS}",
        lambda frame: e2e.p02.e2e_p02_protect(frame, bytes(IDS)),
    ),
    "profile 5": (
        "kind: e2e_p5, data_id: 0x4321",
        lambda frame: e2e.p05.e2e_p05_protect(frame, 0x4321, offset=0),
    ),
    "profile 5 behind four bytes": (
        "kind: e2e_p5, data_id: 0x4321, offset: 4",
        lambda frame: e2e.p05.e2e_p05_protect(frame, 0x4321, offset=4),
    ),
    "profile 11": (
        "kind: e2e_p11, data_id: 0x123",
        lambda frame: e2e.p11.e2e_p11_protect(
            frame, 0x123, data_id_mode=e2e.p11.E2E_P11_DATAID_BOTH, offset=0
        ),
    ),
    "profile 11 nibble behind four bytes": (
        "kind: e2e_p11, data_id: 0x123, data_id_mode: nibble, offset: 4",
        lambda frame: e2e.p11.e2e_p11_protect(
            frame, 0x123, data_id_mode=e2e.p11.E2E_P11_DATAID_NIBBLE, offset=4
        ),
    ),
}


def frames_of(protect: Protect, count: int) -> list[bytes]:
    """Frames in a row, each made from the one before: that is where the counter is."""
    frame = bytearray(range(SIZE))
    frame[:12] = bytes(12)
    made = []
    for k in range(count):
        frame[13] = k % 8
        protect(frame)
        made.append(bytes(frame))
    return made


def outcome(folder: Path, message: str, frames: list[bytes]) -> tuple[int, dict[str, int]]:
    """Frames used and rejected."""
    router = compile_router(load(f"{HEAD}messages:\n  ACC: {{{message}}}\n", folder, DBC))
    for k, frame in enumerate(frames):
        router.frame(0.01 * k, 256, frame)
    return router.used, dict(router.rejected)


@pytest.mark.parametrize("name", PROFILES)
def test_a_profile_is_believed_round_its_wrap_and_a_flipped_bit_is_not(name: str, tmp_path) -> None:
    checksum, protect = PROFILES[name]
    message = f"checksum: {{{checksum}}}, recover_after: 0"
    frames = frames_of(protect, 600)
    assert outcome(tmp_path, message, frames) == (600, {})
    frames[300] = frames[300][:15] + bytes([frames[300][15] ^ 0x10]) + frames[300][16:]
    used, rejected = outcome(tmp_path, message, frames)
    assert used == 599
    assert rejected == {"checksum": 1}
    wrong = message.replace("0x123", "0x124").replace("0x4321", "0x4322").replace("[7,", "[9,")
    assert outcome(tmp_path, wrong, frames)[0] < 599


@pytest.mark.parametrize("name", PROFILES)
def test_a_lost_frame_is_no_fault_of_a_profile_and_an_old_one_is(name: str, tmp_path) -> None:
    checksum, protect = PROFILES[name]
    frames = frames_of(protect, 40)
    del frames[20]
    message = f"checksum: {{{checksum}}}, recover_after: 2"
    assert outcome(tmp_path, message, frames) == (39, {})
    frames.insert(30, frames[28])
    used, rejected = outcome(tmp_path, message, frames)
    assert (used, rejected) == (37, {"counter_reversed": 1, "untrusted": 2})


def test_a_counter_beside_a_profile_allows_losses_and_wraps_as_the_profile_does(tmp_path) -> None:
    for name, signal in (("profile 1 both", "CNT_LOW"),
                         ("profile 11 nibble behind four bytes", "CNT_BEHIND")):  # fmt: skip
        checksum, protect = PROFILES[name]
        frames = frames_of(protect, 60)
        message = f"checksum: {{{checksum}}}, counter: {{signal: {signal}}}"
        assert outcome(tmp_path, message, frames) == (60, {})
        del frames[30]
        loose = message.replace("}}", "").replace(f"{signal}}}", f"{signal}, max_step: 2}}")
        assert outcome(tmp_path, loose, frames) == (59, {})


@pytest.mark.parametrize(("key", "late", "rejected"), [
    ("cycle_time: 0.01", 0.05, 1),
    ("cycle_time: 0.01", 0.11, 0),
    ("cycle_time: 0.01, timeout_cycles: 4", 0.039, 1),
    ("cycle_time: 0.01, timeout_cycles: 4", 0.041, 0),
    ("timeout_cycles: 20", 9.0, 1),
])  # fmt: skip
def test_a_counter_starts_again_after_the_configured_cycles_of_silence(
    key: str, late: float, rejected: int, tmp_path
) -> None:
    checksum, protect = PROFILES["profile 1 both"]
    text = f"{HEAD}messages:\n  ACC: {{checksum: {{{checksum}}}, {key}}}\n"
    router = compile_router(load(text, tmp_path, DBC))
    for t, frame in ((1.0, 10), (1.0 + late, 8)):
        router.frame(t, 256, frames_of(protect, 20)[frame])
    assert router.rejected.total() == rejected


@pytest.mark.parametrize(
    ("signal", "order"), [("CRC_LOW_FIRST", "little"), ("CRC_HIGH_FIRST", "big")]
)
def test_a_new_kind_of_checksum_is_a_function_and_one_entry_in_the_table_of_kinds(
    signal: str, order: Literal["little", "big"], tmp_path, monkeypatch
) -> None:
    """CRC-16 XMODEM in two bytes of either order, against the standard library's."""

    def xmodem(size, position, id_bytes):
        return ChecksumSpec(size, position, 2, checksums.CCITT_POLYNOMIAL, prefixes=(id_bytes,))

    monkeypatch.setitem(checksums.KINDS, "crc16_xmodem", checksums.in_signal(xmodem))
    frames = []
    for k in range(5):
        payload = bytes([k]) * (SIZE - 2)
        crc = binascii.crc_hqx(b"\x01\x00" + payload, 0)
        frames.append(payload + crc.to_bytes(2, order))
    message = f"checksum: {{kind: crc16_xmodem, signal: {signal}, id_bytes: 2}}, recover_after: 0"
    assert outcome(tmp_path, message, frames) == (5, {})
    router = compile_router(load(f"{HEAD}messages:\n  ACC: {{{message}}}\n", tmp_path, DBC))
    router.columns(np.arange(5.0), columns_of((k, 256, f) for k, f in enumerate(frames)))
    assert (router.used, dict(router.rejected)) == (5, {})
    frames[2] = bytes(SIZE - 1) + b"1"
    assert outcome(tmp_path, message, frames) == (4, {"checksum": 1})


@pytest.mark.parametrize(("kind", "signal", "remedy"), [
    ("crc16_ccitt", "CNT_LOW", "is not 2 whole bytes"),
    ("crc8_j1850", "CRC_HIGH_FIRST", "is not one whole byte"),
])  # fmt: skip
def test_a_checksum_stands_in_whole_bytes(kind: str, signal: str, remedy: str, tmp_path) -> None:
    text = f"{HEAD}messages:\n  ACC: {{checksum: {{kind: {kind}, signal: {signal}}}}}\n"
    with pytest.raises(ConfigError, match=remedy):
        compile_router(load(text, tmp_path, DBC))
