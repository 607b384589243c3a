"""A whole configuration is found on buses whose names tell nothing, and says what is not sure."""

from __future__ import annotations

import re
import threading
from pathlib import Path

import numpy as np
import pytest
from benchmarks.init.judge import judge
from benchmarks.init.obfuscated import write_bus

from imucald import cli
from imucald.can.columns import FrameColumns
from imucald.can.dbc.database import load_database, load_database_text
from imucald.can.logs.log_reader import LogReader
from imucald.can.python_can import can
from imucald.config import load_config, parse_config
from imucald.discovery import GatheredFrames, Proposal, as_yaml, discover
from imucald.discovery.candidates import candidates_of, messages_in, silent_candidates
from imucald.discovery.discover import free_output_ids
from imucald.discovery.names import axes_by_name, wheel_by_name
from paths import ROOT, SHARED_DATA

EXAMPLE = ROOT / "dbc" / "imucald_example.dbc"


def proposed(database: Path, *logs: Path) -> Proposal:
    """What is proposed for a log."""
    frames = GatheredFrames.of(LogReader(list(logs))) if logs else GatheredFrames()
    return discover({str(database): load_database([database])}, frames)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [201, 202])
def test_a_bus_without_names_is_found_and_nothing_is_wrong_but_marked(tmp_path, seed):
    database, log, truth = write_bus(seed, tmp_path, 8.0)
    proposal = proposed(database, log)
    out = tmp_path / "car.yaml"
    out.write_text(as_yaml(proposal, [str(database)]))
    verdict = judge(proposal, out, truth, {}, fixed=False, unseen=frozenset({"reverse"}))
    assert not verdict.wrong
    assert verdict.found >= verdict.asked - 1
    protections = {p.message: dict(p.settings) for p in proposal.protections}
    for name, expected in load_config(truth).config.messages.items():
        assert ("checksum" in protections[name]) == (expected.checksum is not None)


@pytest.fixture(scope="module")
def drive(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("drive")
    log = folder / "drive.log"
    assert cli.main(["simulate", "--out", str(log), "--minutes", "4", "--seed", "6"]) == 0
    return log


def test_a_level_sensor_has_both_axes_in_one_message(drive, tmp_path):
    """Its lateral axis lost its unit: the sensor's own, of another message, does not stand in."""
    text = EXAMPLE.read_text().replace("(0.002,0) [-39.2", "(0.004,0) [-39.2")
    line = next(x for x in text.splitlines() if "SG_ LateralAccel" in x)
    text = text.replace(line, line.replace('"m/s^2"', '"Nm"').replace('"g"', '"Nm"'))
    database = tmp_path / "car.dbc"
    database.write_text(text)
    accelerometer = proposed(database, drive).choice("accelerometer")
    assert accelerometer is not None
    assert len({s.signal.partition(".")[0] for s in accelerometer.sources.values()}) == 1


@pytest.mark.parametrize("has_other", [True, False], ids=["beside another", "alone"])
@pytest.mark.parametrize("scale", [0.004, 0.0006])
def test_a_wrong_scale_in_the_database_is_named(scale, has_other, drive, tmp_path, capsys):
    text = EXAMPLE.read_text().replace("(0.002,0) [-39.2", f"({scale},0) [-39.2")
    if not has_other:
        text = "".join(x for x in text.splitlines(True) if "LongitudinalAccel" not in x)
    database = tmp_path / "car.dbc"
    database.write_text(text)
    accelerometer = proposed(database, drive).choice("accelerometer")
    assert accelerometer is not None
    assert "IMU_Accel.AccelX, AccelY, AccelZ keep a size" in accelerometer.doubt
    (times,) = re.findall(r"that is ([\d.]+) times", accelerometer.doubt)
    assert float(times) == pytest.approx(scale / 0.002, rel=0.03)
    out = tmp_path / "car.yaml"
    assert cli.main(["init", "--database", str(database), str(drive), "--out", str(out)]) == 0
    printed = capsys.readouterr().err
    assert "with a scale in the database" in printed
    assert printed.strip().endswith(f"next: imucald check --config {out} {drive}")


def test_the_example_bus_is_found_and_check_accepts_it(drive, tmp_path, capsys):
    out = tmp_path / "car.yaml"
    assert cli.main(["init", "--database", str(EXAMPLE), str(drive), "--out", str(out)]) == 0
    assert "quantities" in capsys.readouterr().err
    signals = load_config(out).config.signals
    assert signals.gyroscope is not None
    assert signals.gyroscope[0].z is not None
    assert signals.gyroscope[0].z.signal == "IMU_Gyro.RateZ"
    assert signals.speed is not None
    assert signals.speed[0].signal == "ESC_Speed.VehicleSpeed"
    assert load_config(out).config.messages["IMU_Accel"].checksum.id_bytes == 2
    assert cli.main(["check", "--config", str(out), str(drive)]) == 0


def test_signals_that_turn_the_other_way_get_their_sign(drive, tmp_path):
    """The database is rewritten: what is positive to the left becomes positive to the right."""
    text = EXAMPLE.read_text()
    for name, scale in (
        ("YawRate", "0.01"),
        ("RateX", "0.01"),
        ("RateY", "0.01"),
        ("RateZ", "0.01"),
    ):
        old = next(line for line in text.splitlines() if f"SG_ {name} :" in line)
        text = text.replace(old, old.replace(f"({scale},0)", f"(-{scale},0)"))
    other = tmp_path / "other.dbc"
    other.write_text(text)
    proposal = proposed(other, drive)
    for quantity in ("yaw_rate", "gyroscope"):
        choice = proposal.choice(quantity)
        assert choice is not None
        assert {s.sign for s in choice.sources.values()} == {-1}, quantity
    lateral = proposal.choice("lateral_acceleration")
    assert lateral is not None
    assert lateral.sources[""].sign == 1


def test_a_unit_that_the_database_lacks_or_has_wrong_is_found(drive, tmp_path):
    text = EXAMPLE.read_text()
    text = text.replace('(0.002,0) [-39.2|39.2] "m/s^2"', '(0.002,0) [-39.2|39.2] ""')
    text = text.replace('"km/h" ESC', '"km/h" GATEWAY').replace(
        'VehicleSpeed : 0|16@1+ (0.01,0) [0|400] "km/h"',
        'VehicleSpeed : 0|16@1+ (0.01,0) [0|400] ""',
    )
    other = tmp_path / "other.dbc"
    other.write_text(text)
    proposal = proposed(other, drive)
    accelerometer, speed = proposal.choice("accelerometer"), proposal.choice("speed")
    assert accelerometer is not None
    assert {s.unit for s in accelerometer.sources.values()} == {"m/s^2"}
    assert speed is not None
    assert speed.sources[""].unit == "km/h"


def test_without_a_recording_everything_is_unsure():
    proposal = proposed(EXAMPLE)
    found = {choice.quantity for choice in proposal.choices}
    assert {"accelerometer", "gyroscope", "speed", "wheel_speeds", "yaw_rate"} <= found
    assert not any(choice.is_sure for choice in proposal.choices)
    assert "unsure" in as_yaml(proposal, ["car.dbc"])


def test_a_parked_vehicle_proves_nothing(tmp_path):
    log = tmp_path / "parked.log"
    arguments = ["simulate", "--out", str(log), "--minutes", "2", "--route", "parked"]
    assert cli.main(arguments) == 0
    proposal = proposed(EXAMPLE, log)
    sure = {choice.quantity for choice in proposal.choices if choice.is_sure}
    assert sure <= {"accelerometer", "temperature"}


def test_a_lever_that_is_never_in_reverse_is_named_for_the_reader(tmp_path):
    """No value table says which place is reverse, and the vehicle does not reverse."""
    database = tmp_path / "car.dbc"
    database.write_text(
        'VERSION ""\nBU_: A\nBO_ 900 Gear_1: 1 A\n SG_ PosLever : 0|4@1+ (1,0) [0|15] "" A\n'
    )
    log = tmp_path / "drive.log"
    log.write_text("".join(f"({0.1 * k:.6f}) can0 384#03\n" for k in range(600)))
    text = as_yaml(proposed(database, log), [str(database)])
    words = " ".join(text.replace("#", " ").split())
    assert "add 'reverse: {signal: Gear_1.PosLever, equals: VALUE}'" in words
    assert not any(line.strip().startswith("reverse:") for line in text.splitlines())


def test_a_database_of_another_vehicle_is_reported(drive):
    other = load_database_text(
        'VERSION ""\nBS_:\nBU_: A\nBO_ 5 Other: 8 A\n SG_ S : 0|8@1+ (1,0) [0|255] "" A\n', "dbc"
    )
    proposal = discover({"other.dbc": other}, GatheredFrames.of(LogReader([drive])))
    assert any("is it this vehicle's" in note for note in proposal.notes)


def test_output_ids_that_are_on_the_bus_are_moved():
    assert free_output_ids({0x100, 0x63F}) == {}
    moved = free_output_ids({0x645, 0x651})
    assert len(set(moved.values())) == len(moved) == 13
    assert not set(moved.values()) & {0x645, 0x651}


def test_all_ones_that_are_jumped_to_are_not_available():
    database = load_database_text(
        'VERSION ""\nBS_:\nBU_: A\nBO_ 5 M: 2 A\n SG_ S : 0|16@1+ (1,0) [0|65535] "km/h" A\n', "dbc"
    )
    t = np.arange(1000) * 0.02
    raw = (3000 + 2000 * np.sin(t)).astype("<u2")
    raw[[10, 500, 501]] = 0xFFFF
    frames = FrameColumns(
        t, np.full(1000, 5, np.uint32), np.full(1000, 2, np.uint8),
        np.pad(raw.view(np.uint8).reshape(-1, 2), ((0, 0), (0, 6))), np.zeros(1000, np.uint8),
        ("can0",),
    )  # fmt: skip
    (one,) = messages_in(database, GatheredFrames.of([frames]).traffic(), None)
    (signal,) = candidates_of(one, 200)
    assert signal.unavailable == (0xFFFF,)
    assert signal.largest < 5001


def random_frames(seed: int, kind: str) -> FrameColumns:
    """Frames of the example bus with random bytes, random walks or the same bytes always."""
    rng = np.random.default_rng(seed)
    ids = [m.can_id for m in load_database([EXAMPLE]).messages.values()]
    n = 30_000
    can_id = rng.choice(ids, n).astype(np.uint32)
    data = rng.integers(0, 256, (n, 8), dtype=np.uint8)
    if kind == "constant":
        data[:] = data[0]
    if kind == "walks":
        for one in ids:
            rows = np.flatnonzero(can_id == one)
            steps = rng.standard_normal((len(rows), 4)) * rng.choice([3, 30, 300])
            walk = np.cumsum(steps, axis=0) + rng.integers(0, 65536, 4)
            data[rows] = walk.astype(np.int64).astype("<u2").view(np.uint8)
    length = rng.integers(0, 9, n) if seed % 2 else np.full(n, 8)
    t = np.sort(rng.uniform(0.0, 150.0, n))
    return FrameColumns(t, can_id, length.astype(np.uint8), data, np.zeros(n, np.uint8), ("can0",))


@pytest.mark.parametrize("kind", ["random", "walks", "constant"])
@pytest.mark.parametrize("seed", [1, 2])
def test_signals_without_meaning_prove_nothing(seed, kind):
    frames = GatheredFrames.of([random_frames(seed, kind)])
    proposal = discover({"car.dbc": load_database([EXAMPLE])}, frames)
    assert not [c.quantity for c in proposal.choices if c.is_sure]
    parse_config(as_yaml(proposal, ["car.dbc"]))


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_few_frames_are_survived(count):
    frames = GatheredFrames.of([random_frames(3, "random").take(slice(0, count))])
    assert discover({"car.dbc": load_database([EXAMPLE])}, frames).notes


@pytest.mark.slow
def test_the_command_listens_on_a_bus_and_never_sends(tmp_path, drive):
    (chunk, *_) = LogReader([drive])
    stop = threading.Event()
    heard = []

    def car() -> None:
        with can.Bus(interface="virtual", channel="init-live") as bus:
            for i in range(len(chunk)):
                if stop.wait(0.0005):
                    break
                data = chunk.data[i, : chunk.length[i]].tobytes()
                bus.send(can.Message(float(chunk.t[i]), int(chunk.can_id[i]), False, data=data))
            while (message := bus.recv(0.0)) is not None:
                heard.append(message)

    thread = threading.Thread(target=car)
    thread.start()
    out = tmp_path / "car.yaml"
    try:
        arguments = ["--interface", "virtual", "--channel", "init-live", "--seconds", "1"]
        assert cli.main(["init", "--database", str(EXAMPLE), *arguments, "--out", str(out)]) == 0
    finally:
        stop.set()
        thread.join()
    assert "messages of the database" in out.read_text()
    assert heard == []


@pytest.mark.parametrize(
    ("name", "wheel"),
    [
        ("Rad_VL", "front_left"), ("Rad_HR", "rear_right"), ("WS_FR", "front_right"),
        ("WheelRearLeft", "rear_left"), ("RLWheelSpeed", "rear_left"), ("WHL_SPD_FL", "front_left"),
        ("WheelSpeed_Front_Left", "front_left"), ("VehicleSpeed", None), ("AccelX", None),
    ],
)  # fmt: skip
def test_wheels_are_known_by_their_usual_names(name, wheel):
    assert wheel_by_name(name) == wheel


def test_axes_are_known_where_names_differ_in_one_letter():
    names = ["INS_GyrZ", "INS_GyrX", "INS_GyrY"]
    database = load_database_text(
        'VERSION ""\nBS_:\nBU_: A\nBO_ 5 M: 8 A\n'
        + "".join(
            f' SG_ {n} : {16 * i}|16@1+ (1,0) [0|65535] "deg/s" A\n' for i, n in enumerate(names)
        ),
        "dbc",
    )
    assert axes_by_name(list(silent_candidates(database))) == (1, 2, 0)


@pytest.mark.skipif(not (SHARED_DATA / "wrx_sti").exists(), reason="the measured drives are absent")
def test_signs_of_a_measured_car_with_a_two_axis_sensor_are_found():
    folder = SHARED_DATA / "wrx_sti"
    proposal = proposed(folder / "drive.dbc", folder / "drive.log.gz")
    signs = {c.quantity: {k: s.sign for k, s in c.sources.items()} for c in proposal.choices}
    assert signs["accelerometer"] == {"x": -1, "y": 1}
    assert signs["steering_wheel_angle"] == {"": -1}
    assert signs["yaw_rate"] == {"": 1}


@pytest.mark.slow
@pytest.mark.skipif(not (SHARED_DATA / "css_canmod_164").exists(), reason="measured drives absent")
def test_speed_of_obd_answers_is_offered_as_bytes():
    folder = SHARED_DATA / "css_canmod_164"
    speed = proposed(folder / "drive.dbc", folder / "drive.log.gz").choice("speed")
    assert speed is not None
    assert speed.is_sure
    assert speed.sources[""].raw == {
        "id": 0x7E8, "when": "data[1] == 0x41 and data[2] == 0x0D", "value": "data[3]",
    }  # fmt: skip
    assert speed.sources[""].channel == "can0"


@pytest.mark.skipif(not (SHARED_DATA / "mustang_s550").exists(), reason="measured drives absent")
def test_without_a_database_bytes_of_speed_and_steering_are_offered():
    log = SHARED_DATA / "mustang_s550" / "drive.log.gz"
    proposal = discover({}, GatheredFrames.of(LogReader([log])))
    offers = {
        choice.quantity: {source.raw["id"] for other in choice.alternatives
                          for source in other.sources.values() if source.raw}
        for choice in proposal.choices
    }  # fmt: skip
    assert 0x077 in offers["speed"]
    assert 0x085 in offers["steering_wheel_angle"]
    assert not any(choice.is_sure for choice in proposal.choices)


@pytest.mark.parametrize(
    "arguments",
    [[], ["a.log", "--interface", "can0"]],
)
def test_what_makes_no_sense_is_refused(arguments, capsys, tmp_path):
    assert cli.main(["init", *arguments]) == 1
    assert "imucald:" in capsys.readouterr().err
