"""Drives that faults are put into: simulated ones and measured logs, as samples with their truth.

What was simulated or decoded is kept in the temporary folder.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.integrity.force import Response
from benchmarks.measured import DATA, FOLDER, MEASURED_DRIVES, ROOT
from benchmarks.mount_accuracy.drives import FULL
from imucald.can.logs.log_reader import LogReader
from imucald.core.rotations import Matrix3, rotation_from_angles, rotation_from_vector
from imucald.core.samples import Samples, Series
from imucald.inputs.wiring import compile_router
from imucald.runtime.session import open_config
from imucald.runtime.timebase import TimeBase
from imucald.simulation import random_model, simulate
from imucald.simulation.imu import gain_matrix

Array = NDArray[np.float64]

MOVING_MPS = 0.3
"""Driving is counted above this speed."""
KEPT = FOLDER / "integrity-drives"
KNOWN = (True, True, True)


@dataclass(frozen=True)
class Base:
    """Sound samples and what is true of them.

    R_vehicle_from_sensor: the mount at the start; later ones in `mounts`. axes: of which of roll,
    pitch, yaw the truth is known, and reference_std: how well [deg]. lean: mean roll of its roads
    beyond what the configuration says of them [rad]. accel_bias, gyro_bias: (3,) in sensor axes,
    where known. seed: of a simulated drive. response: of the unit, where known.
    """

    name: str
    samples: Samples
    duration_s: float
    R_vehicle_from_sensor: Matrix3
    axes: tuple[bool, bool, bool] = KNOWN
    reference_std: tuple[float, float, float] = (0.0, 0.0, 0.0)
    lean: float = 0.0
    accel_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gyro_bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    side: str = "right"
    seed: int | None = None
    response: Response | None = None
    mounts: tuple[tuple[float, Matrix3], ...] = ()

    @property
    def seconds(self) -> int:
        """Whole seconds of the drive."""
        return int(self.duration_s)

    def moving(self) -> NDArray[np.bool_]:
        """Whether it drives, second by second (seconds,)."""
        speed = self.samples["speed"]
        t = np.arange(self.seconds) + 0.5
        return np.asarray(np.interp(t, speed.t, np.abs(speed.values)) > MOVING_MPS)

    def driven(self, t: Array) -> Array:
        """Seconds driven up to times (N,)."""
        seconds = np.concatenate([[0.0], np.cumsum(self.moving())])
        return np.asarray(np.interp(t, np.arange(len(seconds)), seconds))

    def parked(self, first_s: float, last_s: float) -> list[tuple[float, float]]:
        """Standstills of 4 s or more between two times."""
        edges = np.flatnonzero(np.diff(np.concatenate([[1], self.moving(), [1]]).astype(int)))
        pairs = edges.reshape(-1, 2).tolist()
        return [(a, b) for a, b in pairs if b - a >= 4 and a >= first_s and b <= last_s]


def simulated(seed: int, minutes: float, keep: bool = True) -> Base:
    """A drive of `random_model` with everything drawn from the seed."""
    model = random_model(seed)
    path = KEPT / f"{seed}-{minutes:g}-{_simulation()}.npz"
    if keep and path.exists():
        with np.load(path) as found:
            samples = _unpacked(dict(found))
            R, crown = found["R"], float(found["crown"])
    else:
        drive = simulate(model, seed, minutes)
        samples = drive.samples
        R, crown = drive.truth.R_vehicle_from_sensor(), drive.truth.mean_crown()
        if keep:
            _kept(path, samples, R=R, crown=np.array(crown))
    return Base(
        str(seed),
        samples,
        60.0 * minutes,
        R,
        lean=crown - FULL.crown,
        accel_bias=model.accel.bias,
        gyro_bias=model.gyro.bias,
        seed=seed,
        response=Response(
            gain_matrix(model.accel), gain_matrix(model.gyro), np.array(model.accel.bias)
        ),
    )


@lru_cache(1)
def _simulation() -> str:
    """Names the state of everything that a simulated drive depends on."""
    digest = hashlib.sha256()
    for part in ("simulation", "model", "core"):
        for path in sorted((ROOT / "daemon" / "imucald" / part).glob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:10]


def _kept(path: Path, samples: Samples, **more: Array) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {f"{c}:t": s.t for c, s in samples.items()}
    arrays |= {f"{c}:v": s.values for c, s in samples.items()}
    making = path.with_name(f"making-{path.name}")
    np.savez(making, allow_pickle=False, **arrays, **more)
    making.rename(path)


def _unpacked(found: dict[str, Array]) -> Samples:
    names = [key.removesuffix(":t") for key in found if key.endswith(":t")]
    return {name: Series(found[f"{name}:t"], found[f"{name}:v"]) for name in names}


# measured --------------------------------------------------------------------------------------

OWN_STD = 2.0
"""Where a log's own estimate is the reference, it is taken to be so many stated deviations off."""
OWN_ESTIMATES = {
    "kingston_2008": ((-0.82, 0.03, -89.84), (0.41, 0.09, 0.07)),
    "css_canmod_164": ((0.28, -85.21, 81.64), (0.41, 0.12, 0.08)),
    "vehsense_2018_08_04": ((-50.61, -0.58, 100.64), (0.47, 0.12, 0.18)),
}
"""Roll, pitch, yaw and their deviations [deg] at the end of the unedited log, by the state c45e8b5
(`python -m benchmarks.real_drives`): no other truth is known of these."""
INS_FORWARD = np.array([0.0039, 0.9998, 0.0155])
"""Forward in the sensor axes of kingston_2008, from its INS, +-0.3 deg."""
INS_STD = 0.3
CREEPING = ("vehsense_2017_10_23_2245", "vehsense_2017_10_25_1829")
"""Loosely held: their mount has no truth, so only their values are judged."""


def measured(name: str) -> Base | None:
    """A measured log by the name of its folder; None where it is not there."""
    folder = DATA / name
    if not folder.is_dir():
        return None
    if name.startswith("second_world/"):
        return _second_world(name, folder)
    samples = recorded(name)
    side = open_config(_configuration(name)).config.vehicle.driving_side
    end = max(float(s.t[-1]) for s in samples.values())
    if name in CREEPING:
        return Base(name, samples, end, np.eye(3), (False, False, False), side=side)
    angles, own = OWN_ESTIMATES[name]
    R = rotation_from_angles(*(math.radians(x) for x in angles))
    std = tuple(OWN_STD * x for x in own)
    if name == "kingston_2008":
        forward = R @ (INS_FORWARD / np.linalg.norm(INS_FORWARD))
        R = rotation_from_vector(np.cross(forward, [1.0, 0.0, 0.0])) @ R
        std = (std[0], INS_STD, INS_STD)
    return Base(name, samples, end, R, reference_std=(std[0], std[1], std[2]), side=side)


def _configuration(name: str) -> Path:
    shipped = MEASURED_DRIVES / f"{name}.yaml"
    return shipped if shipped.exists() else DATA / name / "car.yaml"


def recorded(name: str) -> Samples:
    """All samples of a measured log that is here, in SI units."""
    logs = DATA / name / "drive.log.gz", DATA / name / "can.log.gz"
    return _decoded(name, _configuration(name), next(log for log in logs if log.exists()))


def _second_world(name: str, folder: Path) -> Base:
    samples = recorded(name)
    truth = json.loads((folder / "truth.json").read_text("utf-8"))
    imu = truth["parameters"]["imu"]
    after = truth["mount_after_shift"]
    mounts = () if after is None else ((float(after["time"]), _rotation(after)),)
    x, y, z = (math.radians(b) for b in imu["gyro_bias_deg"])
    return Base(
        name,
        samples,
        max(float(s.t[-1]) for s in samples.values()),
        _rotation(truth["mount"]),
        lean=truth["parameters"]["road"]["crown"] - FULL.crown,
        accel_bias=tuple(imu["accel_bias"]),
        gyro_bias=(x, y, z),
        response=Response(
            np.eye(3) + np.diag(imu["accel_scale"]) + _sheared(imu["accel_cross"]),
            np.eye(3) + np.diag(imu["gyro_scale"]),
            np.array(imu["accel_bias"]),
        ),
        mounts=mounts,
    )


def _sheared(cross: list[float]) -> Array:
    """Cross-axis terms of that simulator: xy, xz, yz of a symmetric matrix."""
    xy, xz, yz = cross
    return np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])


def _rotation(mount: dict[str, float]) -> Matrix3:
    angles = (math.radians(mount[f"{angle}_deg"]) for angle in ("roll", "pitch", "yaw"))
    return rotation_from_angles(*angles)


def _decoded(name: str, config: Path, log: Path) -> Samples:
    """All samples of a log as its configuration decodes them, in seconds from its first frame."""
    path = KEPT / f"{name.replace('/', '-')}.npz"
    if path.exists():
        with np.load(path) as found:
            return _unpacked(dict(found))
    router = compile_router(open_config(config))
    base = TimeBase()
    parts: dict[str, list[Series]] = {}
    for chunk in LogReader([log], router.matches):
        for piece in base.segments(chunk.t):
            rows = chunk.take(slice(piece.start, piece.stop))
            for channel, series in router.columns(piece.t, rows).samples.items():
                parts.setdefault(channel, []).append(series)
    samples = {
        channel: Series(
            np.concatenate([s.t for s in found]), np.concatenate([s.values for s in found])
        )
        for channel, found in parts.items()
    }
    _kept(path, samples)
    return samples


SIMULATED: Callable[[int, float], Base] = lru_cache(2)(simulated)
MEASURED: Callable[[str], Base | None] = lru_cache(2)(measured)
