"""Codec against cantools in the same run: one frame at a time, and whole columns.

    python benchmarks/codec.py [--json]

Messages: an accelerometer of three whole-byte signals, one of ten-bit signals that cross bytes
(both little-endian), a Motorola one, a multiplexed one, and a CAN FD frame with floats. Times are
the best of several rounds, in
microseconds of processor time a frame.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
import timeit
from collections.abc import Callable
from typing import Any

import cantools.database  # after imucald: python-can then comes without its heavy readers
import numpy as np

from imucald.can.dbc.database import load_database_text
from imucald.can.dbc.decode import compile_decode
from imucald.can.dbc.encode import compile_encode
from imucald.can.e2e.checksums import E2E_COUNTERS, crc8_j1850, e2e_profile_1
from imucald.can.e2e.protection import MessageChecker
from imucald.can.e2e.protection_spec import ProtectionSpec
from imucald.can.e2e.protector import MessageProtector

ROWS = 100_000
HEAD = 'VERSION ""\nNS_ :\nBS_:\nBU_:\n'
MESSAGES = {
    "whole bytes": """BO_ 16 M: 8 X
 SG_ A : 0|16@1- (0.002,0) [0|0] "" X
 SG_ B : 16|16@1- (0.002,0) [0|0] "" X
 SG_ C : 32|16@1- (0.002,0) [0|0] "" X
""",
    "ten bits": """BO_ 16 M: 8 X
 SG_ A : 1|10@1+ (0.125,-64) [0|0] "" X
 SG_ B : 11|10@1+ (0.125,-64) [0|0] "" X
 SG_ C : 21|10@1+ (0.125,-64) [0|0] "" X
""",
    "Motorola": """BO_ 16 M: 8 X
 SG_ A : 3|12@0- (0.01,0) [0|0] "" X
 SG_ B : 19|12@0- (0.01,0) [0|0] "" X
 SG_ C : 35|12@0- (0.01,0) [0|0] "" X
""",
    "multiplexed": """BO_ 16 M: 8 X
 SG_ P M : 0|2@1+ (1,0) [0|0] "" X
 SG_ A m0 : 8|16@1- (0.01,0) [0|0] "" X
 SG_ B m1 : 8|16@1- (0.01,0) [0|0] "" X
 SG_ C m2 : 8|16@1- (0.01,0) [0|0] "" X
 SG_ D m3 : 8|16@1- (0.01,0) [0|0] "" X
""",
    "CAN FD floats": """BO_ 16 M: 64 X
 SG_ A : 0|32@1- (1,0) [0|0] "" X
 SG_ B : 263|32@0- (1,0) [0|0] "" X
 SG_ C : 448|64@1- (1,0) [0|0] "" X
SIG_VALTYPE_ 16 A : 1;
SIG_VALTYPE_ 16 B : 1;
SIG_VALTYPE_ 16 C : 2;
""",
}


def best(function: Callable[[], Any], number: int, rounds: int = 7) -> float:
    """Shortest processor time of one call [us]."""
    times = timeit.repeat(function, timer=time.process_time, number=number, repeat=rounds)
    return min(times) / number * 1e6


def measure(text: str) -> dict[str, float]:
    """Times a frame of one message [us]."""
    message = load_database_text(HEAD + text, "dbc").message("M")
    theirs = cantools.database.load_string(HEAD + text, "dbc").get_message_by_name("M")
    names = [s for s in message.signals if not message.signals[s].is_multiplexer]
    decode = compile_decode(message, names)
    rng = np.random.default_rng(1)
    width = 8 if message.length <= 8 else 64
    data = rng.integers(0, 256, (ROWS, width), dtype=np.uint8)
    if "CAN FD" in text or message.length > 8:  # ordinary numbers, not every pattern of bits
        data[:, 3] = data[:, 32] = data[:, 63] = 0x40
    length = np.full(ROWS, message.length, np.uint8)
    frame = data[0].tobytes()
    result = {
        "cantools decode": best(lambda: theirs.decode(frame, decode_choices=False), 5000),
        "decode": best(lambda: decode.decode(frame), 20000),
        "decode columns": best(lambda: decode.decode_columns(data, length), 3) / ROWS,
    }
    if message.signals[names[0]].selectors:
        return result
    encode = compile_encode(message, names)
    values = [v or 0.0 for v in decode.decode(frame)]
    by_name = dict(zip(names, values, strict=True))
    columns = decode.decode_columns(data, length).values
    result["cantools encode"] = best(lambda: theirs.encode(by_name), 5000)
    result["encode"] = best(lambda: encode.encode(values), 20000)
    result["encode columns"] = best(lambda: encode.encode_columns(columns), 3) / ROWS
    return result


def measure_checker(spec: ProtectionSpec) -> dict[str, float]:
    """Times of checker and protector a frame [us]."""
    protector = MessageProtector(spec)
    payloads = np.random.default_rng(2).integers(0, 256, (15 * 16 * 400, 8), dtype=np.uint8)
    sent = protector.protect_columns(payloads)
    times = 0.01 * np.arange(len(sent))
    length = np.full(len(sent), 8, np.uint8)
    few = [f.tobytes() for f in sent[: 15 * 16]]
    checker = MessageChecker(spec)
    broken = sent.copy()
    broken[np.random.default_rng(3).random(len(sent)) < 0.3, 5] ^= 1
    return {
        "check": best(lambda: [checker.check(0.0, f) for f in few], 20) / len(few),
        "check columns": best(
            lambda: MessageChecker(spec).check_columns(times, sent, length), 3
        ) / len(sent),
        "check columns, 30 % faults": best(
            lambda: MessageChecker(spec).check_columns(times, broken, length), 3
        ) / len(sent),
        "protect": best(lambda: protector.protect(few[0]), 10000),
        "protect columns": best(lambda: protector.protect_columns(payloads), 3) / len(sent),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    as_json = parser.parse_args().json
    codec = {name: measure(text) for name, text in MESSAGES.items()}
    guards = {
        "length only": measure_checker(ProtectionSpec(8)),
        "CRC-8 J1850": measure_checker(
            ProtectionSpec(8, None, crc8_j1850(8, 0, b"\x10\x00"), 0.01)
        ),
        "E2E profile 1": measure_checker(
            ProtectionSpec(8, E2E_COUNTERS[1].at(0), e2e_profile_1(8, 0x123), 0.01)
        ),
    }
    if as_json:
        json.dump({"codec_us": codec, "protection_us": guards}, sys.stdout, indent=1)
        return
    line = "{:<16}{:>10}{:>10}{:>8}{:>10}{:>8}"
    for verb in ("decode", "encode"):
        print(line.format(verb, "cantools", "frame", "ratio", "columns", "ratio"))
        for name, times in codec.items():
            if verb not in times:
                continue
            theirs, one, many = (times[k] for k in (f"cantools {verb}", verb, f"{verb} columns"))
            cells = (f"{theirs:.2f}", f"{one:.2f}", f"{theirs / one:.1f}x", f"{many:.4f}")
            print(line.format(name, *cells, f"{theirs / many:.0f}x"))
    for name, times in guards.items():
        print(name, *(f"{k} {v:.3f}" for k, v in times.items()), sep="; ")


if __name__ == "__main__":
    main()
