"""The result of a run as JSON with documented keys."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from msgspec import Struct

from imucald.core.angles import DEG_PER_RAD
from imucald.core.rotations import Rows
from imucald.core.text import json_text
from imucald.mount.estimate import ANGLES, MountEstimate, SentDeviations
from imucald.mount.mount_words import how_it_sits, mirror_note, steep_note
from imucald.runtime.engine import Engine

SENT = SentDeviations.__struct_fields__


class RunCounts(Struct, frozen=True):
    """Numbers of frames of a run: all frames read, used frames, and rejected frames by reason."""

    read: int
    used: int
    rejected: Mapping[str, int]


def summary(
    engine: Engine, counts: RunCounts, duration: float, lead: float = 0.0
) -> dict[str, Any]:
    """Return the result of a run, with the keys documented in docs/json.md.

    duration: seconds of driving. lead: time from the beginning of the log to the first configured
    frame [s].
    """
    estimate = engine.pipeline.estimator.estimate()
    pipeline = engine.pipeline
    more: dict[str, Any] = dict(engine.consumer_group.summaries())
    if engine.preprocessing is not None:
        more["model"] = engine.preprocessing.summary()
    return {
        "mount": mount_dict(estimate),
        "correction": correction_dict(estimate),
        "state": estimate.state.name.lower(),
        "waiting_for": {a: estimate.waiting_for[a] for a in ANGLES if a in estimate.waiting_for},
        "standing_faults": list(estimate.faults),
        "progress": progress_dict(estimate),
        "first_usable_s": _after(pipeline.first_usable, lead),
        "first_fine_s": _after(pipeline.first_fine, lead),
        "frames": {
            "read": counts.read,
            "used": counts.used,
            "rejected": dict(sorted(counts.rejected.items())),
        },
        "duration_s": round(duration, 6),
        "signals": {
            channel: {"samples": n, "rate_hz": round(n / duration, 3) if duration > 0 else None}
            for channel, n in sorted(engine.router.sample_counts.items())
        },
        "signal_health": pipeline.health.summary(),
        "details": plain(estimate.details),
        **more,
    }


def _after(t: float | None, lead: float) -> float | None:
    return None if t is None else round(t + lead, 3)


def mount_dict(estimate: MountEstimate) -> dict[str, Any]:
    """Return angles, quaternion, deviations and covariance of a mount. Each value is None before
    there is an estimate."""
    angles, quaternion, std = estimate.angles, estimate.quaternion, estimate.std
    result: dict[str, Any] = {
        f"{name}_deg": None if angles is None else round(angles[i] * DEG_PER_RAD, 4)
        for i, name in enumerate(ANGLES)
    }
    result["quaternion_wxyz"] = None if quaternion is None else [round(q, 8) for q in quaternion]
    result["std_deg"] = _deviations("xyz", std)
    result["angle_std_deg"] = _deviations(ANGLES, estimate.angle_std)
    covariance = estimate.covariance
    result["covariance_deg2"] = (
        None
        if covariance is None or not np.isfinite(covariance).all()
        else [[round(v, 8) for v in row] for row in (covariance * DEG_PER_RAD**2).tolist()]
    )
    return result | _for_people(estimate)


def progress_dict(estimate: MountEstimate) -> dict[str, Any] | None:
    """Return the conditions (gates) for the next state, each with its progress (share) and the
    remaining driving time. None if driving does not lead to another state.
    """
    progress = estimate.progress
    if progress is None:
        return None
    gates = [
        {
            "gate": gate.name,
            "share": math.floor(1000.0 * gate.share) / 1000.0,  # 1 only once it is there
            "left_s": None if gate.left is None else round(gate.left),
        }
        for gate in progress.gates
    ]
    return {"goal": progress.goal.name.lower(), "gates": gates}


def correction_dict(estimate: MountEstimate) -> dict[str, Any] | None:
    """Return the correction: matrices and offsets of accelerometer and gyroscope, and the
    deviations of the corrected samples. None before there is a correction. The values belong to the
    estimate. The applied correction follows the estimate in small steps from tick to tick.
    """
    found, sent = estimate.correction, estimate.sent
    if found is None:
        return None

    def rows(matrix: Rows) -> list[list[float]]:
        return [[round(v, 8) for v in matrix[3 * i : 3 * i + 3]] for i in range(3)]

    of = {name: None if sent is None else getattr(sent, name) for name in SENT}
    return {
        "matrix": rows(found.force),
        "offset_mps2": [round(v, 6) for v in found.force_offset],
        "cross_talk_std_deg": {name: _degrees(of[name]) for name in ("xy", "yx", "zx", "zy")},
        "zero_std_mps2": [plain(of[name], 4) for name in ("zero_x", "zero_y")],
        "gyro_matrix": rows(found.rate),
        "gyro_offset_rad_s": [round(v, 8) for v in found.rate_offset],
        "gyro_cross_talk_std_deg": {n: _degrees(of[f"rate_{n}"]) for n in ("xz", "yz")},
    }


def _deviations(names: Sequence[str], stds: Sequence[float] | None) -> dict[str, float | None]:
    if stds is None:
        return dict.fromkeys(names)
    return {name: _degrees(std) for name, std in zip(names, stds, strict=True)}


def _degrees(std: float | None) -> float | None:
    return None if std is None or not math.isfinite(std) else round(std * DEG_PER_RAD, 4)


def _for_people(estimate: MountEstimate) -> dict[str, Any]:
    """Return texts about the mount position of the sensor, the judged deviations, and the limits of
    these deviations."""
    found: dict[str, Any] = {"sits": how_it_sits(estimate), "steep": steep_note(estimate)}
    found["mirrored"] = mirror_note(estimate)
    found["judged_std_deg"] = _deviations("xyz", estimate.judged_std)
    if (targets := estimate.targets) is not None:
        found["target_std_deg"] = {
            goal: {a: round(s * DEG_PER_RAD, 4) for a, s in zip("xyz", std, strict=True)}
            for goal, std in (("usable", targets.usable), ("fine", targets.fine))
        }
    return found


def plain(value: object, digits: int | None = 6) -> Any:
    """Convert details to types that JSON can represent: numbers, texts, lists, mappings. Values
    that are not finite become null.

    digits: number of decimals; None for all.
    """
    if isinstance(value, Mapping):
        return {str(k): plain(v, digits) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v, digits) for v in value]
    if isinstance(value, bool | int | str) or value is None:
        return value
    number = float(value)  # type: ignore[arg-type]
    if not math.isfinite(number):
        return None
    return number if digits is None else round(number, digits)


def as_json(result: Mapping[str, Any]) -> str:
    """Return a summary as JSON text: UTF-8, indented by two spaces, without NaN."""
    return json_text(result, indent=2) + "\n"
