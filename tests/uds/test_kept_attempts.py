"""Wrong keys are remembered over restarts: whoever can cut the power gets no more of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from imucald.core.files import with_checksum
from imucald.service.uds_records import AttemptStore
from uds_bench import Bench, key_of

DELAY_S = 10.0
WRONG = b"\x27\x02" + b"no such key here"
NOT_YET, INVALID, EXCEEDED = (bytes([0x7F, 0x27, code]) for code in (0x37, 0x35, 0x36))


class Unit:
    """A server that is switched off and on again; its count of wrong keys is in a file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.lines: list[str] = []
        self.switch_on()

    def switch_on(self) -> None:
        self.store = AttemptStore(self.path, lambda text, _: self.lines.append(text))
        self.bench = Bench(wrong=self.store.wrong, on_count=self.store.put_count, delay=DELAY_S)
        self.bench.ask("10 03")

    def restart(self) -> None:
        self.store.close()
        self.switch_on()

    def try_key(self, right: bool = False) -> bytes | None:
        seed = self.bench.server.handle(b"\x27\x01")
        assert seed is not None
        if seed[0] == 0x7F:
            return seed
        return self.bench.server.handle(b"\x27\x02" + key_of(seed[2:]) if right else WRONG)

    def wait(self) -> None:
        self.bench.clock.now += DELAY_S
        self.bench.ask("10 03")


@pytest.fixture
def unit(tmp_path: Path) -> Unit:
    return Unit(tmp_path / "security.keys")


def test_a_restart_after_a_wrong_key_costs_the_delay_and_forgets_none(unit):
    assert unit.try_key() == INVALID
    unit.restart()
    assert unit.try_key() == NOT_YET
    unit.wait()
    assert unit.try_key() == INVALID  # the second of three
    unit.restart()
    unit.wait()
    assert unit.try_key() == EXCEEDED
    unit.restart()
    assert unit.try_key(right=True) == NOT_YET
    unit.wait()
    assert unit.try_key() == EXCEEDED  # one more, then closed again


def test_no_number_of_restarts_lets_more_than_one_key_be_judged_in_a_delay(unit):
    judged = 0
    assert unit.try_key() == INVALID
    for _ in range(20):
        unit.restart()
        judged += unit.try_key() != NOT_YET
    assert judged == 0


def test_a_right_key_and_a_unit_that_was_never_tried_start_without_a_delay(unit):
    assert unit.try_key(right=True) == b"\x67\x02"
    unit.restart()
    assert unit.try_key() == INVALID
    unit.wait()
    assert unit.try_key(right=True) == b"\x67\x02"
    unit.restart()
    assert unit.try_key(right=True) == b"\x67\x02"


@pytest.mark.parametrize(
    "content",
    [b"", b"junk", b"imucald-keys 1 00\n{}", b"x" * 10_000, b"imucald-keys 1 " + b"9" * 100],
)
def test_a_damaged_count_is_one_wrong_key_and_is_reported(content, unit):
    unit.store.close()
    unit.path.write_bytes(content)
    unit.switch_on()
    assert unit.try_key() == NOT_YET
    assert "damaged" in unit.lines[0]
    unit.wait()
    assert unit.try_key(right=True) == b"\x67\x02"


def test_a_count_in_the_first_format_is_read(unit):
    unit.store.close()
    unit.path.write_bytes(with_checksum("imucald-keys 1", b'{"wrong": 2}'))
    unit.switch_on()
    assert unit.store.wrong == 2
    assert unit.lines == []


def test_a_count_that_cannot_be_kept_stops_nothing(tmp_path):
    (tmp_path / "folder").write_text("no folder")
    unit = Unit(tmp_path / "folder" / "security.keys")
    assert unit.store.wrong == 1, "what cannot be read costs the delay"
    unit.wait()
    assert unit.try_key() == INVALID
    unit.store.close()
    assert any("cannot be saved" in line for line in unit.lines)
