"""Measured logs: what the simulation gets wrong there, and what is found when it is hidden there.

    python -m benchmarks.diagnosis.real_logs [--only LOG ...] [--draws N] [--effects NAME ...]
                                             [--clean] [--results FILE] [--write]

Each log is diagnosed with its shipped configuration, against a plain car with the mount that the
drive gives, and what is named is put beside something independent in the same data. Then the
extended model is taken as the vehicle's model file, extended again by the second half until that
gives nothing, and effects of five sizes are put into the second half's samples (`real_effects`):
found or not, by size.
--clean: only the logs as they are.
"""

from __future__ import annotations

import argparse
import gzip
import json
import math
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.diagnosis.page import PAGE, written
from benchmarks.diagnosis.real_effects import EFFECTS, with_effect
from benchmarks.measured import DATA, EXAMPLES, FOLDER
from imucald.core.rotations import rotation_from_angles
from imucald.core.samples import Samples, Series
from imucald.diagnosis.baseline import baseline_model
from imucald.diagnosis.diagnose import diagnose
from imucald.diagnosis.recording import Recording, read_samples
from imucald.diagnosis.result import Diagnosis
from imucald.model.model import VehicleModel
from imucald.runtime.session import open_config

LOGS = ("kingston_2008", "css_canmod_164", "wrx_sti")
HIDDEN_IN = ("kingston_2008",)
"""Long enough for a half to hold a drive's manoeuvres, and with signals quick enough for all."""
MOST_EXTENSIONS = 3
DRAWS = 4
RESULTS = FOLDER / "diagnosis-real.jsonl"
BEGIN, END = "<!-- real figures -->", "<!-- end of real figures -->"
LARGEST_SET = 3
FOUND_SHARE = 0.9
Array = NDArray[np.float64]


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", nargs="+", choices=LOGS, default=list(LOGS), metavar="LOG")
    parser.add_argument("--effects", nargs="+", choices=list(EFFECTS), default=list(EFFECTS))
    parser.add_argument("--draws", type=int, default=DRAWS)
    parser.add_argument("--clean", action="store_true")
    parser.add_argument("--results", type=Path, default=RESULTS)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    options.results.parent.mkdir(parents=True, exist_ok=True)
    out: list[str] = []
    for name in options.only:
        if not (DATA / name).is_dir():
            print(f"{name}: not there", file=sys.stderr)
            continue
        log = read_log(name)
        began = time.process_time()
        diagnosis = diagnose([log.recording.samples], log.baseline)
        out += [*as_it_is(log, diagnosis, time.process_time() - began), ""]
        if not options.clean and name in HIDDEN_IN:
            model = extended(diagnosis.model_after, log.part(0.5, 1.0))
            lines = list(hidden(log, model, options.effects, options.draws, options.results))
            out += [*table(log.name, lines, options.effects), ""]
    text = "\n".join(out)
    print(text)
    if options.write:
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(written(page, text, BEGIN, END), encoding="utf-8")
    return 0


@dataclass(frozen=True)
class Log:
    """A measured log as the daemon reads it, and the model it is put beside."""

    name: str
    recording: Recording
    baseline: VehicleModel

    def part(self, start: float, stop: float) -> Samples:
        """Samples within shares of the time."""
        return cut(self.recording.samples, *(x * self.recording.duration_s for x in (start, stop)))


def read_log(name: str) -> Log:
    loaded = open_config(EXAMPLES / f"{name}.yaml")
    recording = read_samples(loaded, [DATA / name / "drive.log.gz"])
    return Log(name, recording, baseline_model(loaded, [recording]))


def cut(samples: Samples, start: float, stop: float) -> dict[str, Series]:
    """Samples with start <= t < stop, from 0 on."""
    result = {}
    for channel, series in samples.items():
        inside = (series.t >= start) & (series.t < stop)
        result[channel] = Series(series.t[inside] - start, series.values[inside])
    return result


# as it is --------------------------------------------------------------------------------------


def as_it_is(log: Log, diagnosis: Diagnosis, seconds: float) -> Iterator[str]:
    """The log's diagnosis, and what confirms it."""
    yield f"### {log.name}: {log.recording.duration_s / 60.0:.0f} min, {seconds:.0f} s"
    yield ""
    yield f"- Verdict: `{diagnosis.verdict}`."
    for cause in diagnosis.causes:
        values = ", ".join(
            f"{name} {p.value:.4g} ± {p.std:.2g} {p.unit}" for name, p in cause.parameters.items()
        )
        odds = cause.evidence.get("log_bayes_factor", float("nan"))
        yield f"- **{cause.name}** ({values}), log Bayes factor {odds:.0f}."
    for names in diagnosis.look_alikes:
        yield f"- Not told apart: {', '.join(names)}. {diagnosis.to_separate}"
    for s in diagnosis.structure:
        yield f"- Left over: {s.signal}, {s.text}"
    gain = diagnosis.gain
    low, high = gain.interval
    if math.isfinite(gain.held_out_log_likelihood):
        yield (
            f"- Held-out log-likelihood {gain.held_out_log_likelihood:.0f} nats "
            f"(95 % {low:.0f} to {high:.0f})."
        )
    else:
        yield "- Too short to hold anything out: *after* is what the fit to all of it leaves."
    yield ""
    yield "| signal | residual before | after | noise floor |"
    yield "|---|---|---|---|"
    for name, s in diagnosis.signals.items():
        unit = s.unit.replace("^2", "²")
        yield f"| {name} [{unit}] | {s.rms_before:.4f} | {s.rms_after:.4f} | {s.noise_floor:.4f} |"
    yield ""
    if log.name == "kingston_2008":
        yield from confirm_kingston(log, diagnosis)
    if log.name == "wrx_sti":
        yield from confirm_wrx(log, diagnosis)
    yield from confirm_delay(log, diagnosis)


def confirm_kingston(log: Log, diagnosis: Diagnosis) -> Iterator[str]:
    """Grade against the pitch of the INS, over the distance driven."""
    with gzip.open(DATA / log.name / "ins_truth.csv.gz", "rt") as file:
        table = np.genfromtxt(file, delimiter=",", names=True)
    speed = np.hypot(table["v_east_mps"], table["v_north_mps"])
    moving = speed > 1.0
    pitch = np.radians(table["pitch_deg"][moving])
    rise = np.arctan2(table["v_up_mps"][moving], speed[moving])
    weight = speed[moving]

    def rms(x: Array) -> float:
        mean = np.average(x, weights=weight)
        return float(np.sqrt(np.average((np.tan(x) - mean) ** 2, weights=weight)))

    yield (
        f"- Independent: slope by the INS, over the distance: {100 * rms(pitch):.2f} % rms from "
        f"its pitch, {100 * rms(rise):.2f} % from its vertical velocity; the model file said "
        f"{100 * log.baseline.road.grade_rms:.2f} %, the extended one says "
        f"{100 * diagnosis.model_after.road.grade_rms:.2f} %."
    )


WRX_TRACK_M = 1.535
WRX_LITERATURE = (
    "The maker's figures for this model: steering ratio 15.0 (2008 to 2014) or 13.0 (from 2015), "
    "track 1.53 m in front, 1.54 m behind. Passenger cars understeer by 1 to 4 deg/g at the road "
    "wheel"
)


def confirm_wrx(log: Log, diagnosis: Diagnosis) -> Iterator[str]:
    """Steering by plain least squares, yaw rate by the wheels' difference: not used by `diagnose`.

    steering = ratio (L r / v + K v r) + offset; (v_right - v_left) = track * r.
    """
    s = log.recording.samples
    t = np.arange(2.0, log.recording.duration_s - 2.0, 0.02)
    window = np.ones(25) / 25.0

    def on_grid(channel: str, column: int | None = None) -> Array:
        values = s[channel].values if column is None else s[channel].values[:, column]
        smooth = np.convolve(values, window, "same")
        return np.interp(t, s[channel].t, smooth)

    v, wheel, yaw = on_grid("speed"), on_grid("steering"), on_grid("yaw_rate")
    forward = (v > 2.0) & (np.interp(t, s["reverse"].t, s["reverse"].values) < 0.5)
    v, wheel, yaw = v[forward], wheel[forward], yaw[forward]
    left, right = (on_grid("wheel_speeds", i)[forward] for i in (2, 3))
    track = float(np.polyfit(yaw, right - left, 1)[0])
    columns = np.column_stack(
        [log.baseline.chassis.wheelbase_m * yaw / v, v * yaw, np.ones_like(v)]
    )
    ratio, product, _ = np.linalg.lstsq(columns, wheel, rcond=None)[0]
    per_g = np.degrees(product / ratio) * 9.80665
    after = diagnosis.model_after
    yield (
        f"- Independent: the rear wheels' difference over the yaw rate gives a track of "
        f"{track:.2f} m, where the car has {WRX_TRACK_M:.2f}: the yaw rate reads "
        f"{WRX_TRACK_M / track:.2f} of the true one, if the wheels are right; the extended model "
        f"says {1.0 + after.yaw_rate.scale:.2f}."
    )
    yield (
        f"- Independent: plain least squares on the signals as they are: ratio {ratio:.1f}, "
        f"understeer {per_g:.1f} deg/g (with the yaw rate's scale by the wheels: "
        f"{ratio * WRX_TRACK_M / track:.1f}); the extended model says "
        f"{after.chassis.steering_ratio:.1f} and "
        f"{np.degrees(after.chassis.understeer_gradient) * 9.80665:.1f} deg/g. {WRX_LITERATURE}."
    )


DELAYS: Mapping[str, str] = {
    "kingston_2008": "speed leads the accelerometer by 0.20 to 0.25 s",
    "css_canmod_164": "OBD-II speed leads the accelerometer by about 0.15 s",
}
"""What the data's own table says, found by other means than the diagnosis."""


def confirm_delay(log: Log, diagnosis: Diagnosis) -> Iterator[str]:
    if log.name in DELAYS:
        after = diagnosis.model_after
        lead = after.accel.delay_s - after.speed.delay_s
        yield (
            f"- Independent: {DELAYS[log.name]}; the extended model says that it leads by "
            f"{lead:.3f} s."
        )


# with effects ----------------------------------------------------------------------------------


def extended(model: VehicleModel, samples: Samples) -> VehicleModel:
    """The model that describes samples without an effect as far as a diagnosis can say."""
    for _ in range(MOST_EXTENSIONS):
        diagnosis = diagnose([samples], model)
        if not diagnosis.causes:
            break
        model = diagnosis.model_after
    return model


def hidden(
    log: Log, model: VehicleModel, effects: Sequence[str], draws: int, path: Path
) -> Iterator[dict[str, Any]]:
    """Put effects into the second half; outcomes are kept in the file."""
    known = {}
    if path.exists():
        for text in path.read_text(encoding="utf-8").splitlines():
            line = json.loads(text)
            known[line["key"]] = line
    samples = log.part(0.5, 1.0)
    with path.open("a", encoding="utf-8") as file:
        for key, effect, level, draw in _cases(log.name, effects, draws):
            if key not in known:
                known[key] = _one(key, samples, model, effect, level, draw)
                file.write(json.dumps(known[key]) + "\n")
                file.flush()
                print(key, known[key]["verdict"], known[key]["said"], file=sys.stderr, flush=True)
            yield known[key]


def _cases(log: str, effects: Sequence[str], draws: int) -> Iterator[tuple[str, str, int, int]]:
    yield f"{log}/clean", "", 0, 0
    for draw in range(draws):
        for level in range(5):
            for effect in effects:
                yield f"{log}/{effect}/{level}/{draw}", effect, level, draw


def _one(
    key: str, samples: Samples, model: VehicleModel, effect: str, level: int, draw: int
) -> dict[str, Any]:
    size = 0.0
    if effect:
        size = EFFECTS[effect][2][level]
        rng = np.random.default_rng([level, draw, sum(map(ord, effect))])
        mount = model.mount
        angles = (np.radians(x) for x in (mount.roll_deg, mount.pitch_deg, mount.yaw_deg))
        samples = with_effect(samples, effect, size, rng, rotation_from_angles(*angles))
    diagnosis = diagnose([samples], model)
    return {
        "key": key,
        "effect": effect,
        "level": level,
        "size": size,
        "verdict": diagnosis.verdict,
        "said": [cause.name for cause in diagnosis.causes],
        "look_alikes": [list(names) for names in diagnosis.look_alikes],
    }


def is_found(line: Mapping[str, Any], cause: str) -> bool:
    """The cause was named, alone, beside others or in a set of at most three."""
    if cause in line["said"]:
        return True
    sets = [set(s) for s in line["look_alikes"] if len(s) <= LARGEST_SET]
    return any(cause in s and s & set(line["said"]) for s in sets)


def table(log: str, lines: Sequence[Mapping[str, Any]], effects: Sequence[str]) -> Iterator[str]:
    """Share found by size, and the size from which nine in ten are."""
    clean = next(line for line in lines if not line["effect"])
    yield f"#### Hidden in the second half of {log}"
    yield ""
    said = ", ".join(clean["said"]) or "no cause"
    yield f"Without an effect: `{clean['verdict']}`, {said}."
    yield ""
    yield "| effect | found of, by size | 90 % from |"
    yield "|---|---|---|"
    for effect in effects:
        cause, _, sizes, unit, scale = EFFECTS[effect]
        if is_found(clean, cause):
            yield f"| {effect} | named without it | |"
            continue
        shares, cells = [], []
        for level, size in enumerate(sizes):
            some = [x for x in lines if x["effect"] == effect and x["level"] == level]
            count = sum(is_found(x, cause) for x in some)
            shares.append(count / max(len(some), 1))
            cells.append(f"{size / scale:g}: {count}/{len(some)}")
        start = ninety(sizes, shares)
        where = f"{start / scale:.3g} {unit}" if start is not None else "not reached"
        yield f"| {effect} [{unit}] | {', '.join(cells)} | {where} |"


def ninety(sizes: Sequence[float], shares: Sequence[float]) -> float | None:
    """Size at which the share reaches 90 % for good, between sizes on a log scale."""
    reached = [share >= FOUND_SHARE for share in shares]
    if not reached[-1]:
        return None
    first = len(reached) - 1
    while first > 0 and reached[first - 1]:
        first -= 1
    if first == 0:
        return sizes[0]
    low, high = shares[first - 1], shares[first]
    part = (FOUND_SHARE - low) / (high - low)
    return float(sizes[first - 1] * (sizes[first] / sizes[first - 1]) ** part)


if __name__ == "__main__":
    sys.exit(main())
