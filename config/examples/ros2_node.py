#!/usr/bin/env python3
"""A ROS 2 node that publishes what `imucald feed mqtt` sends: imu/data, the mount on /tf_static.

    imucald feed mqtt can0 --topic imucald/can0 --rate 100            # on the gateway
    sudo apt install python3-paho-mqtt                                # next to ROS 2; no imucald
    python3 ros2_node.py --ros-args -p broker:=gateway -p topic:=imucald/can0

The axes of imucald (ISO 8855) are those of base_link (REP 103): `-p vehicle:=base_link` names the
frame so. A covariance is what the mount's error turns the vector by, and the noise that the two
parameters state; a quantity that is not available is marked by -1, as sensor_msgs/Imu says.
"""

import json
import math

import paho.mqtt.client as mqtt
import rclpy
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu
from tf2_ros import StaticTransformBroadcaster

NOT_MEASURED = [-1.0] + [0.0] * 8
GOOD = ("restored", "usable", "fine")


def covariance(vector, mount_std, noise):
    """Of a vector turned about x, y, z with these standard deviations [rad], and its own noise."""
    x, y, z = vector
    turned = (0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)  # by a small turn about each axis
    return [
        sum(s * s * of[row] * of[column] for s, of in zip(mount_std, turned, strict=True))
        + (noise * noise if row == column else 0.0)
        for row in range(3)
        for column in range(3)
    ]


class Imucald(Node):
    """Takes messages of the feed; `take` is the door for those who have them otherwise."""

    def __init__(self):
        super().__init__("imucald")

        def parameter(name, default):
            return self.declare_parameter(name, default).value

        self.vehicle, self.sensor = parameter("vehicle", "vehicle"), parameter("sensor", "sensor")
        self.noise = parameter("acceleration_std", 0.05), parameter("angular_rate_std", 0.005)
        self.broker, self.port = parameter("broker", "localhost"), parameter("port", 1883)
        self.topic = parameter("topic", "imucald/can0")
        self.imu = self.create_publisher(Imu, "imu/data", qos_profile_sensor_data)
        self.transforms = StaticTransformBroadcaster(self)
        self.mount_std = None
        self.sent_mount = None
        self.acceleration = None
        self.has_rate = False

    def connect(self):
        """Take what the broker sends, in a thread of the library's."""
        versions = getattr(mqtt, "CallbackAPIVersion", None)  # paho-mqtt 1 has none
        client = mqtt.Client(*([] if versions is None else [versions.VERSION2]))
        client.on_connect = lambda client, *_: client.subscribe(f"{self.topic}/#")
        client.on_message = lambda _, __, message: self.take(
            message.topic.rpartition("/")[2], json.loads(message.payload)
        )
        client.connect_async(self.broker, self.port)
        client.loop_start()
        return client

    def take(self, name, content):
        """Take one message of the feed by the last part of its topic."""
        if name == "status":
            self.take_status(content)
        elif name == "acceleration":
            self.acceleration = content
            if not self.has_rate:  # else the rate of the same time comes next
                self.publish(content, None)
        elif name == "angular_rate":
            self.has_rate = True
            if self.acceleration and self.acceleration["at"] == content["at"]:
                self.publish(self.acceleration, content)

    def take_status(self, status):
        """Keep how sure the mount is, and publish it where it has changed."""
        if not status["running"] or status["quality"] not in GOOD:
            self.mount_std = None
            return
        mount = status["mount"]
        halves = mount["plus_minus_deg"]  # 95 %: two standard deviations
        self.mount_std = [math.radians(halves[axis] or 0.0) / 2.0 for axis in "xyz"]
        if mount["quaternion_wxyz"] != self.sent_mount:
            self.sent_mount = mount["quaternion_wxyz"]
            self.publish_mount(status["at"])

    def publish_mount(self, at):
        """Publish the mount as a static transform."""
        message = TransformStamped()
        message.header.stamp.sec, message.header.stamp.nanosec = stamp(at)
        message.header.frame_id, message.child_frame_id = self.vehicle, self.sensor
        turn = message.transform.rotation
        turn.w, turn.x, turn.y, turn.z = self.sent_mount
        self.transforms.sendTransform(message)

    def publish(self, acceleration, rate):
        """Publish corrected values of one time; rate: None where there is no gyroscope."""
        if acceleration["x"] is None or self.mount_std is None:
            return
        message = Imu()
        message.header.stamp.sec, message.header.stamp.nanosec = stamp(acceleration["at"])
        message.header.frame_id = self.vehicle
        message.orientation_covariance = NOT_MEASURED
        vector = [acceleration[axis] for axis in "xyz"]
        to = message.linear_acceleration
        to.x, to.y, to.z = vector
        message.linear_acceleration_covariance = covariance(vector, self.mount_std, self.noise[0])
        if rate is None or rate["x"] is None:
            message.angular_velocity_covariance = NOT_MEASURED
        else:
            vector = [math.radians(rate[axis]) for axis in "xyz"]
            to = message.angular_velocity
            to.x, to.y, to.z = vector
            message.angular_velocity_covariance = covariance(vector, self.mount_std, self.noise[1])
        self.imu.publish(message)


def stamp(at):
    """Seconds since 1970 as whole seconds and nanoseconds."""
    seconds, milliseconds = divmod(round(at * 1000.0), 1000)  # the feed rounds so
    return seconds, milliseconds * 1_000_000


def main():
    """Run until Ctrl-C."""
    rclpy.init()
    node = Imucald()
    client = node.connect()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        client.loop_stop()
        node.destroy_node()


if __name__ == "__main__":
    main()
