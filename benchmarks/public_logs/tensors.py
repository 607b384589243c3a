"""Converters of recordings kept as pickled tensors: KITTI's raw drives, read without torch."""

from __future__ import annotations

import io
import pickle
import struct
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import as_strided
from scipy.spatial.transform import Rotation

from benchmarks.public_logs.frames import Array, Message, Signal, triad
from benchmarks.public_logs.repositories import KITTI_TENSORS

LEVEL = (0.0, 0.0, 0.0)


def kitti_raw(data: Path, drive: str, turned: tuple[float, float, float] = LEVEL) -> list[Message]:
    """A KITTI drive, 8 to 9 min: the OXTS unit's own accelerometer and gyroscope at 100 Hz.

    turned: roll, pitch, yaw [deg] of R_vehicle_from_sensor that the sensor is given; the unit sits
    straight, and a mount of zero would prove little. Speed and heading are the unit's solution.
    """
    content = KITTI_TENSORS.file(data, f"ai-data/{drive}_extract.p")
    drive_of = {
        key: np.asarray(value, dtype=np.float64)
        for key, value in _Tensors(io.BytesIO(content)).load().items() if key in "t u v_gt ang_gt"
    }  # fmt: skip
    t, yaw = drive_of["t"].ravel(), drive_of["ang_gt"][:, 2]
    east, north = drive_of["v_gt"][:, 0], drive_of["v_gt"][:, 1]
    to_sensor = Rotation.from_euler("ZYX", turned[::-1], degrees=True).inv()
    rates, force = (to_sensor.apply(drive_of["u"][:, at : at + 3]) for at in (0, 3))
    speed = east * np.cos(yaw) + north * np.sin(yaw)
    return [
        triad(0x71, "OXTS_ACC", "a", "m/s^2", 0.001, t, force, "xyz"),
        triad(0x72, "OXTS_RATE", "w", "rad/s", 0.0001, t, rates, "xyz"),
        Message(0x73, "OXTS_VEL", t[::5], (Signal("vf", "m/s", 0.002, speed[::5]),)),
        Message(0x74, "OXTS_POSE", t[::10], (Signal("yaw", "rad", 0.0002, yaw[::10]),)),
    ]


class _Tensors(pickle.Unpickler):
    """Tensors of torch as arrays; whatever else a pickle asks for is refused."""

    def find_class(self, module: str, name: str) -> Any:
        known = {
            ("torch.storage", "_load_from_bytes"): _storage,
            ("torch._utils", "_rebuild_tensor_v2"): _tensor,
            ("collections", "OrderedDict"): OrderedDict,
        }
        if (module, name) not in known:
            raise ValueError(f"the file asks for {module}.{name}: not read")
        return known[module, name]


def _storage(content: bytes) -> Array:
    """The numbers at the end of a stored tensor, behind how many they are (8 bytes)."""
    kind = np.dtype("<f8" if b"DoubleStorage" in content else "<f4")
    for n in range(len(content) // kind.itemsize, 0, -1):
        at = len(content) - n * kind.itemsize - 8
        if at >= 0 and struct.unpack_from("<q", content, at)[0] == n:
            return np.frombuffer(content, kind, n, at + 8)
    raise ValueError("no numbers in the stored tensor")


def _tensor(
    storage: Array, start: int, size: tuple[int, ...], stride: tuple[int, ...], *_: Any
) -> Array:
    part = storage[start:]
    return as_strided(part, size, [step * part.itemsize for step in stride]).copy()
