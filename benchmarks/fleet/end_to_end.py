"""A small fleet of real logs with known mounts: through `fleet run` and `fleet analyse`.

What the statistics on simulated rows take for granted is put to the test here: that the estimator's
errors on logs are as its covariances say, crown, body and all.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
from scipy.spatial.transform import Rotation

from benchmarks.fleet.simulated_fleet import BRACKET_STD
from benchmarks.measured import EXAMPLES, FOLDER, imucald, made_once, run

VEHICLES, DRIVES, MINUTES = 20, 3, 12
CENTRE = Rotation.from_euler("ZYX", (12.0, -8.0, 3.0), degrees=True)
MOVED = {4: 1, 11: 2}
"""Vehicle, and the first drive after its sensor was moved by 3 deg."""
ODD = 7
"""Sits 3 deg beside its type."""
SEED = 900


@dataclass
class EndToEnd:
    """What was found, and each vehicle's errors over their 95 % half width (n, 3)."""

    drives: int = 0
    remounts: list[str] = field(default_factory=list)
    outliers: list[str] = field(default_factory=list)
    held: dict[str, list[list[bool]]] = field(default_factory=dict)
    error: dict[str, list[float]] = field(default_factory=dict)


def end_to_end() -> EndToEnd:
    folder = FOLDER / "fleet-end-to-end"
    mounts = _mounts()
    for (vehicle, drive), mount in mounts.items():
        _log(folder / "logs" / f"car-{vehicle:02}" / f"{drive}.log", vehicle, drive, mount)
    fleet = folder / "fleet.yaml"
    fleet.write_text(f"logs: 'logs/**/*.log'\nconfig: {EXAMPLES / 'passenger_car.yaml'}\n")
    out = folder / "out"
    run(imucald("fleet", "run", "--fleet", fleet, "--out", out, "--quiet", "--redo", "all"))
    run(imucald("fleet", "analyse", "--out", out))
    rows = {n: pq.read_table(out / "analysis" / n).to_pylist()
            for n in ("vehicles", "remounts", "outliers")}  # fmt: skip
    found = EndToEnd(drives=sum(v["drives"] for v in rows["vehicles"]))
    sources = pq.read_table(out / "drives").to_pylist()
    place = {d["log_key"]: "/".join(Path(json.loads(d["sources"])[0]).parts[-2:]) for d in sources}
    found.remounts = [place[r["after_log_key"]] for r in rows["remounts"] if r["found"]]
    found.outliers = [r["vehicle"] for r in rows["outliers"]]
    for v in rows["vehicles"]:
        true = mounts[int(v["vehicle"][-2:]), DRIVES - 1]
        for name, prefix in (("measured", ""), ("shrunk", "shrunk_")):
            estimate = Rotation.from_quat([v[f"{prefix}q_{n}"] for n in "xyzw"])
            error = (estimate * true.inv()).as_rotvec(degrees=True)
            half = [v[f"{prefix}ci95_{a}_deg"] for a in "xyz"]
            found.held.setdefault(name, []).append((np.abs(error) <= half).tolist())
            found.error.setdefault(name, []).append(float(np.linalg.norm(error)))
    return found


def _mounts() -> dict[tuple[int, int], Rotation]:
    rng = np.random.default_rng(SEED)
    found = {}
    for vehicle in range(VEHICLES):
        own = rng.normal(0.0, BRACKET_STD) + (np.array([0.0, 3.0, 0.0]) if vehicle == ODD else 0.0)
        mount = Rotation.from_rotvec(own, degrees=True) * CENTRE
        for drive in range(DRIVES):
            if MOVED.get(vehicle) == drive:
                mount = Rotation.from_rotvec([0.0, 2.1, 2.1], degrees=True) * mount
            found[vehicle, drive] = mount
    return found


def _log(place: Path, vehicle: int, drive: int, mount: Rotation) -> None:
    yaw, pitch, roll = mount.as_euler("ZYX", degrees=True)
    seed = SEED + DRIVES * vehicle + drive
    arguments = ("--minutes", str(MINUTES), "--seed", str(seed), "--mount", f"{roll},{pitch},{yaw}")
    log = made_once(
        f"fleet-{vehicle}-{drive}.log",
        str(arguments),
        lambda path: run(imucald("simulate", "--out", path, *arguments)),
    )
    place.parent.mkdir(parents=True, exist_ok=True)
    # simulated drives all begin at one instant: later drives are put some days on
    text = log.read_bytes().replace(b"(1600000", b"(1600%d00" % drive)
    place.write_bytes(text)
