"""Random CAN messages as DBC text, for tests."""

from __future__ import annotations

import random
from dataclasses import dataclass

import cantools.database
from cantools.database.can import Message

SIZES = (1, 2, 3, 5, 8, 8, 8, 12, 20, 64)
SCALES = (1, 1, 2, -3, 0.1, 0.01, -0.5, 0.0155168902, 1e-6, 0.25, 2.0, 1000, 1.0000001)
LENGTHS = (1, 2, 7, 8, 8, 9, 12, 16, 16, 24, 31, 32, 33, 53, 54, 63, 64)
FLOAT_LENGTHS = (16, 32, 64)
OFFSETS = (0, 0, -40, 7, 0.5, -273.15, 1e6, -0.001)


@dataclass(frozen=True)
class Sg:
    """One signal, as a DBC says it. `under`: multiplexer's name and the values of it."""

    name: str
    start: int
    length: int
    is_big: bool
    is_signed: bool = False
    is_float: bool = False
    scale: float = 1
    offset: float = 0
    is_multiplexer: bool = False
    under: tuple[str, tuple[int, ...]] | None = None

    def line(self) -> str:
        mark = f" m{self.under[1][0]}" if self.under else ""
        if self.is_multiplexer:
            mark = f"{mark}M" if mark else " M"
        layout = f"{self.start}|{self.length}@{0 if self.is_big else 1}"
        sign = "-" if self.is_signed or self.is_float else "+"
        factor = f"({self.scale!r},{self.offset!r})"
        return f' SG_ {self.name}{mark} : {layout}{sign} {factor} [0|0] "" Vector__XXX'


def dbc_text(can_id: int, size: int, signals: list[Sg]) -> str:
    """DBC of one message ``M``; `can_id` with bit 31 for 29 bits."""
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_:", f"BO_ {can_id} M: {size} Vector__XXX"]
    lines += [s.line() for s in signals]
    lines += [
        f"SIG_VALTYPE_ {can_id} {s.name} : {2 if s.length == 64 else 1};"
        for s in signals
        if s.is_float
    ]
    for s in signals:
        if s.under:
            ids = ", ".join(f"{i}-{i}" for i in s.under[1])
            lines.append(f"SG_MUL_VAL_ {can_id} {s.name} {s.under[0]} {ids};")
    return "\n".join(lines) + "\n"


def bits_of(start: int, length: int, is_big: bool, size: int) -> set[int] | None:
    """Bit numbers (8 * byte + bit) that a signal covers; None where it leaves the message."""
    if is_big:
        first = 8 * (start // 8) + 7 - start % 8
        bits = {8 * (n // 8) + 7 - n % 8 for n in range(first, first + length)}
    else:
        bits = set(range(start, start + length))
    return bits if max(bits) < 8 * size else None


def place(
    rng: random.Random, size: int, taken: set[int], lengths: tuple[int, ...]
) -> tuple[int, int, bool] | None:
    """Free start bit, length and byte order, which are then taken; None where none was found."""
    for _ in range(12):
        length = rng.choice(lengths)
        is_big = rng.random() < 0.5
        start = rng.randrange(8 * size)
        if rng.random() < 0.5:  # whole bytes are the common case, with a path of their own
            start = start // 8 * 8 + (7 if is_big else 0)
        bits = bits_of(start, length, is_big, size)
        if bits is not None and not bits & taken:
            taken |= bits
            return start, length, is_big
    return None


def signal(
    rng: random.Random,
    name: str,
    size: int,
    taken: set[int],
    under: tuple[str, tuple[int, ...]] | None = None,
) -> list[Sg]:
    """One signal on free bits, or none."""
    is_float = rng.random() < 0.2
    found = place(rng, size, taken, FLOAT_LENGTHS if is_float else LENGTHS)
    if found is None:
        return []
    is_signed = rng.random() < 0.5
    scale, offset = rng.choice(SCALES), rng.choice(OFFSETS)
    return [Sg(name, *found, is_signed, is_float, scale, offset, under=under)]


def branches(rng: random.Random, parent: Sg, size: int, taken: set[int], depth: int) -> list[Sg]:
    """Signals under a multiplexer: each under some of its values, some of them nested deeper."""
    signals: list[Sg] = []
    values = list(range(1 << min(parent.length, 3)))
    rng.shuffle(values)
    for branch in range(rng.randint(1, 3)):
        ids, values = tuple(sorted(values[:2])), values[2:]
        if not ids:
            break
        used = set(taken)
        under = (parent.name, ids[: rng.randint(1, 2)])
        for i in range(rng.randint(1, 2)):
            signals += signal(rng, f"{parent.name}{branch}S{i}", size, used, under)
        if depth > 0 and rng.random() < 0.6:
            found = place(rng, size, used, (2, 4))
            if found is not None:
                name = f"{parent.name}{branch}M"
                nested = Sg(name, *found, is_multiplexer=True, under=under)
                signals += [nested, *branches(rng, nested, size, used, depth - 1)]
    return signals


def random_dbc(rng: random.Random, multiplexed: bool) -> str:
    """DBC text of one message ``M`` with signals on random bits."""
    size = rng.choice(SIZES)
    taken: set[int] = set()
    signals: list[Sg] = []
    if multiplexed:
        found = place(rng, size, taken, (2, 4, 8))
        if found is not None:
            top = Sg("X", *found, is_multiplexer=True)
            below = branches(rng, top, size, taken, depth=1)
            signals += [top, *below]
            for s in below:
                taken |= bits_of(s.start, s.length, s.is_big, size) or set()
    for i in range(rng.randint(1, 5)):
        signals += signal(rng, f"S{i}", size, taken)
    can_id = rng.choice((rng.randrange(1 << 11), 1 << 31 | rng.randrange(1 << 29)))
    return dbc_text(can_id, size, signals)


def cantools_message(text: str) -> Message:
    """The message ``M`` of DBC text, as cantools reads it."""
    return cantools.database.load_string(text, "dbc").get_message_by_name("M")
