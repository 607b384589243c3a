"""Count faults, and drives that never became usable, by vehicle type."""

from __future__ import annotations

import json
import re
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import betabinom, binom, false_discovery_control

from imucald.fleet.analysis.units import MAX_Q

FEW_VEHICLES = 3
"""Smallest number of vehicles with a cause for which the verdict may be "design", even if the type
has few vehicles."""
UNKNOWN = "unknown"


def cause_rows(columns: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """Return a row for each cause in each vehicle type: number of vehicles with the cause, the
    shrunk rate, and the verdict.

    The verdict is "design" if more vehicles of the type have the cause than the rate among all
    other vehicles explains (binomial tail, Benjamini-Hochberg over all rows). Otherwise the verdict
    is "single vehicles". The rate is shrunk towards the rate of the fleet with a beta prior that is
    fitted to the types (empirical Bayes).
    """
    kind_of: dict[str, str] = {}
    having: dict[str, set[str]] = defaultdict(set)
    diagnosed = columns.get("diagnosed") or [None] * len(columns["vehicle"])
    of_drive = (columns["vehicle"], columns["vehicle_type"], columns["causes"], diagnosed)
    for vehicle, kind, causes, found_by_diagnosis in zip(*of_drive, strict=True):
        kind_of[str(vehicle)] = str(kind or UNKNOWN)
        names = json.loads(causes or "[]")
        names += [f"diagnosed: {name}" for name in json.loads(found_by_diagnosis or "[]")]
        for cause in names:
            having[cause].add(str(vehicle))
    size = Counter(kind_of.values())
    found = [
        _counted(cause, kind, n, vehicles, kind_of, size)
        for cause, vehicles in sorted(having.items())
        for kind, n in sorted(Counter(kind_of[v] for v in vehicles).items())
    ]
    if found:
        q = false_discovery_control([row["p"] for row in found])
        for row, value in zip(found, q, strict=True):
            row["q"] = float(value)
            many = row["vehicles_with"] >= FEW_VEHICLES and row["q"] <= MAX_Q
            row["verdict"] = "design" if many else "single vehicles"
    return found


def _counted(
    cause: str,
    kind: str,
    n: int,
    vehicles: set[str],
    kind_of: Mapping[str, str],
    size: Counter[str],
) -> dict[str, Any]:
    others = len(kind_of) - size[kind]
    elsewhere = len(vehicles) - n
    # half a vehicle is added: with a rate of zero any single fault would be a design cause
    background = (elsewhere + 0.5) / (others + 1.0)
    by_kind = Counter(kind_of[v] for v in vehicles)
    a, b = _beta_prior([by_kind[k] for k in sorted(size)], [size[k] for k in sorted(size)])
    return {
        "vehicle_type": kind,
        "cause": cause,
        "vehicles_with": n,
        "vehicles": size[kind],
        "rate": n / size[kind],
        "rate_shrunk": (n + a) / (size[kind] + a + b),
        "rate_elsewhere": elsewhere / others if others else None,
        "p": float(binom.sf(n - 1, size[kind], background)),
    }


def _beta_prior(counts: Sequence[int], sizes: Sequence[int]) -> tuple[float, float]:
    """Return the two parameters of a beta prior. Its mean is the rate of all types together; its
    strength has the maximum likelihood."""
    rate = (sum(counts) + 0.5) / (sum(sizes) + 1.0)
    strengths = np.geomspace(1.0, 1000.0, 40)
    likely = [betabinom.logpmf(counts, sizes, s * rate, s * (1.0 - rate)).sum() for s in strengths]
    best = float(strengths[int(np.argmax(likely))])
    return best * rate, best * (1.0 - rate)


def never_usable_rows(columns: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """Count the drives that never became usable, by vehicle type and by missing condition. The
    condition is the one of the first mount angle that was not determined."""
    drives: Counter[tuple[str, str]] = Counter()
    vehicles: dict[tuple[str, str], set[str]] = defaultdict(set)
    total: Counter[str] = Counter()
    names = (
        "vehicle",
        "vehicle_type",
        "first_usable_s",
        "waiting_roll",
        "waiting_pitch",
        "waiting_yaw",
    )
    for vehicle, kind, usable, *waiting in zip(*(columns[n] for n in names), strict=True):
        kind_name = str(kind or UNKNOWN)
        total[kind_name] += 1
        if usable is None:
            text = next((w for w in waiting if w), "not reported")
            text = re.sub(r"\d+(\.\d+)?", "N", re.sub(r"\s*\([^)]*\)", "", text))
            reason = " ".join(text.split())
            drives[kind_name, reason] += 1
            vehicles[kind_name, reason].add(str(vehicle))
    return [
        {
            "vehicle_type": kind,
            "reason": reason,
            "drives": n,
            "vehicles": len(vehicles[kind, reason]),
            "share": n / total[kind],
        }
        for (kind, reason), n in sorted(drives.items(), key=lambda item: (-item[1], item[0]))
    ]
