"""What `diagnose` says of a log: its second half beside its first, and effects that are put in."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.diagnosis.measured_logs import cut, extended
from benchmarks.diagnosis.real_effects import EFFECTS, with_effect
from imucald.core.errors import EstimateError
from imucald.core.samples import Samples
from imucald.diagnosis.baseline import baseline_model
from imucald.diagnosis.cause_keys import mount_of
from imucald.diagnosis.diagnose import diagnose
from imucald.diagnosis.recording import read_samples
from imucald.model.model import VehicleModel
from imucald.runtime.session import open_config

HIDDEN = {
    "accel_bias": 0.3, "gyro_scale": 0.06, "remount": np.radians(4.0), "clipped": 0.02,
    "gyro_stuck": 30.0, "speed_scale": 0.06,
}  # fmt: skip
"""Effects and sizes [SI], named before any log was diagnosed."""


def diagnosed(folder: Path) -> Iterator[str]:
    """Lines: of the halves, then of each effect in the whole log against its own model."""
    loaded = open_config(folder / "right.yaml")
    try:
        recording = read_samples(loaded, [folder / "drive.log"])
        plain = baseline_model(loaded, [recording])
        middle = 0.5 * recording.duration_s
        first = cut(recording.samples, 0.0, middle)
        second = cut(recording.samples, middle, recording.duration_s + 1.0)
        yield f"second half: {_said(second, extended(plain, [first]), ())}"
        whole = extended(plain, [recording.samples])
    except EstimateError as error:
        yield f"refused: {error}"
        return
    yield f"the whole beside its own model: {_said(recording.samples, whole, ())}"
    for name, size in HIDDEN.items():
        effect = EFFECTS[name]
        if any(channel not in recording.samples for channel in effect.needs):
            continue
        rng = np.random.default_rng(zlib.crc32(f"{folder.name}/{name}".encode()))
        try:
            changed, _ = with_effect(recording.samples, name, size, rng, mount_of(whole))
        except ValueError:  # stuck while driving: the log has no driving above 5 m/s
            continue
        shown = f"{size / effect.per:g} {effect.unit}"
        yield f"{name} {shown}: {_said(changed, whole, effect.right)}"


def _said(samples: Samples, model: VehicleModel, right: tuple[str, ...]) -> str:
    """What is said, with the word for it: named, likely, missed; what else was said as certain."""
    try:
        d = diagnose([samples], model)
    except EstimateError as error:
        return f"refused: {error}"
    certain, likely = [c.name for c in d.causes], [c.name for c in d.likely]
    words = []
    if right:
        told = "named" if set(right) & set(certain) else (
            "likely" if set(right) & set(likely) else "MISSED")  # fmt: skip
        words.append(told)
    if wrong := [name for name in certain if name not in right]:
        words.append(f"CERTAIN BESIDE IT: {', '.join(wrong)}" if right else
                     f"certain: {', '.join(wrong)}")  # fmt: skip
    elif not right:
        words.append("no cause is certain")
    if other := [name for name in likely if name not in right]:
        words.append(f"likely too: {', '.join(other)}")
    if sets := [" or ".join(some) for some in d.look_alikes]:
        words.append(f"look alike: {'; '.join(sets)}")
    return f"{'; '.join(words)} (verdict {d.verdict})"
