"""A proposed configuration against the one that is right: quantity by quantity."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from imucald import config as cfg
from imucald.config import LoadedConfig, load_config
from imucald.core.samples import QUANTITIES
from imucald.discovery.proposal import Proposal
from imucald.inputs.quantities import wanted_numbers
from imucald.inputs.units import find_unit
from imucald.inputs.wiring import load_databases

CHANNELS = {
    "accel": "accelerometer",
    "gyro": "gyroscope",
    "mag": "magnetometer",
    "steering": "steering_wheel_angle",
    "lateral_accel": "lateral_acceleration",
    "longitudinal_accel": "longitudinal_acceleration",
}
TRIADS = ("accelerometer", "gyroscope", "magnetometer")
SAME_FACTOR = 1e-3


@dataclass(frozen=True)
class Number:
    """One configured number: its source, SI value of one with sign, meaning of a flag."""

    source: str
    factor: float
    on: str = ""

    def is_same(self, other: Number) -> bool:
        """Whether both decode to the same."""
        close = abs(self.factor / other.factor - 1.0) < SAME_FACTOR
        return self.source == other.source and close and self.on == other.on


Quantities = Mapping[str, Mapping[int, Number]]
"""Quantity to its numbers by axis or wheel."""


@dataclass
class Verdict:
    """Quantities by how they came out."""

    right: list[str] = field(default_factory=list)
    unsure_right: list[str] = field(default_factory=list)
    unsure_wrong: list[str] = field(default_factory=list)
    wrong: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    beyond: list[str] = field(default_factory=list)
    """Sure proposals of quantities that nobody has configured: not judged."""

    @property
    def asked(self) -> int:
        """Quantities of the right configuration."""
        return sum(map(len, (self.right, self.unsure_right, self.unsure_wrong,
                             self.wrong, self.missing)))  # fmt: skip

    @property
    def found(self) -> int:
        """Those that are right, marked as unsure or not."""
        return len(self.right) + len(self.unsure_right)


def quantities_of(path: Path) -> list[Quantities]:
    """What a configuration decodes, for the first source of each quantity, then the others."""
    loaded = load_config(path)
    ranks: dict[int, dict[str, dict[int, Number]]] = {}
    for wanted in wanted_numbers(loaded.config.signals):
        name = CHANNELS.get(wanted.channel, wanted.channel)
        number = _number(loaded, wanted.channel, wanted.source)
        ranks.setdefault(wanted.rank, {}).setdefault(name, {})[wanted.slot] = number
    return [ranks[rank] for rank in sorted(ranks)]


def _number(loaded: LoadedConfig, channel: str, source: cfg.SourceSettings) -> Number:
    dimension = QUANTITIES[channel].dimension
    if source.raw is not None:
        where, unit, top = f"{source.raw.id:X} {source.raw.value}", source.unit or "", 1
    else:
        _, signal = next(
            holder.database.signal(source.signal or "")
            for holder in load_databases(loaded)
            if (source.signal or "").partition(".")[0] in holder.database.messages
        )
        where, unit = source.signal or "", source.unit or signal.unit
        top = (1 << signal.length) - 1
    if dimension != "flag":
        return Number(where, find_unit(unit, dimension).factor * source.sign)
    return Number(where, 1.0, _on(source, top))


def _on(source: cfg.SourceSettings, top: int) -> str:
    """A flag's meaning as text; a single bit that is not zero is one."""
    if source.above is not None:
        return "above"
    if source.equals is not None:
        values = source.equals if isinstance(source.equals, tuple) else (source.equals,)
        return "=" + ",".join(f"{v:g}" for v in values)
    return "=1" if top == 1 else "not zero" if source.raw or top > 3 else "=1"


def judge(
    proposal: Proposal, proposed: Path, right: Path, also: Mapping[str, Quantities], fixed: bool,
    unseen: frozenset[str] = frozenset(),
) -> Verdict:  # fmt: skip
    """Compare. also: further right answers by quantity. fixed: names say which axis is x.

    unseen: quantities whose signals never change in the drive; they are not asked.
    """
    verdict = Verdict()
    # a file without any signal is no configuration
    found = quantities_of(proposed)[0] if any(c.sources for c in proposal.choices) else {}
    answers = quantities_of(right)
    turns: dict[str, np.ndarray] = {}
    for name in answers[0]:
        if name in unseen and name not in found:
            continue
        choice = proposal.choice(name)
        if name not in found or choice is None:
            verdict.missing.append(name)
            continue
        options = [a[name] for a in answers if name in a]
        options += [a[name] for a in also.values() if name in a]
        if name in TRIADS and not fixed:
            turn = _turn(found[name], options[0])
            turns[name] = turn if turn is not None else np.zeros((3, 3))
            good = turn is not None and np.linalg.det(turn) > 0.0
            if name != "accelerometer":
                good = good and bool((turn == turns.get("accelerometer")).all())
        else:
            good = any(_same(found[name], option) for option in options)
        lists = {
            (True, True): verdict.right, (True, False): verdict.unsure_right,
            (False, False): verdict.unsure_wrong, (False, True): verdict.wrong,
        }  # fmt: skip
        lists[bool(good), choice.is_sure].append(name)
    for choice in proposal.choices:
        if choice.quantity not in answers[0] and choice.is_sure:
            if any(_same(found[choice.quantity], a[choice.quantity])
                   for a in also.values() if choice.quantity in a):  # fmt: skip
                continue
            verdict.beyond.append(choice.quantity)
    return verdict


def _same(a: Mapping[int, Number], b: Mapping[int, Number]) -> bool:
    return a.keys() == b.keys() and all(a[slot].is_same(b[slot]) for slot in a)


def _turn(found: Mapping[int, Number], right: Mapping[int, Number]) -> np.ndarray | None:
    """Rotation (or mirror) from the right axes to the found ones; None where a signal is wrong."""
    if found.keys() != right.keys():
        return None
    turn = np.zeros((3, 3))
    for (i, a), (k, b) in itertools.product(found.items(), right.items()):
        if a.source == b.source:
            if abs(abs(a.factor / b.factor) - 1.0) > SAME_FACTOR:
                return None
            turn[i, k] = np.sign(a.factor / b.factor)
    return turn if (np.abs(turn).sum(axis=0) == 1).all() else None
