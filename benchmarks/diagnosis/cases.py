"""Which drives are diagnosed: kind, seed, length and hidden effects of each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hidden import CAUSES, OUTSIDE, Effect, random_effect
from hidden.effects import Size

PARTS = ("naming", "nulls", "pairs", "outside")
FIRST_SEED = 700_000
"""Far from the seeds that the diagnosis was tuned on (below 1000, and 300,000 to 330,100)."""
PER_CAUSE = 15
NULLS, PAIRS = 100, 60
SHORTEST_MIN, LONGEST_MIN = 20.0, 30.0
SIZE_NAMES: tuple[Size, Size, Size] = ("medium", "large", "small")
IDENTIFIABLE: tuple[Size, Size] = ("medium", "large")
GAIN_PER_CAUSE = 5
"""Of a cause's drives, so many go through the daemon as well, if the effect is not small."""
GAIN_NULLS = 20
PART_SEEDS = 10_000
"""Seeds of different parts lie this far apart."""


@dataclass(frozen=True)
class Case:
    """One drive to diagnose."""

    part: str
    seed: int
    minutes: float
    effects: tuple[Effect, ...]
    with_gain: bool = False
    """Also run the daemon's estimator and correction, without and with models."""

    @property
    def key(self) -> str:
        """Names the case in the file of outcomes."""
        hidden = "+".join(f"{e.cause}:{e.size}" for e in self.effects)
        return f"{self.part}/{self.seed}/{hidden}"


def cases(part: str, drives: int | None, first: int) -> Iterator[Case]:
    """Cases of a part; drives: per cause (naming, outside) or in all, default the full number."""
    start = first + PART_SEEDS * PARTS.index(part)
    gains = {"naming": GAIN_PER_CAUSE * len(CAUSES), "nulls": GAIN_NULLS}.get(part, 0)
    for i, effects in enumerate(_effects(part, drives, start)):
        rng = np.random.default_rng([start + i, 1])
        minutes = round(float(rng.uniform(SHORTEST_MIN, LONGEST_MIN)), 1)
        with_gain = i < gains and all(effect.size != "small" for effect in effects)
        yield Case(part, start + i, minutes, effects, with_gain)


def _effects(part: str, drives: int | None, start: int) -> Iterator[tuple[Effect, ...]]:
    rng = np.random.default_rng([start, 2])
    if part == "naming":
        # Causes alternate, so that a part of the run is a sample of all.
        for k in range(PER_CAUSE if drives is None else drives):
            for cause in CAUSES:
                yield (random_effect(rng, cause, SIZE_NAMES[k % 3]),)
    elif part == "nulls":
        yield from [()] * (NULLS if drives is None else drives)
    elif part == "pairs":
        for _ in range(PAIRS if drives is None else drives):
            first, second = (str(c) for c in rng.choice(CAUSES, 2, replace=False))
            sizes = (IDENTIFIABLE[int(rng.integers(2))], IDENTIFIABLE[int(rng.integers(2))])
            yield (random_effect(rng, first, sizes[0]), random_effect(rng, second, sizes[1]))
    else:
        for k in range(PER_CAUSE if drives is None else drives):
            for cause in OUTSIDE:
                yield (Effect(cause, SIZE_NAMES[k % 3]),)
