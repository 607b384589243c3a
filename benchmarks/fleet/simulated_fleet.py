"""Rows of a simulated fleet with their truth: no logs, what `fleet run` would have written.

200 vehicles in 5 types, 5 drives each; errors of drives as records/mount-accuracy.md has them
(full estimator of then, 5 to 40 min), with heavier tails than normal; body from drive to drive as
`mount.estimate.BETWEEN_DRIVES_STD`; one road crown for all. Numbers that nobody has published are
said where they stand.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from imucald.mount.estimate import BETWEEN_DRIVES_STD

Array = NDArray[np.float64]

CROWN_STD = math.degrees(0.0065)
"""[deg]: `vehicle.crown_spread_percent` as it is by default."""
BRACKET_STD = np.array([0.3, 0.3, 0.35])
"""From vehicle to vehicle [deg]: a tolerance of one degree is three deviations. Assumed."""
TAIL_FREEDOM = 6
"""Of the t distribution of errors of single drives: claimed deviations hold, tails are heavy."""
UNKNOWN_SHARE = 0.05
"""Drives that never become usable. Assumed."""
FIRST_DAY = 1_750_000_000.0


@dataclass(frozen=True)
class Design:
    """What is in the fleet."""

    types: int = 5
    vehicles: int = 200
    drives: int = 5
    batches: int = 10
    remount_share: float = 0.04
    """Of pairs of drives in turn."""
    remount_deg: float = 2.0
    outliers: int = 3
    outlier_deg: float = 2.0
    bad_batches: int = 1
    batch_deg: tuple[float, float, float] = (0.2, 1.0, -0.5)
    common_crown: bool = True


@dataclass
class Truth:
    """What is known of it. mounts: of each vehicle at its last drive. centre: of each type.
    remounts: (vehicle, drive after). outliers, bad: vehicles and batches. effects: by batch (3,)
    beside the others of its types [deg]."""

    mounts: dict[str, Rotation] = field(default_factory=dict)
    centre: dict[str, Rotation] = field(default_factory=dict)
    remounts: set[tuple[str, str]] = field(default_factory=set)
    outliers: set[str] = field(default_factory=set)
    bad: set[str] = field(default_factory=set)
    effects: dict[str, Array] = field(default_factory=dict)


def simulated_fleet(
    seed: int, design: Design | None = None
) -> tuple[dict[str, list[object]], Truth]:
    """Columns of `drives`, sorted by vehicle and time, and the truth."""
    design = design or Design()
    rng = np.random.default_rng(seed)
    truth = Truth()
    names = [f"v{i:05d}" for i in range(design.vehicles)]
    kinds = [f"type-{i % design.types}" for i in range(design.vehicles)]
    centres = [_centre(rng, k) for k in range(design.types)]
    truth.centre = {f"type-{k}": R for k, R in enumerate(centres)}
    batch_of = rng.permutation(np.arange(design.vehicles) % design.batches)
    batches = [f"B{b:02d}" for b in batch_of]
    bad = {f"B{b:02d}" for b in rng.choice(design.batches, design.bad_batches, replace=False)}
    truth.bad = bad
    truth.effects = {f"B{b:02d}": np.array(design.batch_deg) if f"B{b:02d}" in bad else np.zeros(3)
                     for b in range(design.batches)}  # fmt: skip
    truth.outliers = {names[i] for i in rng.choice(design.vehicles, design.outliers, replace=False)}
    crown = rng.normal(0.0, CROWN_STD) if design.common_crown else 0.0
    rows: list[dict[str, object]] = []
    for i, name in enumerate(names):
        e = rng.normal(0.0, BRACKET_STD) + truth.effects[batches[i]]
        if name in truth.outliers:
            e = e + _direction(rng) * design.outlier_deg
        mount = Rotation.from_rotvec(e, degrees=True) * truth.centre[kinds[i]]
        for d in range(design.drives):
            if d and rng.random() < design.remount_share:
                mount = (
                    Rotation.from_rotvec(_direction(rng) * design.remount_deg, degrees=True) * mount
                )
                truth.remounts.add((name, f"{name}-{d}"))
            rows.append(_drive(rng, name, d, mount, crown))
            rows[-1] |= {
                "vehicle_type": kinds[i],
                "sensor_batch": batches[i],
                "firmware": f"f{i % 3}",
            }
        truth.mounts[name] = mount
    columns: dict[str, list[object]] = {key: [row[key] for row in rows] for key in rows[0]}
    return columns, truth


def _centre(rng: np.random.Generator, k: int) -> Rotation:
    """A type's mount: one straight, one turned by 90 deg, one upside down, others anyhow."""
    given = {0: (0.0, 0.0, 0.0), 1: (90.0, 0.0, 0.0), 2: (3.0, -2.0, 178.0)}
    angles = given.get(k) or tuple(rng.uniform((-180.0, -30.0, -30.0), (180.0, 30.0, 30.0)))
    return Rotation.from_euler("ZYX", angles, degrees=True)


def _direction(rng: np.random.Generator) -> Array:
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def _drive(
    rng: np.random.Generator, name: str, d: int, mount: Rotation, crown: float
) -> dict[str, object]:
    minutes = 5.0 * 8.0 ** rng.random()
    # deviations at 5 min and 40 min (records/mount-accuracy.md: median error / 0.67), crown apart
    share = math.log(minutes / 5.0) / math.log(8.0)
    std = np.array([0.46, 0.14, 0.13]) ** (1 - share) * np.array([0.12, 0.10, 0.06]) ** share
    std = std * rng.uniform(0.8, 1.3)
    body = rng.normal(0.0, np.degrees(BETWEEN_DRIVES_STD))
    noise = std * rng.standard_t(TAIL_FREEDOM, 3) * math.sqrt((TAIL_FREEDOM - 2) / TAIL_FREEDOM)
    error = body + noise + np.array([crown, 0.0, 0.0])
    found = Rotation.from_rotvec(error, degrees=True) * mount
    x, y, z, w = found.as_quat(canonical=True)
    yaw, pitch, roll = found.as_euler("ZYX", degrees=True)
    known = rng.random() >= UNKNOWN_SHARE
    start = FIRST_DAY + 86400.0 * d
    return {
        "log_key": f"{name}-{d}", "run_key": "simulated", "vehicle": name,
        "sensor_serial": f"s{name}",
        "sources": f'["{name}/{d}.log"]', "date": None, "start": start, "end": start + 60 * minutes,
        "duration_s": 60 * minutes, "distance_m": 600 * minutes,
        "state": "fine" if known else "levelled", "first_usable_s": 60.0 if known else None,
        "first_fine_s": None, "q_w": w, "q_x": x, "q_y": y, "q_z": z,
        "roll_deg": roll, "pitch_deg": pitch, "yaw_deg": yaw,
        "cov_xx_deg2": std[0] ** 2 + CROWN_STD**2, "cov_xy_deg2": 0.0, "cov_xz_deg2": 0.0,
        "cov_yy_deg2": std[1] ** 2, "cov_yz_deg2": 0.0, "cov_zz_deg2": std[2] ** 2,
        "crown_std_deg": CROWN_STD, "driving_side": "right", "waiting_roll": None,
        "waiting_pitch": None, "waiting_yaw": None if known else "waiting for a change of speed",
        "causes": "[]", "frames_read": 1, "frames_used": 1, "rejected": "{}",
        "rate_accel_hz": 100.0,
    }  # fmt: skip
