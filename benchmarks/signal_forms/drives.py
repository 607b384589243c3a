"""What the forms are put on: unseen simulated drives, another simulator's, and measured logs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.integrity.bases import Base
from benchmarks.integrity.bases import measured as measured_base
from benchmarks.mount_accuracy.drives import FULL
from imucald.core.rotations import angles_from_rotation, rows_from_quaternion
from imucald.simulation import random_model, simulate
from imucald.simulation.filters import generator

MINUTES = 14.0
FIRST_SEED = 910_000
"""Named before any run; nothing was chosen on them."""
DRIVES = 10
SECOND_WORLD = ("second_world/01_none", "second_world/02_none")
"""Another simulator's drives without a hidden effect."""
MEASURED = ("kingston_2008", "css_canmod_164", "vehsense_2018_08_04")
"""Measured logs whose mount becomes usable as they are. Their reference is an INS, or their own
estimate with twice its deviation (`benchmarks.integrity.bases`)."""
OWN_STEPS: Mapping[str, Mapping[str, float]] = {
    "css_canmod_164": {"accel": 0.125, "gyro": 0.25, "speed": 1.0},
}
"""Steps that a measured log has already: its database goes on stating them."""
CONSTANT = {"route.speed_wander": 0.0}
"""Between what the road asks for, the driver keeps the speed exactly."""


@dataclass(frozen=True)
class Put:
    """A drive that forms are put on. group: simulated, second_world or measured."""

    name: str
    group: str
    is_constant: bool = False
    minutes: float = MINUTES

    @property
    def key(self) -> str:
        """Name with the variant."""
        return f"{self.name}{' constant' if self.is_constant else ''}"


def drives(count: int, first: int, groups: tuple[str, ...], minutes: float = MINUTES) -> list[Put]:
    """All drives of these groups; count: of the simulated ones, each natural and constant."""
    found = []
    if "simulated" in groups:
        for seed in range(first, first + count):
            found += [Put(str(seed), "simulated", c, minutes) for c in (False, True)]
    if "second_world" in groups:
        found += [Put(name, "second_world") for name in SECOND_WORLD]
    if "measured" in groups:
        found += [Put(name, "measured") for name in MEASURED]
    return found


def base_of(put: Put, changes: Mapping[str, Any]) -> Base | None:
    """The drive's samples and truth; None where its log is not there. changes: of the vehicle."""
    if put.group != "simulated":
        return measured_base(put.name)
    seed = int(put.name)
    changes = {**any_mount(seed), **(CONSTANT if put.is_constant else {}), **changes}
    model = random_model(seed).with_changes(changes)
    drive = simulate(model, seed, put.minutes)
    return Base(
        put.key,
        drive.samples,
        60.0 * put.minutes,
        drive.truth.R_vehicle_from_sensor(),
        lean=drive.truth.mean_crown() - FULL.crown,
        accel_bias=model.accel.bias,
        gyro_bias=model.gyro.bias,
        seed=seed,
    )


def any_mount(seed: int) -> dict[str, float]:
    """A mount drawn from all rotations, as changes of a model."""
    q = generator(seed, "signal_forms").standard_normal(4)
    w, x, y, z = (q / np.linalg.norm(q)).tolist()
    angles = angles_from_rotation(np.array(rows_from_quaternion((w, x, y, z))).reshape(3, 3))
    return {
        f"mount.{name}_deg": math.degrees(angle)
        for name, angle in zip(("roll", "pitch", "yaw"), angles, strict=True)
    }
