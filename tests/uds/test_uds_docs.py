"""docs/uds.md says what the code does."""

from __future__ import annotations

import ast
import re

import pytest

from imucald.service.uds_on_bus import TRANSPORT_COUNTERS_IDENTIFIER
from imucald.uds.codes import Nrc
from imucald.uds.dtc import DTCS
from imucald.uds.identifiers import COUNTED_FAULTS, MAX_RESPONSE
from imucald.uds.isotp_channel import FRAMES_PER_SECOND, MAX_REQUEST
from imucald.uds.routines import CALIBRATE, CHECK_SENSORS, RESET
from paths import ROOT
from uds_bench import Bench

PAGE = (ROOT / "docs" / "uds.md").read_text()


def rows(heading: str) -> dict[int, list[str]]:
    """Rows of the tables under a heading, by the number in their first cell."""
    part = PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    found = re.findall(r"^\| `(0x[0-9A-F]+)` \|(.*)\|$", part, re.M)
    return {int(first, 16): [c.strip() for c in rest.split("|")] for first, rest in found}


def test_services_and_refusals() -> None:
    """Some numbers are a service and a refusal: the section has two tables."""
    text = PAGE.split("\n## Services\n")[1].split("\n## ")[0]
    bench = Bench()
    for sid in range(0x40):
        answered = bench.server.handle(bytes([sid])) != bytes([0x7F, sid, 0x11])
        row = re.search(rf"^\| `0x{sid:02X}` \|.*\| (all|extended) \|", text, re.M)
        assert answered == (row is not None), hex(sid)
    for code in set(Nrc) - {Nrc.SUB_FUNCTION_NOT_IN_SESSION}:  # which is never told
        words = code.name.lower().replace("_", " ").split()[-1]
        assert re.search(rf"^\| `0x{code:02X}` \| [a-z -]*{words}", text, re.M), code.name


def test_identifiers() -> None:
    documented = rows("Data identifiers")
    bench = Bench()
    known = {TRANSPORT_COUNTERS_IDENTIFIER}  # the transport adds it
    for number in range(0x10000):
        answer = bench.server.handle(b"\x22" + number.to_bytes(2, "big"))
        known |= {number} if answer[0] == 0x62 else set()
    assert set(documented) == known
    reasons = documented[0xFD09][1].split(":")[1]
    assert len(reasons.split(",")) == len(COUNTED_FAULTS)
    for reason, name in zip(COUNTED_FAULTS, reasons.split(","), strict=True):
        assert reason.split("_")[-1][:4] in name.replace("jumping", "jump").replace("-", ""), reason


def test_dtcs() -> None:
    documented = rows("DTCs")
    assert [(n, row[0], row[1]) for n, row in documented.items()] == [
        (t.number, t.display, t.name.replace("_", " ")) for t in DTCS
    ]


def test_routines() -> None:
    assert {n: row[0] for n, row in rows("Routines").items()} == {
        CALIBRATE: "calibrate",
        RESET: "reset",
        CHECK_SENSORS: "check sensors",
    }


def test_limits() -> None:
    assert f"may have up to {MAX_REQUEST} bytes, a response up to {MAX_RESPONSE}" in PAGE
    assert f"at most {FRAMES_PER_SECOND:.0f} frames a second" in PAGE


def test_the_key_function_of_the_page_lets_in() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.S)
    ast.parse(code)
    scope: dict[str, object] = {}
    exec(code, scope)
    key = scope["key"]
    bench = Bench(key_function=key)
    bench.ask("10 03")
    seed = bench.server.handle(b"\x27\x01")
    assert seed is not None
    assert bench.server.handle(b"\x27\x02" + key(seed[2:])) == b"\x67\x02"  # type: ignore[operator]
    assert bench.server.security.unlocked


@pytest.mark.parametrize("name", ["pip install '.[diagnostics]'", "key_function"])
def test_what_to_do_is_stated(name: str) -> None:
    assert name in PAGE
