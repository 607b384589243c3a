"""Frames of another node, and an accelerometer that drifts: is anything good and wrong for long?

    python -m benchmarks.spoofing [--variant NAME ...] [--first SEED] [--drives N] [--jobs N]

Drives of 15 min. From 300 s on, for 120 s, another node that knows counter and checksum puts frames
in right behind true ones; or from 250 s on an axis drifts to the end. The judge is that of
`benchmarks.integrity`: a good frame whose value is off by more than 0.5 m/s^2 is wrong. Where the
drift is a tilt, the stated deviation may cover it; so seconds are told twice, all of them and those
in which four of the largest stated deviation are less than what the zero is off by: that of the
level zero where it is sent, else that of the tilt.
Exit status: 1 where a bar is not met (2 s of bursts and singles in each drive, none of a drift).
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small

import argparse
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context

import numpy as np
from msgspec import structs
from numpy.typing import NDArray

from benchmarks.integrity.bases import SIMULATED, Base
from benchmarks.integrity.bus import configuration, frames
from benchmarks.integrity.faults import Faulty
from benchmarks.integrity.judge import Seconds
from benchmarks.integrity.outcome import rows
from benchmarks.integrity.sent import sent
from benchmarks.mount_accuracy.seeds import tuned_on
from imucald.can.columns import FrameColumns
from imucald.can.dbc.bits import read_bits
from imucald.can.e2e.protector import MessageProtector
from imucald.config import LoadedConfig
from imucald.core.samples import GRAVITY, Series
from imucald.inputs.routes import MessageRoute
from imucald.inputs.wiring import compile_router
from imucald.simulation import random_model
from imucald.traffic.other_units import joined

Array = NDArray[np.float64]

FIRST_SEED = 640_000
MINUTES = 15.0
SPOOFED_S = (300.0, 420.0)
DRIFTS_FROM_S = 250.0
GAP_S = 0.0003
"""Between the frames of a burst."""
DEVIATIONS = 4.0
ZEROS = slice(4, 6)
USAGE = 2


@dataclass(frozen=True)
class Variant:
    """burst: frames put in behind_s [s] behind a true one, each_s [s]; off: what they are off by
    [m/s^2].

    rate: of a drift [m/s^2 a second] along an axis.
    """

    name: str
    allowed_s: float
    burst: int = 0
    each_s: float = math.inf
    off: tuple[float, float, float] = (0.0, 0.0, 0.0)
    behind_s: float = GAP_S
    rate: float = 0.0
    axis: int = 0


VARIANTS = (
    Variant("bursts of 16, each second, 3 m/s2", 2.0, 16, 1.0, (3.0, 0.0, 0.0)),
    Variant("bursts of 16, 3.6 a second, 1.5 m/s2", 2.0, 16, 0.28, (1.5, 1.5, 0.0)),
    Variant("bursts of 16, 3.6 a second, 3 m/s2", 2.0, 16, 0.28, (0.0, 3.0, 0.0)),
    Variant("singles, 10 a second, 9 m/s2", 2.0, 1, 0.1, (0.0, 9.0, 0.0), 0.0005),
    Variant("singles 9 ms behind, 5 a second, 9 m/s2", 2.0, 1, 0.2, (0.0, 9.0, 0.0), 0.009),
    *(
        Variant(f"drift of {'xyz'[axis]} by {rate}", 0.0, rate=rate, axis=axis)
        for rate in (0.001, 0.002, 0.003)
        for axis in range(3)
    ),
)


@dataclass(frozen=True)
class Found:
    """Of a drive [s]: good after the onset, good and wrong, of that not covered by the deviation,
    and from the onset to the first second that is mostly not good (infinite: none)."""

    good: float
    wrong: float
    not_covered: float
    ended: float


def judged(variant: Variant, seed: int) -> Found:
    """A drive of the variant through the daemon's engine."""
    base = SIMULATED(seed, MINUTES)
    loaded = configuration(frozenset(base.samples), True, base.side)
    model = random_model(seed)
    if variant.burst:
        bus = frames(base.samples, base.duration_s, loaded, model, seed)
        bus, base, faulty = spoofed(bus, base, loaded, variant, seed)
    else:
        faulty = drifted(base, variant)
        bus = frames(faulty.samples, base.duration_s, loaded, model, seed)
    out = sent(bus, loaded, base.seconds)
    if out.crash:
        raise RuntimeError(f"{variant.name}, seed {seed}: {out.crash}")
    return told(rows(base, faulty, out), out.sent_std, faulty.onset, variant)


def told(seconds: Seconds, sent_std: Array, onset: float, variant: Variant) -> Found:
    """What the judge's seconds come to; sent_std: (n, 8) deviations of `force.ENTRIES`, or NaN."""
    first = int(onset)
    wrong = seconds.wrong.copy()
    wrong[:first] = 0.0
    off = variant.rate * np.maximum(np.arange(len(wrong)) - onset, 0.0)
    tilt = GRAVITY * np.radians(np.nan_to_num(seconds.std[:, :2]).max(axis=1))
    level = sent_std[:, ZEROS].max(axis=1)
    covered = np.where(np.isfinite(level), level, tilt)
    is_bare = (off > DEVIATIONS * covered) | (variant.rate == 0.0)
    bad = np.flatnonzero(seconds.good[first:] < 0.5)
    return Found(
        float(seconds.good[first:].sum()),
        float(wrong.sum()),
        float(wrong[is_bare].sum()),
        float(bad[0]) if len(bad) else math.inf,
    )


def drifted(base: Base, variant: Variant) -> Faulty:
    """An axis of the accelerometer drifts."""
    series = base.samples["accel"]
    values = series.values.copy()
    values[:, variant.axis] += variant.rate * np.maximum(series.t - DRIFTS_FROM_S, 0.0)
    samples = {**base.samples, "accel": Series(series.t, values)}
    return Faulty(samples, DRIFTS_FROM_S, ("accel",))


def spoofed(
    bus: FrameColumns, base: Base, loaded: LoadedConfig, variant: Variant, seed: int
) -> tuple[FrameColumns, Base, Faulty]:
    """The bus with another node's frames; truth and what was said, frame by frame."""
    route = _accelerometer(loaded)
    spec = route.checker.spec
    assert spec.counter is not None
    series = base.samples["accel"]
    off = Series(series.t, series.values + np.array(variant.off))
    others = frames(
        {**base.samples, "accel": off}, base.duration_s, loaded, random_model(seed), seed
    )
    true, other = (one.take(one.can_id == route.plan.message.can_id) for one in (bus, others))
    rng = np.random.default_rng(seed)
    at = np.arange(SPOOFED_S[0] + 0.01 * rng.random(), SPOOFED_S[1], variant.each_s)
    protector = MessageProtector(spec)
    parts, where = [bus], []
    width = route.plan.message.length
    for row in np.unique(np.searchsorted(true.t, at)).tolist():
        held = read_bits(bytes(true.data[row]), spec.counter.field)
        protector._next = (held + 1) % spec.counter.modulus
        taken = np.arange(row, row + variant.burst)
        burst = other.take(taken)
        data = burst.data.copy()
        data[:, :width] = protector.protect_columns(data[:, :width])[:, :width]
        start = true.t[row] + variant.behind_s
        parts.append(structs.replace(burst, t=start + GAP_S * np.arange(variant.burst), data=data))
        where.append(taken)
    every = joined(parts)
    put_in = np.concatenate([part.t for part in parts[1:]])
    t = np.concatenate([series.t, put_in])
    values = np.concatenate([series.values, series.values[np.concatenate(where)]])
    wrong = values.copy()
    wrong[len(series.t) :] += np.array(variant.off)
    order = np.argsort(t, kind="stable")
    sound, said = (Series(t[order], v[order]) for v in (values, wrong))
    faulty = Faulty({**base.samples, "accel": said}, SPOOFED_S[0], ("accel",))
    base = replace(base, samples={**base.samples, "accel": sound})
    return every.take(np.argsort(every.t, kind="stable")), base, faulty


def _accelerometer(loaded: LoadedConfig) -> MessageRoute:
    for route in compile_router(loaded).routes:
        if isinstance(route, MessageRoute) and any(tap.channel == "accel" for tap in route.taps):
            return route
    raise LookupError("no message has the accelerometer")


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--variant", nargs="+", help="only those whose names begin so")
    parser.add_argument("--first", type=int, default=FIRST_SEED, help="first seed")
    parser.add_argument("--drives", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=1)
    options = parser.parse_args()
    seeds = list(range(options.first, options.first + options.drives))
    if tuned := tuned_on(seeds):
        print(f"--first {options.first}: seed {tuned[0]} was tuned on", file=sys.stderr)
        return USAGE
    prefixes = tuple(options.variant or [""])
    print(
        "| variant | good and wrong, s: most, median | drives beyond the bar | not covered by four "
        "deviations, s: most | drives | first not good after, s: median, last |"
    )
    print("|---" * 6 + "|")
    is_met = True
    for variant in VARIANTS:
        if not variant.name.startswith(prefixes):
            continue
        found = list(_each(partial(judged, variant), seeds, options.jobs))
        wrong = np.array([one.wrong for one in found])
        bare = np.array([one.not_covered for one in found])
        ended = np.array([one.ended for one in found])
        beyond = int((wrong > variant.allowed_s).sum())
        is_met &= beyond == 0
        print(f"| {variant.name} | {wrong.max():.1f}, {np.median(wrong):.1f} | {beyond} of "
              f"{len(found)} | {bare.max():.1f} | {int((bare > variant.allowed_s).sum())} | "
              f"{np.median(ended):.0f}, {ended.max():.0f} |", flush=True)  # fmt: skip
    return 0 if is_met else 1


def _each(judge: partial[Found], seeds: list[int], jobs: int) -> Iterator[Found]:
    if jobs <= 1:
        yield from map(judge, seeds)
        return
    with get_context("spawn").Pool(jobs) as pool:
        yield from pool.imap(judge, seeds)


if __name__ == "__main__":
    sys.exit(main())
