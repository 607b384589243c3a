"""A vehicle's signal that is stuck is left out, and reported wherever faulty sensors are."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from msgspec.structs import asdict

from imucald.config import Config
from imucald.config_check.health import LogHealth, health_findings
from imucald.core.samples import Samples, Series
from imucald.motion.sample_health import SampleHealth
from imucald.mount.estimate import MountState
from imucald.mount.estimator import JointEstimator
from imucald.runtime.flow import alarms_of
from imucald.runtime.input_health import LinkHealth, health_at
from imucald.runtime.pipeline import Pipeline, Snapshot
from imucald.simulation import random_model, simulate
from imucald.uds.dtc import FAULTY
from simulated_bus import loaded

SEED, MINUTES = 520_400, 7.0
FROM_S, UNTIL_S = 200.0, 300.0
AXES = {"accel": 3, "gyro": 3}
ALARMS = {"speed": "speed faulty", "yaw_rate": "yaw rate faulty"}


@cache
def sound() -> Samples:
    return simulate(random_model(SEED), SEED, MINUTES).samples


def stuck(channel: str) -> Samples:
    """The drive with a channel that keeps its value for a time; a speed says zero."""
    series = sound()[channel]
    values = series.values.copy()
    first, stop = np.searchsorted(series.t, [FROM_S, UNTIL_S])
    values[first:stop] = 0.0 if channel == "speed" else values[first]
    return {**sound(), channel: Series(series.t, values)}


def taken(samples: Samples) -> tuple[Pipeline, list[Snapshot]]:
    pipeline = Pipeline(JointEstimator(), health=SampleHealth(AXES))
    _, snapshots = pipeline.run(samples, {}, 60.0 * MINUTES)
    return pipeline, snapshots


@pytest.mark.parametrize("channel", ALARMS)
def test_a_stuck_signal_is_reported_for_as_long_as_it_lasts(channel: str) -> None:
    pipeline, snapshots = taken(stuck(channel))
    summary = pipeline.health.summary()
    (event,) = summary["events"]
    assert (event["sensor"], event["fault"], event["axes"]) == (channel, "stuck", "")
    assert FROM_S < event["since_s"] < FROM_S + 60.0
    assert UNTIL_S < event["until_s"] < UNTIL_S + 25.0
    assert summary["sensors"][channel] == {}, "it is over"
    reported = {s.t for s in snapshots if channel in s.faults}
    expected = {s.t for s in snapshots if event["since_s"] <= s.t < event["until_s"]}
    assert reported == expected
    faulty = next(s for s in snapshots if channel in s.faults)
    health = health_at(faulty.k, {}, False, 0, LinkHealth(), faulty.faults)
    assert list(alarms_of(asdict(health)).values()) == [ALARMS[channel]]
    assert health.flags[-1]
    assert set(map(str, faulty.faults[channel])) == set(FAULTY[channel])


@pytest.mark.parametrize("channel", ALARMS)
def test_live_and_by_columns_a_stuck_signal_is_reported_equally(channel: str) -> None:
    whole, _ = taken(stuck(channel))
    parts = Pipeline(JointEstimator(), health=SampleHealth(AXES))
    for low in np.arange(0.0, 60.0 * MINUTES, 7.3):
        piece = {}
        for name, series in stuck(channel).items():
            use = (series.t >= low) & (series.t < low + 7.3)
            piece[name] = Series(series.t[use], series.values[use])
        parts.run(piece, {}, min(low + 7.299, 60.0 * MINUTES))
    assert parts.health.summary() == whole.health.summary()


def test_a_speed_that_repeats_itself_is_left_out_but_not_accused() -> None:
    """As a coarse one does at a steady cruise."""
    series = sound()["speed"]
    first, stop = np.searchsorted(series.t, [FROM_S, UNTIL_S])
    values = series.values.copy()
    values[first:stop] = values[first]
    pipeline, snapshots = taken({**sound(), "speed": Series(series.t, values)})
    assert pipeline.health.summary()["events"] == []
    assert not any(s.faults for s in snapshots)
    left_out = pipeline.estimator.estimate().details["frozen_ticks"]["speed"]["stuck"]
    assert left_out > 100


@pytest.mark.slow
@pytest.mark.parametrize("is_lost", [False, True])
def test_a_speed_that_is_zero_or_lost_in_the_drive_costs_the_mount_nothing(is_lost: bool) -> None:
    """Without wheel speeds only the force contradicts the zero. Taken as true it was a sensor that
    was tilted, and later an accelerometer whose zero drifts; a smooth cruise was a rest."""
    samples = {name: s for name, s in stuck("speed").items() if name != "wheel_speeds"}
    if is_lost:
        t, values = samples["speed"].t, samples["speed"].values
        known = (t < FROM_S) | (t >= UNTIL_S)
        samples["speed"] = Series(t[known], values[known])
    pipeline = Pipeline(JointEstimator())
    _, snapshots = pipeline.run(samples, {}, 60.0 * MINUTES)
    states = {s.estimate.state for s in snapshots if s.t > FROM_S}
    assert states <= {MountState.USABLE, MountState.FINE}
    details = pipeline.estimator.estimate().details
    assert not details.get("faults")
    (lost,) = (one for one in details["not_learnt_from"] if one["signal"] == "speed")
    assert lost["cause"] == ("no valid samples" if is_lost else "stuck")
    assert lost["seconds"] == pytest.approx(UNTIL_S - FROM_S, abs=3.0)


def test_nothing_is_reported_of_a_sound_drive() -> None:
    pipeline, snapshots = taken(sound())
    assert pipeline.health.summary() == {
        "sensors": {"accel": {}, "gyro": {}, "speed": {}, "yaw_rate": {}},
        "events": [],
    }
    assert not any(s.faults for s in snapshots)


@pytest.mark.parametrize("channel", ALARMS)
def test_check_names_a_stuck_signal(channel: str) -> None:
    config: Config = loaded().config
    health = LogHealth(AXES, config)
    health.add_samples(stuck(channel), 60.0 * MINUTES)
    (finding,) = health_findings(health.events)
    assert (finding.level, finding.quantity) == ("warning", channel)
    assert finding.text.startswith("repeats one value (stuck, from ")
    assert "frames" not in finding.text
