"""The sensor check (method C) is kept over drives and repeated on command."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from engine_bus import load
from imucald.attitude.sensor_check import CheckResult
from imucald.core.rotations import rotation_from_angles
from imucald.mount.estimate import Correction, MountEstimate, MountState
from imucald.runtime.consumers import AttitudeConsumer, consumers_for
from imucald.runtime.output.output_frames import OutputFrames
from imucald.runtime.session import make_engine
from imucald.service.calibration_store import CalibrationStore
from imucald.service.saved_state import StateKey, StateStore

G = 9.80665
CAR = """
database: bus.dbc
signals:
  accelerometer: {x: ACC.X, y: ACC.Y, z: ACC.Z}
  gyroscope: {x: GYR.GX, y: GYR.GY, z: GYR.GZ}
  speed: SPD.V
attitude: {enabled: true, method: METHOD}
"""
DBC = """VERSION ""
NS_ :
BS_:
BU_: IMU

BO_ 512 ACC: 6 IMU
 SG_ X : 0|16@1- (0.002,0) [0|0] "m/s^2" IMU
 SG_ Y : 16|16@1- (0.002,0) [0|0] "m/s^2" IMU
 SG_ Z : 32|16@1- (0.002,0) [0|0] "m/s^2" IMU

BO_ 513 GYR: 6 IMU
 SG_ GX : 0|16@1- (0.01,0) [0|0] "deg/s" IMU
 SG_ GY : 16|16@1- (0.01,0) [0|0] "deg/s" IMU
 SG_ GZ : 32|16@1- (0.01,0) [0|0] "deg/s" IMU

BO_ 514 SPD: 2 IMU
 SG_ V : 0|16@1+ (0.01,0) [0|0] "m/s" IMU
"""
MOUNT = rotation_from_angles(0.3, -0.5, 2.0)
OTHER = rotation_from_angles(0.31, -0.5, 2.02)
ERROR = np.array([0.004, -0.007, 0.002])
"""Of the gyroscope, sensor axes [rad/s]."""


def consumer_of(tmp_path: Path, method: str) -> AttitudeConsumer:
    loaded = load(CAR.replace("METHOD", method), tmp_path, DBC)
    (consumer,) = consumers_for(loaded, OutputFrames(loaded.config))
    assert isinstance(consumer, AttitudeConsumer)
    return consumer


def stand(consumer: AttitudeConsumer, t: float, seconds: float, mount: np.ndarray,
          error: np.ndarray = ERROR) -> float:  # fmt: skip
    """At rest, samples in sensor axes under a known mount."""
    correction = Correction.turning(mount)
    rng = np.random.default_rng(int(t))
    for k in range(round(seconds * 20.0)):
        now = t + 0.05 * k
        if k % 4 == 0:
            consumer.sample(now, "speed", (0.0,), correction)
        w, f = error + rng.normal(0, 1e-4, 3), mount.T @ [0.0, 0.0, G] + rng.normal(0, 0.01, 3)
        consumer.sample(now, "gyro", w.tolist(), correction)
        consumer.sample(now, "accel", f.tolist(), correction)
    return t + seconds


@pytest.mark.parametrize("method", ["filter", "compensation"])
def test_the_check_of_one_drive_serves_the_next_in_sensor_axes(tmp_path, method):
    first = consumer_of(tmp_path, method)
    assert first.saved_check() is None
    stand(first, 0.0, 45.0, MOUNT)
    saved = first.saved_check()
    assert saved is not None
    assert saved["rate"] == pytest.approx(ERROR.tolist(), abs=1e-4)
    second = consumer_of(tmp_path, method)
    second.restore_check(saved)
    assert not second.checked
    assert second.saved_check() == saved  # before the mount is known it is kept as it was
    stand(second, 0.0, 0.5, OTHER)  # the mount is known a little otherwise now
    assert second.checked
    again = second.saved_check()
    assert again is not None
    assert again["rate"] == pytest.approx(saved["rate"], abs=1e-9)


@pytest.mark.parametrize("method", ["filter", "compensation"])
def test_on_command_it_is_repeated(tmp_path, method):
    consumer = consumer_of(tmp_path, method)
    t = stand(consumer, 0.0, 45.0, MOUNT)
    consumer.check_sensors()
    assert not consumer.checked
    stand(consumer, t, 45.0, MOUNT, 2.0 * ERROR)
    assert consumer.checked
    saved = consumer.saved_check()
    assert saved is not None
    assert saved["rate"] == pytest.approx((2.0 * ERROR).tolist(), abs=2e-4)


@pytest.mark.parametrize(
    "saved",
    [None, 7, {}, {"rate": [0, 0, 0]}, {"rate": [0, 0], "force": [0, 0, 0]},
     {"rate": [9.0, 0, 0], "force": [0, 0, 0]}, {"rate": ["a", 0, 0], "force": [0, 0, 0]},
     {"rate": [math.nan, 0, 0], "force": [0, 0, 0]}, {"rate": "abc", "force": "abc"}],
)  # fmt: skip
def test_what_cannot_be_a_check_is_not_taken(tmp_path, saved):
    assert CheckResult.from_saved(saved) is None
    consumer = consumer_of(tmp_path, "filter")
    consumer.restore_check(saved)
    stand(consumer, 0.0, 0.5, MOUNT)
    assert not consumer.checked


class Known:
    """An estimator that knows the mount."""

    state = MountState.FINE
    correction = Correction.turning(MOUNT)

    def estimate(self):
        return MountEstimate(self.state, MOUNT, 1e-6 * np.eye(3))


def test_it_is_saved_with_the_mount_and_alone_is_reason_to_save(tmp_path):
    store = StateStore(tmp_path, StateKey("car", "sensor"))
    kept = CalibrationStore(store, lambda *_: None, period=0.0)
    check = {"rate": [0.001, 0.002, 0.003], "force": [0.0, 0.0, 0.1]}
    kept.update(Known(), 10.0)
    kept.writer.flush(5.0)
    before = store.generation
    kept.sensor_check = lambda: check
    kept.update(Known(), 20.0)
    kept.close(Known(), 20.0)
    assert store.generation > before
    later = CalibrationStore(StateStore(tmp_path, StateKey("car", "sensor")), lambda *_: None)
    later.restore(Known())
    assert later.saved_check == check


STATED = """
calibration:
  mount: {roll_deg: 1.0, pitch_deg: -2.0, yaw_deg: 30.0, std_deg: 0.5, hold: HOLD}
"""
CHECK = {"rate": [0.001, 0.002, 0.003], "force": [0.0, 0.0, 0.1]}


def store_in(folder: Path) -> CalibrationStore:
    return CalibrationStore(StateStore(folder, StateKey("car", "sensor")), lambda *_: None)


@pytest.mark.parametrize("hold", ["false", "true"])
def test_it_is_saved_with_a_stated_mount_that_no_drive_has_confirmed(tmp_path, hold):
    text = CAR.replace("METHOD", "filter") + STATED.replace("HOLD", hold)
    estimator = make_engine(load(text, tmp_path, DBC)).pipeline.estimator
    first = store_in(tmp_path / "state")
    first.restore(estimator)
    first.update(estimator, 10.0)
    assert first.saved_check is None
    first.sensor_check = lambda: CHECK
    first.update(estimator, 50.0)
    first.writer.flush(5.0)
    generation = first.store.generation
    assert generation > 0
    first.update(estimator, 100.0)  # a vehicle that stands wears out no memory
    first.close(estimator, 200.0)
    assert first.store.generation == generation
    second = store_in(tmp_path / "state")
    again = second.restore(make_engine(load(text, tmp_path, DBC)).pipeline.estimator)
    assert second.saved_check == CHECK
    assert again.state is estimator.state
    assert again.correction.rotation == pytest.approx(estimator.correction.rotation)
    third = store_in(tmp_path / "state")
    third.restore(again)
    third.sensor_check = lambda: {**CHECK, "rate": [0.002, 0.002, 0.003]}
    third.close(again, 20.0)
    fourth = store_in(tmp_path / "state")
    fourth.restore(again)
    assert fourth.saved_check == third.sensor_check()


class Doubted(Known):
    state = MountState.SUSPECT


def test_it_is_saved_beside_a_doubted_mount(tmp_path):
    kept = store_in(tmp_path)
    kept.update(Known(), 10.0)
    kept.update(Doubted(), 20.0)
    kept.sensor_check = lambda: CHECK
    kept.close(Doubted(), 30.0)
    later = store_in(tmp_path)
    later.restore(Known())
    assert later.saved_check == CHECK
