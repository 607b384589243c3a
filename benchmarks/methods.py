"""Methods A to D on measured data, each beside its published form (see docs/methods.md).

    python -m benchmarks.methods

The published forms are the reference implementations in tests/publications, written from the
publications alone; D's figures are those of `python -m benchmarks.walk`.
"""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np

from benchmarks.measured import DATA, MEASURED_DRIVES, ROOT, is_here, nothing_measured

sys.path.insert(0, str(ROOT / "tests"))

from benchmarks.attitude_drives import kingston
from benchmarks.attitude_methods import Track, compensated, filtered, rms_degrees
from imucald.can.logs.log_reader import LogReader
from imucald.config import LoadedConfig, load_config, parse_config
from imucald.config.attitude import AttitudeSettings, MotionCompensationSettings
from imucald.runtime.session import make_engine
from publications import on_the_van
from publications.recordings import recording
from publications.test_method_b import braking_turn

REST = slice(0, 250)
"""Samples of the van at rest, at 10 Hz."""


def configured(keys: str) -> LoadedConfig:
    """The van's configuration with keys of `calibration`."""
    path = MEASURED_DRIVES / "kingston_2008.yaml"
    return parse_config(f"{path.read_text()}calibration: {keys}\n", path)


def method_a() -> None:
    print("\nA. Yaw of the van's mount against its INS (+-0.3 deg)\n")
    samples = recording(on_the_van.NAME)
    J = samples["accel"][1][REST].mean(axis=0)
    for least in (0.25, 0.8):
        R, *_ = on_the_van.solved(samples, J, math.radians(1.0), least)
        print(
            f"| claims 1, 3 to 6, batch, from {least} m/s2 | {on_the_van.yaw_off(R):+.2f} deg | |"
        )
    known = "estimator: published, speed_delay: -0.2"
    forms = {
        "published, to the letter": f"{{{known}, method_a: {{to_the_letter: true}}}}",
        "published": f"{{{known}}}",
        "joint": "{estimator: joint}",
    }
    for name, keys in forms.items():
        engine = make_engine(configured(keys))
        for chunk in LogReader([DATA / on_the_van.NAME / "drive.log.gz"], engine.router.matches):
            engine.columns(chunk, keep=False)
        estimate = engine.pipeline.estimator.estimate()
        R, std = estimate.R_vehicle_from_sensor, estimate.std
        assert R is not None
        assert std is not None
        off, stated = on_the_van.yaw_off(R), math.degrees(std[2])
        print(f"| {name} | {off:+.2f} deg | stated {stated:.2f}, {estimate.state.name.lower()} |")


def methods_b_and_c() -> None:
    print("\nB, C. Roll and pitch of the van against its INS, rms [deg]\n")
    samples = recording(on_the_van.NAME)
    for name, with_filter in (("B, claims 1 to 3", False), ("C, text, on B", True)):
        roll, pitch = on_the_van.rms_off(*on_the_van.tilted(samples, with_filter))
        print(f"| {name} | {roll:.2f} | {pitch:.2f} |")
    events, truth, _ = kingston()
    use = truth.t > 60.0

    def row(name: str, track: Track) -> None:
        off = (track.at(truth.t)[0] - truth.roll_pitch)[use]
        print(f"| {name} | {rms_degrees(off[:, 0]):.2f} | {rms_degrees(off[:, 1]):.2f} |")

    for name, rate_time in (("method: compensation", 0.0), ("the same, rate_time: 1.0", 1.0)):
        options: dict[str, Any] = {"delay": -on_the_van.SPEED_LEADS, "rate_time": rate_time}
        settings = AttitudeSettings(compensation=MotionCompensationSettings(**options))
        row(name, compensated(events, settings))
    loaded = load_config(MEASURED_DRIVES / "kingston_2008.yaml")
    row("method: filter", filtered(events, loaded.config.attitude)[0])
    print("\nB alone in a braking turn (-4 m/s2, 0.3 rad/s, level), largest roll by rate of speed:")
    for rate in (1.0, 5.0, 10.0, 20.0, 50.0):
        print(f"  {rate:4.0f} Hz  {braking_turn(rate):.2f} deg")


def main() -> int:
    if not is_here(on_the_van.NAME):
        return nothing_measured(on_the_van.NAME)
    print(f"numpy {np.__version__}")
    method_a()
    methods_b_and_c()
    return 0


if __name__ == "__main__":
    sys.exit(main())
