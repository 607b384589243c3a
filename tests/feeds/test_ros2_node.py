"""The example of a ROS 2 node, with stand-ins of ROS that know the fields of its messages."""

from __future__ import annotations

import importlib.util
import json
import math
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from feed_bench import AHEAD, calibrated, fed, source_of, traffic, wait_until
from imucald.feeds.feed_loop import Feed
from imucald.feeds.mqtt import MqttReceiver, MqttSettings
from mqtt_broker import MOSQUITTO, Broker
from paths import ROOT

typesys = pytest.importorskip("rosbags.typesys")
STORE = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


class Message:
    """A message with all fields at zero, which takes no other field, as those of rclpy."""

    def __init__(self, of: str) -> None:
        fields = {}
        for name, (kind, what) in STORE.fielddefs[of][1]:
            if kind.name == "NAME":
                fields[name] = Message(what)
            elif kind.name == "ARRAY":
                fields[name] = [0.0] * what[1]
            else:
                fields[name] = "" if what[0] == "string" else 0
        object.__setattr__(self, "of", of)
        self.__dict__.update(fields)

    def __setattr__(self, name: str, value: object) -> None:
        assert name in self.__dict__, f"{self.of} has no {name}"
        assert not isinstance(self.__dict__[name], list) or len(value) == 9
        object.__setattr__(self, name, value)


class Node:
    def __init__(self, name: str) -> None:
        self.published: list[Message] = []

    def declare_parameter(self, name: str, default: object) -> SimpleNamespace:
        return SimpleNamespace(value=PARAMETERS.get(name, default))

    def create_publisher(self, kind: object, topic: str, qos: object) -> SimpleNamespace:
        assert topic == "imu/data"
        return SimpleNamespace(publish=self.published.append)


PARAMETERS: dict[str, object] = {}


@pytest.fixture
def node(monkeypatch):
    transforms: list[Message] = []
    broadcaster = SimpleNamespace(sendTransform=transforms.append)
    stand_ins = {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "rclpy.qos": {"qos_profile_sensor_data": None},
        "geometry_msgs.msg": {
            "TransformStamped": lambda: Message("geometry_msgs/msg/TransformStamped")
        },
        "sensor_msgs.msg": {"Imu": lambda: Message("sensor_msgs/msg/Imu")},
        "tf2_ros": {"StaticTransformBroadcaster": lambda _: broadcaster},
    }
    for name, content in stand_ins.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location(
        "ros2_node", ROOT / "config/examples/ros2_node.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    PARAMETERS.clear()

    def made() -> tuple[Node, list[Message]]:
        return module.Imucald(), transforms

    return SimpleNamespace(made=made, module=module)


def status(quality: str = "fine", running: bool = True) -> dict:
    mount = {"plus_minus_deg": dict.fromkeys("xyz", 1.0), "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
    return {"at": 5.0, "running": running, "quality": quality, "mount": mount}


def vector(x: float | None, at: float = 10.25) -> dict:
    return {"x": x, "y": None if x is None else -2.0, "z": None if x is None else 9.81, "at": at}


def test_force_and_rate_of_one_time_are_one_message_with_covariance(node):
    one, transforms = node.made()
    one.take("acceleration", vector(1.0))
    assert not one.published, "how sure the mount is, is not known"
    one.take("status", status())
    one.take("angular_rate", vector(3.0, at=10.24))
    assert not one.published, "of another time"
    one.take("acceleration", vector(1.0))
    one.take("angular_rate", vector(3.0))
    (imu,) = one.published
    assert (imu.header.stamp.sec, imu.header.stamp.nanosec) == (10, 250_000_000)
    assert imu.header.frame_id == "vehicle"
    assert imu.linear_acceleration.y == -2.0
    assert imu.angular_velocity.x == pytest.approx(math.radians(3.0))
    assert imu.orientation_covariance[0] == -1.0
    turns = np.random.default_rng(1).normal(0.0, math.radians(0.5), (200_000, 3))
    expected = np.cov(np.cross(turns, [1.0, -2.0, 9.81]).T) + 0.05**2 * np.eye(3)
    found = np.reshape(imu.linear_acceleration_covariance, (3, 3))
    assert found == pytest.approx(expected, abs=1e-4)
    (mount,) = transforms
    assert (mount.header.frame_id, mount.child_frame_id) == ("vehicle", "sensor")
    one.take("status", status())
    assert len(transforms) == 1, "it has not changed"


def test_without_a_gyroscope_the_rate_is_marked_and_nothing_is_published_that_is_not_known(node):
    one, _ = node.made()
    one.take("status", status())
    one.take("acceleration", vector(1.0))
    (imu,) = one.published
    assert imu.angular_velocity_covariance[0] == -1.0
    one.take("acceleration", vector(None))
    for bad in (status("suspect"), status("not_available"), {"running": False, "at": 6.0}):
        one.take("status", bad)
        one.take("acceleration", vector(1.0))
    assert len(one.published) == 1


@pytest.mark.slow
@pytest.mark.skipif(MOSQUITTO is None, reason="not installed: mosquitto")
def test_it_publishes_what_the_feed_of_a_running_daemon_sends(tmp_path, node):
    (tmp_path / "mosquitto").mkdir()
    broker = Broker(tmp_path / "mosquitto")
    PARAMETERS.update(broker="127.0.0.1", port=broker.port, topic="car")
    one, transforms = node.made()
    said: list[str] = []
    try:
        with calibrated(tmp_path) as (_, service), traffic(service.link.channel):
            receiver = MqttReceiver(MqttSettings("127.0.0.1", broker.port, "car"), said.append)
            client = one.connect()
            with fed(Feed(source_of(service, said), receiver, 0.05, said.append)):
                wait_until(lambda: len(one.published) > 5 and transforms)
            client.disconnect()
            client.loop_stop()
            newest = one.published[-1].linear_acceleration
            assert (newest.x, newest.y, newest.z) == pytest.approx((AHEAD, 0.0, 9.81), abs=0.15)
            turn = transforms[-1].transform.rotation
            expected = service.status()["mount"]["quaternion_wxyz"]
            assert [turn.w, turn.x, turn.y, turn.z] == pytest.approx(expected, abs=0.01)
            assert json.dumps(one.mount_std)
    finally:
        broker.stop()
