"""One case diagnosed: what was said beside what is true, as a plain mapping."""

from __future__ import annotations

import hashlib
import math
import os
import pickle
import resource
import time
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from benchmarks.diagnosis.cases import MINUTES, Case
from benchmarks.diagnosis.ideal import FACTORS, Ideal, Seen
from benchmarks.diagnosis.measured_logs import STATE, extended, read_log
from benchmarks.diagnosis.outside_effects import OUTSIDE
from benchmarks.diagnosis.real_effects import EFFECTS, with_effect
from benchmarks.measured import DATA, FOLDER
from hidden import Effect, hidden_drive
from imucald.core.errors import EstimateError
from imucald.core.samples import Samples
from imucald.diagnosis.cause_keys import mount_of, value
from imucald.diagnosis.causes import PARAMETERS
from imucald.diagnosis.diagnose import diagnose, rms_beside
from imucald.diagnosis.recording import read_samples
from imucald.diagnosis.result import Diagnosis
from imucald.model.model import VehicleModel, load_model, model_from_mapping
from imucald.runtime.session import open_config

STANDS_MPS = 0.15
STOP_S, SETTLES_S = 5.0, 1.0
"""A stop, and what of it is left out at either end."""
SIZES = ("small", "medium", "large")
SECOND_WORLD: Mapping[str, tuple[str, ...]] = {
    "none": (), "steering_ratio_error": ("steering_ratio",), "understeer": ("understeer",),
    "accel_bias": ("accel_bias",), "accel_cross_axis": ("accel_cross_axis",),
    "steering_delay": ("signal_delay",), "imu_lowpass": ("sensor_lowpass", "signal_delay"),
    "frame_dropout": ("dropouts",), "body_roll": ("body_roll",),
    "accel_saturation": ("saturation",), "crosswind_gusts": ("unknown",),
    "steering_offset_and_speed_scale": ("steering_offset", "wheel_speed_scale"),
    "mount_shift_at_200_s": ("mount_shift",),
}  # fmt: skip
"""Folder's name without its number, to what is right; low-pass and delay are alike below 1 Hz."""

GENERATED: Mapping[str, tuple[str, ...]] = {
    "sensor_lowpass": ("sensor_lowpass", "signal_delay"), "road_grade": (), "road_bank": (),
}  # fmt: skip
"""As above; slope and cross fall drop out of what is compared, so nothing is right."""


def line_of(case: Case, right: tuple[str, ...]) -> dict[str, Any]:
    """What every outcome says of its case."""
    return {"key": case.key, "part": case.part, "log": case.log, "effect": case.effect,
            "level": case.level, "draw": case.draw, "right": list(right), "said": [],
            "likely": [], "sets": [], "left": [], "values": {}, "others": {},
            "state": STATE}  # fmt: skip


def outcome(case: Case) -> dict[str, Any]:
    """Diagnose one case."""
    samples, model, right, truth = _prepared(case)
    line = line_of(case, right)
    if not samples:
        return {**line, "verdict": "refused", "lacks": "a signal that it needs"}
    began = time.process_time()
    try:
        d = diagnose([samples], model)
    except EstimateError as error:
        return {**line, "verdict": "refused", "refused": str(error)}
    seconds = time.process_time() - began
    hours = d.duration_s / 3600.0
    result = {
        **line, "minutes": round(60.0 * hours, 1), "longest_stop_s": longest_stop_s(samples),
        "verdict": d.verdict, "said": [c.name for c in d.causes],
        "likely": [c.name for c in d.likely], "sets": [list(s) for s in d.look_alikes],
        "left": sorted({s.kind for s in d.structure}), "recommended": d.recommended,
        "cpu_s": round(seconds, 2), "cpu_s_per_h": round(seconds / hours, 1),
        "mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
        "values": values_of(d), "truth": truth, "implausible": _implausible(d),
        "others": {
            key: [p.value - p.stated, p.std]
            for c in d.candidates for key, p in c.parameters.items()
        },
    }  # fmt: skip
    if case.part in {"measured", "outside", "plain"} and "gyro_bias" in result["said"]:
        result["at_rest"] = zero_at_rest(samples, model)
    if case.part in {"measured", "plain"} and truth and truth["key"]:
        own = _named_as_it_is(case.part, case.log, case.pieces, case.piece)
        result["own"] = own.get(truth["key"])
    if case.part in {"measured", "nulls"} and d.causes:
        result["file"] = _file_alone(d, samples)
    return result


def longest_stop_s(samples: Samples) -> float:
    """By the speed alone, which is below a walk's tenth."""
    t, v = samples["speed"].t, samples["speed"].values
    longest, start = 0.0, None
    for at, slow in zip(t, np.abs(v) < STANDS_MPS, strict=True):
        start = (at if start is None else start) if slow else None
        longest = max(longest, 0.0 if start is None else float(at - start))
    return round(longest, 1)


def zero_at_rest(samples: Samples, model: VehicleModel) -> dict[str, list[float]]:
    """By key: mean of the gyroscope at stops less what the file states, and its deviation between
    stops. By the speed and plain means alone, so that what the diagnosis says of it can be held
    against it."""
    means = _at_stops(samples) @ mount_of(model).T
    if len(means) < 2:
        return {}
    zero, se = means.mean(axis=0), means.std(axis=0, ddof=1) / np.sqrt(len(means))
    return {
        f"gyro.bias.{axis}": [float(zero[i] - value(model, f"gyro.bias.{axis}")), float(se[i])]
        for i, axis in enumerate("xyz")
    }


def _at_stops(samples: Samples) -> np.ndarray:
    """(N, 3) mean of the gyroscope at each stop, sensor axes [rad/s]."""
    t, stands = samples["speed"].t, np.abs(samples["speed"].values) < STANDS_MPS
    edges = np.flatnonzero(np.diff(np.concatenate([[0], stands.astype(int), [0]])))
    gyro, made = samples["gyro"], []
    for first, end in edges.reshape(-1, 2):
        if t[end - 1] - t[first] >= STOP_S:
            inside = (gyro.t > t[first] + SETTLES_S) & (gyro.t < t[end - 1] - SETTLES_S)
            if inside.any():
                made.append(gyro.values[inside].mean(axis=0))
    return np.reshape(made, (-1, 3))


@lru_cache(32)
def _named_as_it_is(part: str, log: str, pieces: int, piece: int) -> Mapping[str, list[float]]:
    """What is named in a piece without an effect, beside the same file: value, deviation."""
    without = "plain_nulls" if part == "plain" else "nulls"
    samples, model, *_ = _prepared(Case(without, log, pieces=pieces, piece=piece))
    try:
        d = diagnose([samples], model)
    except EstimateError:
        return {}
    return {key: x[:2] for key, x in values_of(d).items()}


def _prepared(case: Case) -> tuple[Samples, VehicleModel, tuple[str, ...], Any]:
    if case.part in {"nulls", "measured", "outside", "plain", "plain_nulls"}:
        return _measured(case)
    if case.part == "second_world":
        folder = DATA / "second_world" / case.log
        recording = read_samples(open_config(folder / "car.yaml"), [folder / "can.log.gz"])
        return recording.samples, load_model(folder / "model.yaml"), SECOND_WORLD[case.effect], None
    effects = (Effect(case.effect, SIZES[case.level]),) if case.effect else ()
    drive = hidden_drive(int(case.log), effects, MINUTES)
    model = model_from_mapping(dict(drive.model), "baseline")
    right = GENERATED.get(case.effect, (case.effect,) * bool(effects))
    if case.part == "generated_outside":
        right = ("unknown",)
    return drive.samples, model, right, None


def _measured(case: Case) -> tuple[Samples, VehicleModel, tuple[str, ...], Any]:
    """A piece with an effect, and the model that the other pieces gave."""
    log = read_log(case.log)
    pieces = log.pieces(case.pieces)
    plain = case.part.startswith("plain")
    samples = pieces[case.piece]
    model = log.plain(samples) if plain else piece_model(case)
    rng, R = rng_of(case), mount_of(model)
    if case.part == "outside":
        made = of_medium_size(case)
        if made is None:
            return {}, model, ("unknown",), None
        changed, size, seen = made
        truth = {"size": size, "shows_in": seen.equation, "ideal": round(seen.ideal, 2),
                 "needed": round(seen.needed, 2)}  # fmt: skip
        return changed, model, ("unknown",), truth
    if not case.effect:
        return samples, model, (), None
    effect = EFFECTS[case.effect]
    if not all(name in samples for name in effect.needs):
        return {}, model, effect.right, None
    changed, x = with_effect(samples, case.effect, effect.sizes[case.level], rng, R)
    if plain:
        model = log.plain(changed)
    return changed, model, effect.right, {"key": effect.key, "value": x}


def of_medium_size(case: Case) -> tuple[Samples, float, Seen] | None:
    """A piece with an effect that the catalogue lacks, its size and what is there to be seen.

    The size is the effect's own, or up to three times it where a test that knows nothing of its
    shape could not see it (`ideal`). None: the signal is not there.
    """
    samples = read_log(case.log).pieces(case.pieces)[case.piece]
    put, size, needs = OUTSIDE[case.effect]
    if needs not in samples:
        return None
    model = piece_model(case)
    try:
        ideal = _ideal(case.log, case.pieces, case.piece)
    except EstimateError:
        return None
    made = []
    for factor in FACTORS:
        changed = dict(samples)
        put(changed, factor * size, rng_of(case), mount_of(model))
        seen = ideal.of(changed)[0]
        made.append((changed, factor * size, seen))
        if seen.ratio >= 1.0:
            return made[-1]
    return made[0]


@lru_cache(6)
def _ideal(log: str, pieces: int, piece: int) -> Ideal:
    case = Case("outside", log, pieces=pieces, piece=piece)
    return Ideal(read_log(log).pieces(pieces)[piece], piece_model(case))


def rng_of(case: Case) -> np.random.Generator:
    return np.random.default_rng(int(hashlib.sha256(case.key.encode()).hexdigest()[:8], 16))


def piece_model(case: Case) -> VehicleModel:
    """Kept on the disk, by the code that made it."""
    FOLDER.mkdir(exist_ok=True)
    path = FOLDER / f"diagnosis-{STATE}-{case.log}-{case.piece}of{case.pieces}.pkl"
    if path.exists():
        model: VehicleModel = pickle.loads(path.read_bytes())
        return model
    log = read_log(case.log)
    others = [p for i, p in enumerate(log.pieces(case.pieces)) if i != case.piece]
    model = extended(log.baseline, others)
    making = path.with_name(f"making-{os.getpid()}-{path.name}")
    making.write_bytes(pickle.dumps(model))
    making.rename(path)
    return model


def values_of(d: Diagnosis) -> dict[str, list[float]]:
    """Found parameter: departure, deviation, quantile."""
    return {
        key: [p.value - p.stated, p.std, c.evidence.get("quantile", 3.0)]
        for c in d.causes
        for key, p in c.parameters.items()
        if math.isfinite(p.value - p.stated)
    }


def _implausible(d: Diagnosis) -> list[str]:
    """Found parameters that no vehicle and no sensor can have."""
    made = []
    for key, p in ((k, p) for c in d.causes for k, p in c.parameters.items() if k in PARAMETERS):
        low, high = PARAMETERS[key].plausible
        by = abs(p.stated) if PARAMETERS[key].relative else 1.0
        if not low * by <= p.value - p.stated <= high * by:
            made.append(key)
    return made


def _file_alone(d: Diagnosis, samples: Samples) -> dict[str, list[float]]:
    """By signal: rms that the page says *after*, and that of the written file put to the test."""
    try:
        again = rms_beside([samples], d.model_after)
    except EstimateError:
        return {}
    return {
        name: [s.rms_before, s.rms_after, again[name]]
        for name, s in d.signals.items()
        if name in again
    }
