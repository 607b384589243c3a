"""The MQTT feed against a real mosquitto."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from feed_bench import AHEAD, calibrated, fed, source_of, traffic, wait_until
from imucald.feeds.feed_loop import Feed
from imucald.feeds.mqtt import MqttReceiver, MqttSettings
from mqtt_broker import MOSQUITTO, Broker

pytestmark = pytest.mark.skipif(
    MOSQUITTO is None, reason="not installed: mosquitto (Debian's package of that name)"
)


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Broker]:
    folder = tmp_path / "mosquitto"
    folder.mkdir()
    made = Broker(folder)
    yield made
    made.stop()


@pytest.mark.slow
def test_status_and_corrected_values_arrive_and_are_null_when_the_sensor_is_silent(
    tmp_path, broker
):
    messages: list[str] = []
    with calibrated(tmp_path) as (_, service), traffic(service.link.channel) as silent:
        receiver = MqttReceiver(MqttSettings("127.0.0.1", broker.port, "car/imu"), messages.append)
        feed = Feed(source_of(service, messages), receiver, 0.1, messages.append)
        with broker.watched("car/imu") as heard, fed(feed):
            wait_until(lambda: '"x": null' not in heard.get("acceleration", '"x": null'))
            wait_until(lambda: {"angular_rate", "status", "online"} <= heard.keys())
            value = json.loads(heard["acceleration"])
            assert (value["x"], value["y"]) == pytest.approx((AHEAD, 0.0), abs=0.15)
            assert (value["unit"], value["quality"]) in {("m/s2", "usable"), ("m/s2", "fine")}
            assert json.loads(heard["angular_rate"])["x"] is None
            status = json.loads(heard["status"])
            assert status["running"]
            assert status["held"]
            truth = service.status()["mount"]
            assert status["mount"]["yaw_deg"] == pytest.approx(truth["yaw_deg"], abs=0.01)
            expected = 2.0 * truth["std_deg"]["z"]
            assert status["mount"]["plus_minus_deg"]["z"] == pytest.approx(expected, abs=0.01)
            of_yaw = status["mount"]["angle_plus_minus_deg"]["yaw"]
            assert of_yaw == pytest.approx(2.0 * truth["angle_std_deg"]["yaw"], abs=0.01)
            assert heard["online"] == "1"
            silent.set()
            wait_until(lambda: json.loads(heard["acceleration"])["x"] is None)
            assert json.loads(heard["acceleration"])["quality"] == "not_available"
            wait_until(lambda: "accelerometer_missing" in json.loads(heard["status"])["alarms"])
        with broker.watched("car/imu") as later:
            wait_until(lambda: "status" in later)
            assert later["online"] == "0", "it took leave"
            assert "acceleration" not in later, "values are not retained"


@pytest.mark.slow
def test_a_broker_that_comes_late_or_goes_is_waited_for(tmp_path, broker):
    broker.stop()
    messages: list[str] = []
    with calibrated(tmp_path) as (_, service), traffic(service.link.channel):
        receiver = MqttReceiver(MqttSettings("127.0.0.1", broker.port, "car"), messages.append)
        with fed(Feed(source_of(service, messages), receiver, 0.1, messages.append)):
            wait_until(lambda: any("cannot be reached" in text for text in messages))
            for _ in range(2):
                broker.start()
                with broker.watched("car") as heard:
                    wait_until(lambda heard=heard: "acceleration" in heard, 20.0)
                    assert heard["online"] == "1"
                broker.stop()
            wait_until(lambda: any("has closed the connection" in text for text in messages))
    broker.start()


@pytest.mark.slow
def test_the_last_will_says_that_a_killed_feed_is_gone(tmp_path, broker):
    with calibrated(tmp_path) as (_, service):
        path = str(service.options.status_socket)
        command = [sys.executable, "-m", "imucald", "feed", "mqtt", "--socket", path]
        command += ["--broker", f"127.0.0.1:{broker.port}", "--topic", "car", "--status-only"]
        feed = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        with broker.watched("car") as heard:
            wait_until(lambda: heard.get("online") == "1" and "status" in heard, 20.0)
            feed.send_signal(signal.SIGKILL)
            wait_until(lambda: heard["online"] == "0")
            feed.communicate()
            orderly = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
            wait_until(lambda: heard.get("online") == "1", 20.0)
            orderly.send_signal(signal.SIGTERM)
            assert orderly.wait(5.0) == 0
            wait_until(lambda: heard["online"] == "0")
            output = orderly.communicate()[1]
    assert f"MQTT broker 127.0.0.1:{broker.port} takes car/#" in output


@pytest.mark.slow
def test_a_daemon_that_ends_is_reported_and_its_values_are_not_available(tmp_path, broker):
    messages: list[str] = []
    with calibrated(tmp_path) as (_, service), broker.watched("car") as heard:
        receiver = MqttReceiver(MqttSettings("127.0.0.1", broker.port, "car"), messages.append)
        with fed(Feed(source_of(service, messages), receiver, 0.1, messages.append)):
            wait_until(lambda: "status" in heard)
            service.stop()
            assert service.sockets.status is not None
            service.sockets.status.path.unlink()
            wait_until(lambda: not json.loads(heard["status"])["running"])
            assert json.loads(heard["acceleration"])["quality"] == "not_available"


@pytest.mark.slow
def test_a_wrong_password_is_reported_and_a_right_one_is_taken(tmp_path, monkeypatch):
    folder = tmp_path / "mosquitto"
    folder.mkdir()
    passwords = folder / "passwords"
    tool = shutil.which("mosquitto_passwd")
    assert tool is not None
    subprocess.run([tool, "-b", "-c", str(passwords), "car", "right"], check=True)
    os.chmod(passwords, 0o644)  # noqa: PTH101
    broker = Broker(folder, f"allow_anonymous false\npassword_file {passwords}\n")
    messages: list[str] = []
    try:
        for password in ("wrong", "right"):
            monkeypatch.setenv("IMUCALD_MQTT_PASSWORD", password)
            settings = MqttSettings("127.0.0.1", broker.port, "car", user="car")
            receiver = MqttReceiver(settings, messages.append)
            receiver.connect()
            expected = {"wrong": "refuses the connection", "right": "takes car/#"}[password]
            wait_until(lambda expected=expected: any(expected in text for text in messages))
            receiver.close()
    finally:
        broker.stop()
