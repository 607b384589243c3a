"""What a consumer of the corrected frames gets: cross-talk and zero error that are left in them.

A sensor answers to the true force and rate in vehicle axes by

    f_s = K R' f_v + b      w_s = C R' w_v      R': sensor from vehicle

K and C (3, 3) hold gains on the diagonal and cross-axis errors off it. The frames carry W f_s - o,
where W is the applied matrix (of most estimators a rotation) and o the offset that is taken off.
They differ from the truth by

    E = W K R' - 1      z = W b - o + g E[:, 2]      and E of the rate by its own matrix and C

`ENTRIES` of these are judged; gains (the diagonal) are not. E_xy is the part of a lateral force
that the forward axis shows, as an angle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.core.rotations import Matrix3
from imucald.core.samples import GRAVITY
from imucald.mount.estimate import Correction, SentDeviations

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

FORCE = ((0, 1), (1, 0), (2, 0), (2, 1))
RATE = ((0, 2), (1, 2))
ENTRIES = ("xy", "yx", "zx", "zy", "zero x", "zero y", "rate xz", "rate yz")
"""Cross-talk of the force [deg], level zero [m/s^2], cross-talk of the rate [deg]."""
LIMITS = np.array([1.0, 1.0, 1.0, 1.0, 0.2, 0.2, 1.0, 1.0])
"""Alert limits, in the units of the entries."""
DEVIATIONS = 4.0
INTERVAL = 1.96
AFTER_S = (120, 300, 600, 1200)
"""Errors and deviations are kept at these seconds of a drive."""
_ONE = np.eye(3)


@dataclass(frozen=True)
class Response:
    """How a unit answers, in sensor axes. accel, gyro: K and C (3, 3). zero: b (3,) [m/s^2]."""

    accel: Matrix3 = field(default_factory=lambda: np.eye(3))
    gyro: Matrix3 = field(default_factory=lambda: np.eye(3))
    zero: Array = field(default_factory=lambda: np.zeros(3))

    def then(self, other: Response) -> Response:
        """The answer where another error is put on what this unit says."""
        return Response(
            other.accel @ self.accel, other.gyro @ self.gyro, other.accel @ self.zero + other.zero
        )


def left_over(
    applied: Correction, response: Response, R_vehicle_from_sensor: Matrix3, R_on_roads: Matrix3
) -> Array:
    """`ENTRIES` (8,) of what is sent, signed.

    R_on_roads: the mount as it would be found on the roads that were driven, if it were found
    right: their mean lean is set aside in the level zero.
    """
    W, V = (np.reshape(rows, (3, 3)) for rows in (applied.force, applied.rate))
    E = W @ response.accel @ R_vehicle_from_sensor.T - _ONE
    G = V @ response.gyro @ R_vehicle_from_sensor.T - _ONE
    level = W @ (response.accel @ R_on_roads.T[:, 2] * GRAVITY + response.zero)
    level -= applied.force_offset
    force = [np.degrees(E[i, j]) for i, j in FORCE]
    rate = [np.degrees(G[i, j]) for i, j in RATE]
    return np.array([*force, level[0], level[1], *rate])


def stated(sent: SentDeviations) -> Array:
    """Deviations (8,) of `ENTRIES`."""
    degrees = np.degrees([sent.xy, sent.yx, sent.zx, sent.zy, sent.rate_xz, sent.rate_yz])
    return np.array([*degrees[:4], sent.zero_x, sent.zero_y, *degrees[4:]])


def stated_of_angles(std_deg: Array) -> Array:
    """The same (n, 8) where only the rotation's deviations (n, 3) are sent [deg]."""
    found = [stated(SentDeviations.of_rotation(*row)) for row in np.radians(std_deg).tolist()]
    return np.array(found).reshape(-1, len(ENTRIES))


def misleading(left: Array, std: Array) -> Flags:
    """Seconds (n,) in which an entry is beyond its alert limit and DEVIATIONS stated deviations."""
    bound = np.fmax(LIMITS, DEVIATIONS * std)
    return np.asarray((np.abs(left) > bound).any(axis=1))  # NaN is not beyond


def outcome(left: Array, std: Array, good: Array) -> dict[str, Any]:
    """Figures of one drive for the results file.

    left, std: (n, 8). good: (n,) share of each second's frames that were sent as good.
    """
    use = (good >= 0.5) & np.isfinite(std).all(axis=1) & np.isfinite(left).any(axis=1)
    wrong = misleading(left, std)
    by_entry = np.abs(left) > np.fmax(LIMITS, DEVIATIONS * std)
    kept = {
        str(t): {"left": _plain(left[t - 1]), "std": _plain(std[t - 1])}
        for t in AFTER_S
        if t <= len(left) and use[t - 1]
    }
    return {
        "misleading": float((good * wrong).sum()),
        "by_entry": [float(x) for x in (good[:, None] * by_entry).sum(axis=0)],
        "at": kept,
    }


def _plain(values: Array) -> list[float | None]:
    return [round(float(x), 4) if np.isfinite(x) else None for x in values]


def table(named: Sequence[tuple[str, Sequence[dict[str, Any]]]], after_s: int = 600) -> list[str]:
    """A line a row of the table: name, and the `outcome` of its drives that were good."""
    head = (
        "| sensor | drives sent as good | good and wrong, s an hour | in drives |"
        + "".join(f" {name} |" for name in ENTRIES)
        + " rms(error/deviation) | 95 % holds |"
    )
    out = [head, "|---" * (6 + len(ENTRIES)) + "|"]
    for name, lines in named:
        there = [x for x in lines if x.get("force") is not None]
        if not there:
            continue
        found = [x["force"]["at"][str(after_s)] for x in there if str(after_s) in x["force"]["at"]]
        hours = sum(x["judged"] for x in there) / 3600.0
        wrong = sum(x["force"]["misleading"] for x in there)
        drives = sum(x["force"]["misleading"] > 0.0 for x in there)
        sent = sum(x["good"] > 0.0 for x in there)
        left = np.array([f["left"] for f in found], dtype=float).reshape(-1, len(ENTRIES))
        std = np.array([f["std"] for f in found], dtype=float).reshape(-1, len(ENTRIES))
        cells = []
        for i in range(len(ENTRIES)):
            known = np.abs(left[:, i][np.isfinite(left[:, i])])
            text = f"{np.median(known):.2f} / {np.quantile(known, 0.9):.2f}" if len(known) else ""
            cells.append(f"{text}, s {np.median(std[:, i]):.2f}" if text else "")
        z = (left / std)[np.isfinite(left)]
        sharp = f"{np.sqrt(np.mean(z**2)):.2f}" if len(z) else ""
        holds = f"{100.0 * np.mean(np.abs(z) <= INTERVAL):.0f} %" if len(z) else ""
        out.append(
            f"| {name} | {sent} of {len(there)} | {wrong / hours:.0f} | {drives} | "
            + " | ".join(cells)
            + f" | {sharp} | {holds} |"
        )
    return out
