"""`model:` in a configuration: live equals replay; state and reload belong to the model."""

from __future__ import annotations

import io
import itertools
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

import shuttle
from imucald import cli
from imucald.can.columns import CAN_EFF_FLAG
from imucald.can.logs.log_reader import LogReader
from imucald.can.python_can import can
from imucald.config import LoadedConfig
from imucald.core.errors import ConfigError
from imucald.mount.restored import RestoredEstimator
from imucald.runtime.session import make_engine, open_config
from imucald.service.journal import Journal
from imucald.service.live import Daemon, open_link
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service
from simulated_bus import CONFIG, drive, drive_frames

CHANNELS = itertools.count()
ACCEL = bytes.fromhex("0000000027130000")


def simulated(folder: Path, estimator: str = "published") -> LoadedConfig:
    """The simulated bus with the model of its drive, and more errors in it than the drive has."""
    text = CONFIG.read_text().replace("../../", f"{CONFIG.parent.parent.parent}/")
    more = {"mount.lever_arm_m": [1.2, 0.3, 0.4], "gyro.g_sensitivity": [0.001, 0.0, -0.001]}
    more |= {"accel.bias_temperature": [0.001, 0.002, 0.003], "speed.delay_s": 0.25}
    (folder / "car.yaml").write_text(drive().model.with_changes(more).to_yaml())
    (folder / "sim.yaml").write_text(
        f"{text}\ncalibration: {{estimator: {estimator}}}\nmodel: car.yaml\n"
    )
    return open_config(folder / "sim.yaml")


@pytest.mark.slow
def test_frames_on_a_virtual_bus_equal_those_of_replay_byte_for_byte(tmp_path):
    config = simulated(tmp_path)
    frames = drive_frames().take(slice(0, 24_000))
    engine = make_engine(config)
    expected = []
    for start, stop in ((0, 7001), (7001, 24_000)):
        out = engine.columns(frames.take(slice(start, stop)))
        expected += [(can_id, data) for _, can_id, data in out.rows()]

    live = make_engine(config)
    channel = f"model-{next(CHANNELS)}"
    link = open_link(config, live.router.matches, live.output.can_ids, "virtual", channel)
    daemon = Daemon(live, link, lambda: 0.0)  # a busy machine makes no frame late
    bus = can.Bus(interface="virtual", channel=channel, preserve_timestamps=True)
    got = []

    def collect():
        while (message := bus.recv(0.0)) is not None:
            got.append((message.arbitration_id, bytes(message.data)))

    for k, (t, can_id, data) in enumerate(frames.rows()):
        bus.send(
            can.Message(
                timestamp=t,
                arbitration_id=can_id & ~CAN_EFF_FLAG,
                is_extended_id=bool(can_id & CAN_EFF_FLAG),
                data=data,
            )
        )
        if k % 7 == 0:
            daemon.serve_once(0.0)
            collect()
    while daemon.serve_once(0.0):
        pass
    collect()
    link.close()
    bus.shutdown()
    assert got == expected
    assert live.pipeline.estimator.estimate().angles == engine.pipeline.estimator.estimate().angles
    plain = make_engine(open_config(CONFIG))
    without = [one[1:] for one in plain.columns(frames).rows()]
    assert without != expected, "the model does something"


@pytest.mark.slow
def test_the_full_estimator_gets_the_same_ticks_live_and_in_columns(tmp_path):
    config = simulated(tmp_path, "full")
    frames = drive_frames()
    by_columns, one_by_one = make_engine(config), make_engine(config)
    for start in range(0, len(frames), 20_000):
        by_columns.columns(frames.take(slice(start, start + 20_000)), keep=False)
    for t, can_id, data in frames.rows():
        one_by_one.frame(t, can_id, data)
    a, b = (e.pipeline.estimator.estimate() for e in (by_columns, one_by_one))
    assert a.R_vehicle_from_sensor is not None
    assert np.array_equal(a.R_vehicle_from_sensor, b.R_vehicle_from_sensor)
    assert np.array_equal(a.covariance, b.covariance)
    assert by_columns.sent == one_by_one.sent


# state and reload ----------------------------------------------------------------------------

MODEL = "accel: {bias: [0.05, 0, 0]}\n"


class Bench:
    """A folder with a drive and a model, and services on a virtual bus, one after the other."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.config = shuttle.write(folder, cycles=3)
        self.config.write_text(self.config.read_text() + "model: car.yaml\n")
        self.model(MODEL)
        self.log = io.StringIO()

    def model(self, text: str) -> None:
        (self.folder / "car.yaml").write_text(text)

    def service(self) -> Service:
        options = ServiceOptions(
            self.config,
            interface="virtual",
            channel=f"model-service-{next(CHANNELS)}",
            state_folder=self.folder / "state",
            save_period=0.0,
        )
        return Service(options, Journal(self.log))

    def drive(self, service: Service) -> None:
        for chunk in LogReader([self.folder / "shuttle.log"]):
            service.engine.columns(chunk, keep=False)


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def quality(service: Service, t: float = 1.7e9) -> int:
    out = service.engine.frame(t, 0x200, ACCEL)
    return next(data for can_id, data in out if can_id == 0x640)[6] & 0xF


def test_a_saved_state_is_used_with_the_model_that_it_was_found_with(bench):
    first = bench.service()
    bench.drive(first)
    first.close()
    again = bench.service()
    assert quality(again) == 1
    again.close()
    bench.model("accel: {bias: [0.3, 0, 0]}\n")
    other = bench.service()
    assert quality(other) == 0, "found with another model"
    other.close()
    bench.model(f"# the same, written otherwise\n{MODEL}route: {{kind: city}}\n")
    same = bench.service()
    assert quality(same) == 1
    same.close()


def test_a_changed_model_is_taken_on_reload_and_the_mount_goes_on_as_restored(bench):
    service = bench.service()
    bench.drive(service)
    yaw = service.status()["mount"]["yaw_deg"]
    before = service.engine.pipeline.estimator
    bench.model("accel: {bias: [0.3, 0, 0]}\nspeed: {scale: 0.01}\n")
    service.reload()
    engine = service.engine
    taken, _ = engine.preprocessing.frame(0.0, [("accel", (1.0, 0.0, 9.8))], Counter())
    assert taken == [("accel", (0.7, 0.0, 9.8))]
    assert engine.pipeline.estimator is not before
    assert isinstance(engine.pipeline.estimator, RestoredEstimator)
    assert engine.pipeline.quality == 1
    assert service.status()["mount"]["yaw_deg"] == pytest.approx(yaw, abs=1e-3)
    assert "corrects accel.bias, speed.scale" in bench.log.getvalue()
    bench.model(MODEL)
    service.reload()  # back to the model whose state was saved when it went
    assert service.engine.pipeline.quality == 1
    service.close()


def test_what_no_estimate_rests_on_leaves_the_estimator_alone(bench):
    service = bench.service()
    bench.drive(service)
    before = service.engine.pipeline.estimator
    bench.model(f"{MODEL}route: {{kind: city}}\n")
    service.reload()
    assert service.engine.pipeline.estimator is before
    bench.model(f"{MODEL}mount: {{lever_arm_m: [1, 0, 0]}}\n")
    service.reload()
    assert service.engine.pipeline.estimator is not before
    service.close()


def test_a_wrong_model_changes_nothing_on_reload_and_is_reported(bench):
    service = bench.service()
    engine = service.engine
    bench.model("accel: {bias: 3}\n")
    service.reload()
    assert service.engine is engine
    assert "car.yaml:1: accel.bias" in bench.log.getvalue()
    (bench.folder / "car.yaml").unlink()
    service.reload()
    assert service.engine is engine
    assert "there is no such file" in bench.log.getvalue()
    service.close()
    with pytest.raises(ConfigError, match=r"shuttle.yaml:\d+: model: .*car.yaml"):
        bench.service()


def test_the_start_says_what_is_used_and_what_is_not(bench):
    bench.model(f"{MODEL}gyro: {{bias_temperature: [0.001, 0, 0]}}\nwind: {{gusts: 1}}\n")
    service = bench.service()
    service.run(0.05)
    service.close()
    log = bench.log.getvalue()
    assert "corrects accel.bias" in log
    assert "gyro.bias_temperature: needs signals.temperature" in log
    assert "wind: this version does not know it" in log


def test_commands_tell_of_the_model(bench, capsys):
    bench.model(f"{MODEL}wind: {{gusts: 1}}\n")
    log, config = str(bench.folder / "shuttle.log"), str(bench.config)
    result = bench.folder / "result.json"
    assert cli.main(["replay", log, "--config", config, "--json", str(result)]) == 0
    assert "part of the model that is not used: wind" in capsys.readouterr().err
    found = json.loads(result.read_text())["model"]
    assert found["taken_out"] == ["accel.bias"]
    assert found["not_used"] == ["wind: this version does not know it; it is ignored"]
    cli.main(["check", log, "--config", config, "--json"])
    findings = json.loads(capsys.readouterr().out)["findings"]
    assert {"level": "note", "quantity": "model", "text": found["not_used"][0]} in findings


def test_the_long_form_and_the_switch(bench):
    bench.model("suspension: {roll_gradient: 0.01}\n")
    assert make_engine(open_config(bench.config)).preprocessing.vehicle is not None
    text = bench.config.read_text()
    bench.config.write_text(
        text.replace("car.yaml", "{path: car.yaml, compensate_suspension: false}")
    )
    preprocessing = make_engine(open_config(bench.config)).preprocessing
    assert preprocessing.vehicle is None
    assert preprocessing.ticks is not None, "the mount is found without the suspension all the same"
    assert any("compensate_suspension" in note for note in preprocessing.notes)
