"""Which drives are diagnosed: named before the run, by part, log, piece, effect, size and draw."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

from benchmarks.diagnosis.measured_logs import LOGS
from benchmarks.diagnosis.outside_effects import OUTSIDE
from benchmarks.diagnosis.real_effects import EFFECTS
from benchmarks.measured import DATA, is_here
from hidden import CAUSES
from hidden import OUTSIDE as GENERATED_OUTSIDE

PARTS = ("nulls", "measured", "outside", "second_world", "generated", "generated_nulls",
         "generated_outside", "plain", "plain_nulls")  # fmt: skip
"""The generator's seeds count by this order."""
OF_LOGS = (*PARTS[:4], *PARTS[-2:])
"""Parts that need the measured drives."""
FIRST_SEED = 1_200_000
"""Far from the seeds that were looked at (below 1,000,000)."""
MINUTES = 20.0
PLAIN = (("kingston_2008", 2), ("css_canmod_164", 2), ("kingston_2008", 6), ("css_canmod_164", 4),
         ("vehsense_2018_08_04", 1))  # fmt: skip
"""Logs and the number of their pieces that `diagnose` gets without a model file: 29, 20, 10, 10 and
10 min."""
NOT_PLAIN = ("turned",)
"""Without a model file the mount is the one that the drive shows, so no turn of it is hidden."""


@dataclass(frozen=True)
class Case:
    """One diagnosis. log: a measured log, a drive of second_world, or a seed."""

    part: str
    log: str
    effect: str = ""
    level: int = 0
    draw: int = 0
    pieces: int = 2
    piece: int = 1

    @property
    def key(self) -> str:
        """Names the case in the file of outcomes."""
        return (
            f"{self.part}/{self.log}/{self.effect}/{self.level}/{self.draw}/"
            f"{self.piece}of{self.pieces}"
        )


def cases(part: str, draws: range, first_seed: int = FIRST_SEED) -> Iterator[Case]:
    """Cases of a part, in the order of the run: every log and effect early."""
    if part == "nulls":
        for pieces, log in product((2, 3), filter(is_here, LOGS)):
            yield from (Case(part, log, "", 0, 0, pieces, i) for i in range(pieces))
    elif part == "measured":
        logs = [log for log in LOGS if is_here(log)]
        for draw, level, effect, (i, log) in product(draws, (1, 2, 0, 3), EFFECTS, enumerate(logs)):
            # Halves take turns, so that both are model and test.
            yield Case(part, log, effect, level, draw, 2, (i + level + draw) % 2)
    elif part == "outside":
        for draw, effect in product(draws, OUTSIDE):
            yield from (Case(part, log, effect, 1, draw, 2, draw % 2)
                            for log in filter(is_here, LOGS))  # fmt: skip
    elif part in ("plain", "plain_nulls"):
        yield from _plain(part, draws)
    elif part == "second_world":
        folder = DATA / "second_world"
        if folder.is_dir():
            for path in sorted(p for p in folder.iterdir() if p.is_dir()):
                yield Case(part, path.name, path.name.partition("_")[2])
    else:
        yield from _generated(part, draws, first_seed)


def _plain(part: str, draws: range) -> Iterator[Case]:
    logs = [(log, pieces) for log, pieces in PLAIN if is_here(log)]
    if part == "plain_nulls":
        yield from (Case(part, log, "", 0, 0, n, i) for log, n in logs for i in range(n))
        return
    effects = enumerate(effect for effect in EFFECTS if effect not in NOT_PLAIN)
    for draw, level, (i, effect), (log, n) in product(draws, (2, 1), effects, logs):
        yield Case(part, log, effect, level, draw, n, (i + level + draw) % n)


def _generated(part: str, draws: range, first_seed: int) -> Iterator[Case]:
    names = {"generated": CAUSES, "generated_nulls": ("",) * 10,
             "generated_outside": GENERATED_OUTSIDE}[part]  # fmt: skip
    for draw in draws:
        seed = first_seed + 10_000 * PARTS.index(part) + 100 * draw
        for level in (1, 2) if part == "generated" else (1,):
            for effect in names:
                yield Case(part, str(seed), effect, level, draw)
                seed += 1
