"""Measured drives as other sound sensors would have recorded them: no alarm of any kind."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from benchmarks.integrity.bases import recorded
from benchmarks.integrity.bus import configuration, frames
from benchmarks.measured import is_here

from imucald.core.samples import Samples
from imucald.motion.sample_health import SampleHealth
from imucald.motion.ticks import TICK_RATE
from imucald.mount.estimate import MountState
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.session import make_engine
from sound_signals import KINDS, recorded_by

pytestmark = pytest.mark.slow

LOGS = (
    "css_canmod_164", "kingston_2008", "vehsense_2018_08_04", "vehsense_2017_10_23_2245",
    "vehsense_2017_10_25_1829", "quat_orient_21", "mustang_s550", "neu_circles",
    "second_world/01_none",
)  # fmt: skip
"""Two of them creep in their holder, which is no fault of a sensor."""
STAYS = ("css_canmod_164", "kingston_2008", "vehsense_2018_08_04")
"""Measured, and the mount stays."""
UNSURE = ("css_canmod_164",)
"""Its steps (0.125 m/s^2, 0.25 deg/s) leave yaw hardly usable: a coarser or slower one loses it."""
ENOUGH_S = {"css_canmod_164": 1200.0}
"""Half of the log: a sensor that was accused here once was so after 301 and after 683 s."""
NOT_YET = {
    ("kingston_2008", "a sensor 5 times slower"): "gravity seems to step beside 2 Hz",
    ("kingston_2008", "10 times the gyroscope's noise"): "gravity steps: the walk is not known",
}
"""What is taken back all the same; the sensor of kingston_2008 sends 10 times a second."""
TAKEN_BACK = frozenset({MountState.SUSPECT, MountState.RECALIBRATING})
CHUNK_S = 60.0


@cache
def samples_of(log: str) -> Samples:
    if not is_here(log):
        pytest.skip(f"the measured drive {log} is not here")
    return recorded(log)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("log", LOGS)
def test_no_sound_sensor_is_called_faulty(log: str, kind: str) -> None:
    samples = recorded_by(kind, samples_of(log))
    health = SampleHealth({c: 3 for c in ("accel", "gyro") if c in samples})
    health.columns(samples, 0, int(TICK_RATE * max(s.t[-1] for s in samples.values())))
    assert not [(e.channel, str(e.fault), e.axes, e.since) for e in health.events]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("log", STAYS)
def test_no_sound_sensor_contradicts_its_vehicle_or_seems_to_move(
    request: pytest.FixtureRequest, log: str, kind: str
) -> None:
    if reason := NOT_YET.get((log, kind)):
        request.applymarker(pytest.mark.xfail(reason=reason, strict=True))
    samples = recorded_by(kind, samples_of(log))
    last = min(max(float(s.t[-1]) for s in samples.values()), ENOUGH_S.get(log, np.inf))
    loaded = configuration(frozenset(samples), cycles=False)
    bus = frames(samples, last, loaded, None, 0)
    found: list[Snapshot] = []
    engine = make_engine(loaded, found.append)
    edges = np.searchsorted(bus.t, np.arange(0.0, last + CHUNK_S, CHUNK_S))
    for first, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        engine.columns(bus.take(slice(first, stop)), keep=False)
    assert not {fault for one in found for fault in one.estimate.faults}
    assert log in UNSURE or not [o.t for o in found if o.estimate.state in TAKEN_BACK]
    assert not {"too_fast", "duplicate_sender"} & set(engine.router.rejected)
