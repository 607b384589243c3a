"""Attitude of the vehicle: methods B and C against an INS, simulated truth and open filters.

    python -m benchmarks.attitude [kingston|drives|turn|parked|check|heading ...]

Needs the `ahrs` and `imufusion` packages for the comparison (extra `dev`).
"""

from __future__ import annotations

import gzip
import math
import sys
from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from benchmarks.attitude_drives import Event, Truth, feed, kingston, simulated
from benchmarks.attitude_methods import (
    PEERS,
    Array,
    Track,
    accelerometer_only,
    best_gain,
    compensated,
    filtered,
    madgwick,
    mahony,
    paired,
    rms_degrees,
)
from benchmarks.measured import DATA, MEASURED_DRIVES, is_here, nothing_measured, verdict
from benchmarks.six_positions import find_rests, six_parameters
from imucald.attitude.filter import AttitudeFilter
from imucald.can.logs.log_reader import LogReader
from imucald.config import load_config, parse_config
from imucald.config.attitude import AttitudeSettings, FilterSettings
from imucald.core.samples import GRAVITY
from imucald.model.model import VehicleModel
from imucald.mount.estimate import Correction
from imucald.runtime.consumers import AttitudeConsumer
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine
from imucald.simulation.drive import simulate
from imucald.simulation.filters import generator

ACCEL_BIAS = 0.098
"""Accelerometer bias of the simulated drives, and what the filter is told of it [m/s^2]."""
SETTINGS = AttitudeSettings(filter=FilterSettings(accel_random=ACCEL_BIAS))
WARM_S = 60.0
"""Errors count from here on [s]: everybody has started."""
MOVING = 1.0
GAINS = (0.0001, 0.0003, 0.001, 0.003, 0.01, 0.03, 0.1)
RUNS = 12
MINUTES = 10.0
ACCEL_WALK = 0.001
"""Walk of the accelerometer's zero error [m/s^2/sqrt(s)]: 0.017 in five minutes."""
RESOLUTION = 0.01
"""Of angles on the bus [deg]."""
ITS_HEADING = """  heading:
    signal: gnss_attitude.Heading
    valid_when: {signal: AttitudeValid, equals: 1}
attitude: {enabled: true}
"""
WARM_ROWS = 30
"""Headings, one a second, from whose median the drift counts."""
MODULE_STD = math.radians(1.3)
"""Of the module's heading: nine in ten are better by its own accuracy signal."""
COVERED = 0.9
DRIFT = 0.005
"""Walk of the gyroscope's zero error in five minutes, standard deviation [deg/s]."""


def ins() -> bool:
    print("\n1. kingston_2008 against its INS, after the mount that replay finds\n")
    events, truth, _ = kingston()
    settings = load_config(MEASURED_DRIVES / "kingston_2008.yaml").config.attitude
    both, _ = filtered(events, settings)
    tracks: dict[str, Track] = {
        "(a) accelerometer": accelerometer_only(events),
        "(b) with B": compensated(events, settings),
        "(c) B + C": both,
    }
    samples = paired(events)
    for name, peer in PEERS.items():
        tracks[f"(d) {name}"] = peer(*samples)
    use = truth.t > WARM_S

    def error(track: Track) -> Array:
        return np.asarray((track.at(truth.t)[0] - truth.roll_pitch)[use])

    for name, make in (("Madgwick", madgwick), ("Mahony", mahony)):
        gain, best = best_gain(make, GAINS, lambda one: rms_degrees(error(one)), samples)
        tracks[f"(d) {name}, gain {gain} by truth"] = best
    moving = truth.speed[use] > MOVING
    print("| method | roll rms | pitch rms | roll, moving | pitch, moving | [deg]")
    print("|---|---|---|---|---|")
    size: dict[str, tuple[float, float]] = {}
    for name, track in tracks.items():
        e = error(track)
        size[name] = (rms_degrees(e[:, 0]), rms_degrees(e[:, 1]))
        row = [*size[name], rms_degrees(e[moving, 0]), rms_degrees(e[moving, 1])]
        print(f"| {name} | " + " | ".join(f"{v:.3f}" for v in row) + " |")
    e, std = error(both), both.at(truth.t)[1][use]
    cover = np.mean(np.abs(e) < 1.96 * std, axis=0)
    rest = truth.speed[use] < 0.05
    offset = np.degrees(np.median(error(tracks["(a) accelerometer"])[rest], axis=0))
    print(f"\naccelerometer less INS at rest (median): roll {offset[0]:+.3f} deg, pitch "
          f"{offset[1]:+.3f} deg; nothing is taken off for it")  # fmt: skip
    print(f"95 % interval covers roll {100 * cover[0]:.1f} %, pitch {100 * cover[1]:.1f} %")
    ours = size.pop("(c) B + C")
    beats = all(ours[0] < other[0] and ours[1] < other[1] for other in size.values())
    covers = bool(np.all((cover >= 0.90) & (cover <= 0.98)))
    print(f"B + C beats every other: {verdict(beats)}; covers 90 to 98 %: {verdict(covers)}")
    return beats and covers


def drive_of(seed: int, kind: str, minutes: float = MINUTES) -> tuple[list[Event], Truth, Array]:
    """A drive with random errors of the sizes that the filter's presets speak of.

    The gyroscope's error walks by DRIFT in five minutes; the presets allow for twice that.
    """
    rng = np.random.default_rng(seed)
    c = SETTINGS.filter
    bias = np.array(c.gyro_start) * rng.standard_normal(3)
    walk = math.radians(DRIFT) / math.sqrt(300.0)
    model = VehicleModel().with_changes(
        {
            "route.kind": kind,
            "gyro.bias": tuple(bias.tolist()),
            "gyro.bias_walk": walk,
            "accel.bias": tuple((ACCEL_BIAS * rng.standard_normal(3)).tolist()),
            "accel.bias_walk": ACCEL_WALK,
            "gyro.scale": tuple((c.gyro_scale * rng.standard_normal(3)).tolist()),
            "gyro.cross_axis": tuple((c.gyro_scale * rng.standard_normal(6)).tolist()),
            "speed.scale": 0.01 * float(rng.standard_normal()),
            "mount.lever_arm_m": (0.4, 0.1, 0.5),
        }
    )
    drive = simulate(model, seed, minutes)
    t = drive.samples["gyro"].t
    shape = (round(minutes * 60.0 * model.gyro.rate_hz) + 1, 3)
    steps = generator(seed, "walk:gyro").standard_normal(shape)
    walked = bias + np.cumsum(steps, axis=0) * walk / math.sqrt(model.gyro.rate_hz)
    events, truth = simulated(drive)
    true_bias = np.array([np.interp(300.0, t[: len(walked)], w[: len(t)]) for w in walked.T])
    return events, truth, true_bias


def drives() -> bool:
    print(f"\n2. {RUNS} simulated drives of {MINUTES:.0f} min: grade, bank, bumps, bias drift\n")
    print("| drive | roll rms | pitch rms | gyro bias error after 5 min | NEES | grade rms |")
    print("|---|---|---|---|---|---|")
    worst, worst_bias, nees = 0.0, 0.0, []
    for seed in range(1, RUNS + 1):
        kind = ("mixed", "city", "motorway")[seed % 3]
        events, truth, bias = drive_of(seed, kind)
        attitude = AttitudeFilter(SETTINGS)
        found: list[tuple[float, ...]] = []
        at_300: list[Array] = []

        def after(t: float, channel: str, attitude: AttitudeFilter = attitude,
                  found: list[tuple[float, ...]] = found,
                  at_300: list[Array] = at_300) -> None:  # fmt: skip
            if channel != "accel" or not attitude.running:
                return
            if t >= 300.0 and not at_300:
                at_300.append(np.array(attitude.estimate().bias))
            if not found or t - found[-1][0] > 0.095:
                e = attitude.estimate()
                found.append((t, e.roll, e.pitch, *e.std[:2], e.grade))

        feed(attitude, events, after)
        table = np.array(found)
        index = np.searchsorted(truth.t, table[:, 0]).clip(0, len(truth.t) - 1)
        e = table[:, 1:3] - truth.roll_pitch[index]
        use = (table[:, 0] > WARM_S) & (np.abs(truth.speed[index]) > MOVING)
        roll, pitch = rms_degrees(e[use, 0]), rms_degrees(e[use, 1])
        bias_error = math.degrees(float(np.abs(at_300[0] - bias).max()))
        q = float(np.mean(((e / table[:, 3:5]) ** 2).sum(axis=1)[use]))
        nees.append(q)
        worst, worst_bias = max(worst, roll, pitch), max(worst_bias, bias_error)
        assert truth.grade is not None
        grade = 100.0 * float(np.sqrt(np.nanmean((table[:, 5] - truth.grade[index])[use] ** 2)))
        print(
            f"| {kind} {seed} | {roll:.3f} deg | {pitch:.3f} deg | {bias_error:.4f} deg/s "
            f"| {q:.2f} | {grade:.2f} % |"
        )
    low, high = (float(chi2.ppf(p, 2 * RUNS)) / RUNS for p in (0.025, 0.975))
    mean = float(np.mean(nees))
    print(f"\nmean NEES {mean:.2f}, its 95 % bounds for {RUNS} drives {low:.2f} .. {high:.2f}")
    met = (worst <= 0.5, worst_bias <= 0.02, low <= mean <= high)
    print(f"roll and pitch <= 0.5 deg: {verdict(met[0])}; bias within 0.02 deg/s: "
          f"{verdict(met[1])}; consistent: {verdict(met[2])}")  # fmt: skip
    return all(met)


def turn() -> bool:
    print("\n2b. 0.3 g turn at 15 m/s, on level road\n")
    rng = np.random.default_rng(3)
    rate_hz, speed = 100.0, 15.0
    t = np.arange(0.0, 120.0, 1.0 / rate_hz)
    v = np.clip((t - 20.0) * 1.5, 0.0, speed)
    r = 0.3 * GRAVITY / speed * np.clip((t - 50.0) / 2.0, 0.0, 1.0)
    accel = np.column_stack([np.gradient(v, t), r * v, np.full_like(t, GRAVITY)])
    gyro = np.column_stack([0.0 * t, 0.0 * t, r]) + 0.004
    accel += 0.05 * rng.standard_normal(accel.shape)
    gyro += 0.001 * rng.standard_normal(gyro.shape)
    events: list[Event] = []
    for i, at in enumerate(t.tolist()):
        if i % 10 == 0:
            events.append((at, "speed", [round(float(v[i]) * 3.6) / 3.6]))
        events += [(at, "gyro", gyro[i].tolist()), (at, "accel", accel[i].tolist())]
    turning = t > 52.0
    largest = {}
    b_only = compensated(events, SETTINGS)
    both, _ = filtered(events, SETTINGS)
    for name, track in (
        ("accelerometer", accelerometer_only(events)),
        ("B", b_only),
        ("B + C", both),
    ):
        angles, _ = track.at(t[turning])
        rms = rms_degrees(angles)
        largest[name] = math.degrees(float(np.nanmax(np.abs(angles))))
        print(f"{name:14s} largest error {largest[name]:6.2f} deg, rms {rms:.2f} deg")
    met = largest["B + C"] < 1.0 and largest["accelerometer"] > 10.0
    print(f"under 1 deg where the uncompensated exceeds 10: {verdict(met)}")
    return met


def parked() -> bool:
    print("\n3. Parked for an hour\n")
    changes = {
        "route.kind": "parked",
        "gyro.bias": (0.004, -0.003, 0.002),
        "gyro.bias_walk": 1e-6,
        "accel.bias_walk": 1e-4,
    }
    events, truth = simulated(simulate(VehicleModel().with_changes(changes), 5, 60.0))
    raw = accelerometer_only(events)
    both, _ = filtered(events, SETTINGS)

    def drift(of: Track) -> Array:
        """Mean of the last five minutes less that of minutes 5 to 10 [deg]."""
        parts = ((of.t > 300.0) & (of.t < 600.0), of.t > 3300.0)
        first, last = (of.angles[part].mean(axis=0) for part in parts)
        return np.asarray(np.degrees(last - first))

    late = both.t > 300.0
    index = np.searchsorted(truth.t, both.t[late]).clip(0, len(truth.t) - 1)
    error = np.degrees(np.abs(both.angles[late] - truth.roll_pitch[index]).max())
    ours, own = drift(both), drift(raw)  # the sensor's own error walks, and both follow it
    print(
        f"drift in 50 minutes, roll and pitch: filter {ours.round(4)} deg, accelerometer "
        f"{own.round(4)} deg; largest error of the filter at any sample {error:.3f} deg"
    )
    met = bool(np.abs(ours - own).max() < RESOLUTION)
    print(f"no drift beyond the sensor's own by the frames' resolution (0.01 deg): {verdict(met)}")
    return met


def check() -> bool:
    print("\n5. static_xsens: six-parameter fit from rest in many positions\n")
    with gzip.open(DATA / "static_xsens" / "accelerometer.txt.gz", "rt") as file:
        raw = np.loadtxt(file)
    rests = find_rests(raw[:, 0], raw[:, 1:], threshold=12.0)
    fit = six_parameters(rests.means)
    known = np.array([33122.0, 33280.0, 32372.0])
    print(f"{len(rests.means)} rests; bias {np.round(fit.bias, 1)} counts (known {known}), scale "
          f"{np.round(fit.scale, 6)} m/s^2 per count (known 0.00242), residual "
          f"{fit.residual:.4f} m/s^2 rms (known 0.033)")  # fmt: skip
    met = bool(
        np.abs(fit.bias - known).max() < 5.0
        and np.abs(fit.scale / 0.00242 - 1.0).max() < 0.005
        and fit.residual < 0.04
    )
    print(f"bias within 5 counts (0.012 m/s^2), scale within 0.5 %: {verdict(met)}")
    return met


def heading() -> bool:
    """The heading on a bus whose sensor module fuses one of its own, counted from the start."""
    print("\n6. css_canmod_164: relative heading beside that of its module with satellites\n")
    file = MEASURED_DRIVES / f"{MEASURED['heading']}.yaml"
    engine = make_engine(parse_config(file.read_text("utf-8") + ITS_HEADING, file))
    (consumer,) = engine.consumers
    assert isinstance(consumer, AttitudeConsumer)
    take, rows = consumer.sample, []

    def sample(t: float, channel: str, values: Sequence[float], R: Correction | None) -> None:
        take(t, channel, values, R)
        if channel == "heading" and consumer.filter.running:
            e = consumer.filter.estimate()
            rows.append((t, e.heading - values[0], e.std[2]))

    consumer.sample = sample  # type: ignore[method-assign]
    log = DATA / MEASURED["heading"] / "drive.log.gz"
    for _ in Replay(engine, LogReader([log], engine.router.matches)).chunks():
        pass
    t, difference, std = np.array(rows).T
    drift = np.unwrap(difference)
    drift -= np.median(drift[:WARM_ROWS])
    print("| after | drift | standard deviation stated | [deg]\n|---|---|---|")
    for after in (120.0, 300.0, 600.0, 1200.0, math.inf):
        i = min(int(np.searchsorted(t - t[0], after)), len(t) - 1)
        print(f"| {t[i] - t[0]:.0f} s | {np.degrees(drift[i]):+.1f} | {np.degrees(std[i]):.1f} |")
    late = t - t[0] > WARM_S
    cover = float(np.mean(np.abs(drift[late]) < 1.96 * np.hypot(std[late], MODULE_STD)))
    print(f"\n95 % interval covers {100 * cover:.1f} % of the module's headings, which are taken "
          f"as right to 1.3 deg: {verdict(cover >= COVERED)} (bar: 90 %)")  # fmt: skip
    return cover >= COVERED


PARTS = {
    "kingston": ins,
    "drives": drives,
    "turn": turn,
    "parked": parked,
    "check": check,
    "heading": heading,
}

MEASURED = {
    "kingston": "kingston_2008",
    "check": "static_xsens",
    "heading": "css_canmod_164",
}
"""Parts that need a measured drive."""


def main() -> int:
    chosen = sys.argv[1:] or list(PARTS)
    absent = {name: MEASURED[name] for name in chosen
              if name in MEASURED and not is_here(MEASURED[name])}  # fmt: skip
    met = [PARTS[name]() for name in chosen if name not in absent]
    if absent:
        return nothing_measured(*absent.values())
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main())
