"""What the analysis of simulated fleets is worth: coverage, false discoveries, power, error."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.fleet.simulated_fleet import Design, Truth, simulated_fleet
from imucald.fleet.analysis.analyse import analysed

AXES = "xyz"


@dataclass
class Scores:
    """Sums over fleets."""

    covered: dict[str, list[list[bool]]] = field(default_factory=lambda: defaultdict(list))
    """By what the interval is of: a row of three for each."""
    false_share: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    power: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    error: dict[str, list[list[float]]] = field(default_factory=lambda: defaultdict(list))
    """By method: rotation-vector error of each vehicle's mount [deg]."""


def run(fleets: int, design: Design, seed: int) -> Scores:
    scores = Scores()
    for k in range(fleets):
        columns, truth = simulated_fleet(seed + k, design)
        tables = analysed(columns)
        _intervals(tables, truth, scores)
        _found(tables, truth, scores)
        _errors(columns, tables, truth, scores)
    return scores


def _rotation(row: dict[str, Any], prefix: str = "") -> Rotation:
    return Rotation.from_quat([row[f"{prefix}q_{n}"] for n in "xyzw"])


def _error(found: Rotation, true: Rotation) -> list[float]:
    return list((found * true.inv()).as_rotvec(degrees=True))


def _inside(error: list[float], row: dict[str, Any], form: str) -> list[bool]:
    return [abs(x) <= row[form.format(a)] for x, a in zip(error, AXES, strict=True)]


def _intervals(tables: dict[str, list[dict[str, Any]]], truth: Truth, scores: Scores) -> None:
    for row in tables["analysis/vehicles"]:
        true = truth.mounts[row["vehicle"]]
        for name, prefix in (("vehicle, measured", ""), ("vehicle, shrunk", "shrunk_")):
            error = _error(_rotation(row, prefix), true)
            scores.covered[name].append(_inside(error, row, prefix + "ci95_{}_deg"))
    for row in tables["analysis/types"]:
        error = _error(_rotation(row), truth.centre[row["vehicle_type"]])
        scores.covered["type"].append(_inside(error, row, "ci95_{}_deg"))
    for row in tables["analysis/groups"]:
        if row["column"] == "sensor_batch" and row["p"] is not None:
            error = [
                row[f"d_{a}_deg"] - t for a, t in zip(AXES, truth.effects[row["name"]], strict=True)
            ]
            scores.covered["batch"].append(_inside(error, row, "ci95_{}_deg"))


def _found(tables: dict[str, list[dict[str, Any]]], truth: Truth, scores: Scores) -> None:
    remounts = {
        (r["vehicle"], r["after_log_key"]) for r in tables["analysis/remounts"] if r["found"]
    }
    _score("remounts", remounts, truth.remounts, scores)
    # a vehicle whose sensor was moved early, or before its first known drive, does stand out: told
    # so it is no false discovery, and none that had to be made
    moved = {vehicle for vehicle, _ in truth.remounts} - truth.outliers
    outliers = {r["vehicle"] for r in tables["analysis/outliers"]} - moved
    _score("outliers", outliers, truth.outliers, scores)
    groups = {r["name"] for r in tables["analysis/groups"] if r["verdict"] == "bad"}
    _score("batches", groups, truth.bad, scores)


def _score(name: str, found: set[Any], true: set[Any], scores: Scores) -> None:
    scores.false_share[name].append(len(found - true) / max(len(found), 1))
    scores.power[name] += [float(one in found) for one in true]


def _errors(columns: Any, tables: Any, truth: Truth, scores: Scores) -> None:
    """Errors of mounts beside the naive mean of rotations, and the mean of Euler angles."""
    known = np.array([s == "fine" for s in columns["state"]])
    vehicle = np.array(columns["vehicle"])
    q = np.array([columns[f"q_{n}"] for n in "xyzw"]).T
    angles = np.array([columns[f"{a}_deg"] for a in ("yaw", "pitch", "roll")]).T
    for row in tables["analysis/vehicles"]:
        mine = known & (vehicle == row["vehicle"])
        true = truth.mounts[row["vehicle"]]
        euler = Rotation.from_euler("ZYX", angles[mine].mean(axis=0), degrees=True)
        for name, found in (
            ("naive mean of rotations", Rotation.from_quat(q[mine]).mean()),
            ("mean of Euler angles", euler),
            ("imucald, measured", _rotation(row)),
            ("imucald, shrunk", _rotation(row, "shrunk_")),
        ):
            scores.error[name].append(_error(found, true))
