"""A whole configuration is found on buses whose names tell nothing, and says what is not sure."""

from __future__ import annotations

import math
import re
import threading
from pathlib import Path

import numpy as np
import pytest
from benchmarks.init.judge import judge
from benchmarks.init.obfuscated import write_bus
from msgspec import structs

import imucald
from imucald import cli
from imucald.can.columns import FrameColumns, concatenate
from imucald.can.dbc.database import load_database, load_database_text
from imucald.can.logs.log_reader import CandumpWriter, LogReader
from imucald.can.python_can import can
from imucald.config import load_config, parse_config
from imucald.discovery import GatheredFrames, Proposal, as_yaml, discover
from imucald.discovery.candidates import candidates_of, messages_in, silent_candidates
from imucald.discovery.discover import free_output_ids
from imucald.discovery.names import axes_by_name, wheel_by_name
from imucald.inputs.units import find_unit
from paths import ROOT, SHARED_DATA

EXAMPLE = ROOT / "dbc" / "imucald_example.dbc"


def proposed(database: Path, *logs: Path) -> Proposal:
    """What is proposed for a log."""
    frames = GatheredFrames.from_chunks(LogReader(list(logs))) if logs else GatheredFrames()
    return discover({str(database): load_database(database)}, frames)


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


def test_only_the_part_before_or_after_a_move_of_the_sensor_is_used(tmp_path, capsys):
    log, out = tmp_path / "drive.log", tmp_path / "car.yaml"
    arguments = ["--minutes", "6", "--seed", "6", "--shift", "140,0,60,20"]
    assert cli.main(["simulate", "--out", str(log), *arguments]) == 0
    assert cli.main(["init", "--database", str(EXAMPLE), str(log), "--out", str(out)]) == 0
    assert "imucald: the sensor was moved between" in capsys.readouterr().err
    text = out.read_text()
    assert "# The sensor was moved between" in text
    proposal = proposed(EXAMPLE, log)
    for quantity in ("accelerometer", "gyroscope", "speed", "yaw_rate"):
        choice = proposal.choice(quantity)
        assert choice is not None
        assert choice.is_sure, quantity


@pytest.mark.parametrize("share", [0.0, 0.05])
def test_a_recorder_that_drops_frames_is_named(drive, share):
    frames = concatenate(list(LogReader([drive])))
    kept = frames.take(np.random.default_rng(1).random(len(frames)) >= share)
    recording = GatheredFrames.from_chunks([kept])
    proposal = discover({"car.dbc": load_database(EXAMPLE)}, recording)
    text = "% of the frames of each message are lost: the recorder seems to drop frames"
    assert (proposal.loss is None) == (share == 0.0)
    assert proposal.loss is None or proposal.loss.endswith(text)
    lost = [note for note in proposal.notes if note.startswith("Frames lost: ")]
    assert len(lost) == (share > 0.0)
    assert all(re.search(r"ESC_Speed [45]\.\d %", note) for note in lost)
    accelerometer = proposal.choice("accelerometer")
    assert accelerometer is not None
    assert float(accelerometer.evidence.split("/s")[0]) == pytest.approx(
        100.0 * (1.0 - share), rel=0.01
    )


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
    assert "IMU_Accel.AccelX, AccelY, AccelZ look like the sensor" in accelerometer.doubt
    (times,) = re.findall(r"seems to be ([\d.]+) times", accelerometer.doubt)
    assert float(times) == pytest.approx(scale / 0.002, rel=0.03)
    out = tmp_path / "car.yaml"
    assert cli.main(["init", "--database", str(database), str(drive), "--out", str(out)]) == 0
    printed = capsys.readouterr().err
    assert "the scale in the database seems" in printed
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


def test_the_product_of_wheelbase_and_steering_ratio_is_stated_once(drive):
    written = as_yaml(proposed(EXAMPLE, drive), [str(EXAMPLE)])
    assert len(re.findall(r"[\d.]+ m\b(?!/)", written.replace("wheelbase of 2.68 m", ""))) == 1


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
    proposal = discover({"other.dbc": other}, GatheredFrames.from_chunks(LogReader([drive])))
    assert any("Is it the database of this vehicle" in note for note in proposal.notes)


def test_output_ids_that_are_on_the_bus_are_moved():
    assert free_output_ids({0x100, 0x63F}) == {}
    moved = free_output_ids({0x645, 0x651})
    assert len(set(moved.values())) == len(moved) == 15
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
    (one,) = messages_in(database, GatheredFrames.from_chunks([frames]).traffic(), None)
    (signal,) = candidates_of(one, 200)
    assert signal.unavailable == (0xFFFF,)
    assert signal.largest < 5001


def random_frames(seed: int, kind: str) -> FrameColumns:
    """Frames of the example bus with random bytes, random walks or the same bytes always."""
    rng = np.random.default_rng(seed)
    ids = [m.can_id for m in load_database(EXAMPLE).messages.values()]
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
    frames = GatheredFrames.from_chunks([random_frames(seed, kind)])
    proposal = discover({"car.dbc": load_database(EXAMPLE)}, frames)
    assert not [c.quantity for c in proposal.choices if c.is_sure]
    parse_config(as_yaml(proposal, ["car.dbc"]))


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_few_frames_are_survived(count):
    frames = GatheredFrames.from_chunks([random_frames(3, "random").take(slice(0, count))])
    assert discover({"car.dbc": load_database(EXAMPLE)}, frames).notes


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
    assert "messages in the database" in out.read_text()
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


@pytest.mark.parametrize(
    "names",
    [
        ["INS_GyrZ", "INS_GyrX", "INS_GyrY"],
        ["VerticalAccel", "LongitudinalAccel", "LateralAccel"],
        ["YawRate", "RollRate", "PitchRate"],
        ["Hochbeschl", "Laengsbeschleunigung", "Querbeschl"],
        ["ESP_Gierrate", "SARA_Wankrate", "SARA_Nickrate"],
        ["accvert", "acclon", "acclat"],
        ["AccZ_Vert", "AccX_Long", "AccY_Lat"],
        ["IMU_az_mps2", "IMU_ax", "IMU_ay"],
    ],
)
def test_axes_are_known_by_a_letter_or_by_a_word_for_the_direction(names):
    assert order_of(names) == (1, 2, 0)


@pytest.mark.parametrize(
    "names", [["One", "Two", "Three"], ["RateA", "RateX", "RateY"], ["LatX", "LongY", "VertZ"]]
)
def test_axes_are_not_guessed_where_names_say_none_or_two(names):
    assert order_of(names) is None


def order_of(names: list[str]) -> tuple[int, int, int] | None:
    """What is taken for the order of three signals with these names."""
    database = load_database_text(
        'VERSION ""\nBS_:\nBU_: A\nBO_ 5 M: 8 A\n'
        + "".join(
            f' SG_ {n} : {16 * i}|16@1+ (1,0) [0|65535] "deg/s" A\n' for i, n in enumerate(names)
        ),
        "dbc",
    )
    return axes_by_name(list(silent_candidates(database)))


def test_a_sensor_whose_axes_come_in_the_order_lateral_longitudinal_vertical_is_not_mirrored(
    drive, tmp_path
):
    text = EXAMPLE.read_text()
    for old, new in zip("XYZ", ("Lateral", "Longitudinal", "Vertical"), strict=True):
        text = text.replace(f"Accel{old} ", f"{new}Acc ")
    proposal = proposed(database_of(text, tmp_path), drive)
    accelerometer = proposal.choice("accelerometer")
    assert {a: s.signal for a, s in accelerometer.sources.items()} == {
        "x": "IMU_Accel.LongitudinalAcc",
        "y": "IMU_Accel.LateralAcc",
        "z": "IMU_Accel.VerticalAcc",
    }


def test_raw_counts_without_a_scale_are_found_with_the_usual_one_and_are_unsure(drive, tmp_path):
    """AccelX in counts of 0.002 m/s2 (4903 for 1 g), RateX in counts of 0.01 deg/s."""
    text = EXAMPLE.read_text()
    text = text.replace('(0.002,0) [-39.2|39.2] "m/s^2"', '(1,0) [0|0] "counts"')
    text = text.replace('(0.01,0) [-250|250] "deg/s"', '(1,0) [0|0] ""')
    text = without(text, "LateralAccel", "LongitudinalAccel")
    proposal = proposed(database_of(text, tmp_path), drive)
    accelerometer, gyro = proposal.choice("accelerometer"), proposal.choice("gyroscope")
    assert accelerometer.sources["x"].signal == "IMU_Accel.AccelX"
    size = find_unit(accelerometer.sources["x"].unit, "acceleration").factor
    assert size == pytest.approx(0.002, rel=0.08)
    assert "raw counts" in accelerometer.doubt
    size = math.degrees(find_unit(gyro.sources["x"].unit, "angular_rate").factor)
    assert size == pytest.approx(0.01, rel=0.35)
    assert "raw counts" in gyro.doubt
    assert f"the recording fits 'unit: {gyro.sources['x'].unit}'" in gyro.doubt


def copied(frames: FrameColumns, ids: dict[int, int]) -> FrameColumns:
    """Frames and, a millisecond later, copies of some of them under other identifiers."""
    parts = [frames]
    for old, new in ids.items():
        again = frames.take(frames.can_id == old)
        parts.append(structs.replace(again, t=again.t + 0.001, can_id=again.can_id * 0 + new))
    whole = concatenate(parts)
    return whole.take(np.argsort(whole.t, kind="stable"))


@pytest.mark.parametrize("moved", ["Z", "X"])
def test_axes_in_two_messages_are_found_and_not_taken_for_a_level_sensor(moved, drive):
    """What a float of 32 bits for each axis needs; a neighbouring message has the third axis."""
    text, ids = EXAMPLE.read_text(), {}
    for sensor, message in (("Accel", "IMU_Accel"), ("Rate", "IMU_Gyro")):
        line = next(x for x in text.splitlines() if f"SG_ {sensor}{moved} " in x)
        head = next(x for x in text.splitlines() if x.startswith("BO_") and message in x)
        number = int(head.split()[1])
        ids[number] = number + 0x100
        other = head.replace(f"{number} {message}", f"{number + 0x100} {message}_{moved}")
        text = text.replace(f"{line}\n", "").replace(head, f"{other}\n{line}\n\n{head}")
    frames = GatheredFrames.from_chunks([copied(concatenate(list(LogReader([drive]))), ids)])
    proposal = discover({"other.dbc": load_database_text(text, "dbc")}, frames)
    for quantity, name in (("accelerometer", "Accel"), ("gyroscope", "Rate")):
        choice = proposal.choice(quantity)
        found = {axis: source.signal.partition(".")[2] for axis, source in choice.sources.items()}
        assert found == {axis: name + axis.upper() for axis in "xyz"}
        assert choice.is_sure


def test_an_axis_that_is_cut_off_is_no_axis_of_another_message(drive):
    """The car's yaw rate, in the same unit, fits a gyroscope without z in all but its mount."""
    frames = concatenate(list(LogReader([drive])))
    length = np.where(frames.can_id == 0x201, 4, frames.length).astype(frames.length.dtype)
    cut = GatheredFrames.from_chunks([structs.replace(frames, length=length)])
    proposal = discover({"car.dbc": load_database(EXAMPLE)}, cut)
    choice = proposal.choice("gyroscope")
    assert choice is None or not choice.is_sure
    yaw_rate = proposal.choice("yaw_rate")
    assert {s.signal for s in yaw_rate.sources.values()} == {"ESC_Dynamics.YawRate"}


SIDED = ("YawRate", "LateralAccel", "SteeringWheelAngle")


def without(text: str, *names: str) -> str:
    """A database's text without some signals."""
    return "".join(
        x for x in text.splitlines(True) if not any(f"SG_ {name}" in x for name in names)
    )


def with_signs(text: str, *names: str) -> str:
    """A database's text in which the scale of some signals has the other sign."""
    return "".join(
        re.sub(r"\(([\d.]+),", r"(-\1,", x) if any(f"SG_ {n} " in x for n in names) else x
        for x in text.splitlines(True)
    )


def test_an_accelerometer_against_which_all_else_speaks_is_turned_and_unsure(drive, tmp_path):
    """It shows minus the specific force; without the wheels, three signals of the car speak."""
    text = with_signs(without(EXAMPLE.read_text(), "Wheel"), "AccelX", "AccelY", "AccelZ")
    database = database_of(text, tmp_path)
    proposal = proposed(database, drive)
    signs = {c.quantity: {s.sign for s in c.sources.values()} for c in proposal.choices}
    assert signs["accelerometer"] == {-1}
    assert [signs[q] for q in ("yaw_rate", "steering_wheel_angle", "gyroscope")] == [{1}] * 3
    accelerometer = proposal.choice("accelerometer")
    assert "minus the specific force" in accelerometer.doubt
    out = tmp_path / "car.yaml"
    out.write_text(as_yaml(proposal, [str(database)]))
    found = [f for f in imucald.check(out, drive).findings if f["level"] == "warning"]
    assert any("the axis that points up must show +1 g" in f["text"] for f in found)


def test_two_signals_that_need_the_other_sign_make_the_accelerometer_unsure(drive, tmp_path):
    text = without(EXAMPLE.read_text(), "Wheel", "LateralAccel")
    database = database_of(with_signs(text, "AccelX", "AccelY", "AccelZ"), tmp_path)
    accelerometer = proposed(database, drive).choice("accelerometer")
    assert "yaw_rate" in accelerometer.doubt
    assert "steering_wheel_angle" in accelerometer.doubt


def test_a_yaw_rate_alone_that_needs_the_other_sign_makes_the_accelerometer_unsure(drive, tmp_path):
    """Yaw rates that count to the right are rarer than accelerometers of the other sign."""
    text = without(EXAMPLE.read_text(), "Wheel", "LateralAccel", "SteeringWheel")
    database = database_of(with_signs(text, "AccelX", "AccelY", "AccelZ"), tmp_path)
    assert "yaw_rate" in proposed(database, drive).choice("accelerometer").doubt


def test_one_of_three_signals_that_needs_the_other_sign_says_nothing_of_it(drive, tmp_path):
    for name in SIDED:
        database = database_of(with_signs(EXAMPLE.read_text(), name), tmp_path)
        assert proposed(database, drive).choice("accelerometer").is_sure, name


def test_signals_that_the_configuration_turns_do_not_confirm_the_accelerometer(drive, tmp_path):
    """As somebody writes it who believes the accelerometer."""
    text = with_signs(EXAMPLE.read_text(), "AccelX", "AccelY", "AccelZ")
    database_of(text, tmp_path)
    out = tmp_path / "car.yaml"
    out.write_text(
        """database: other.dbc
signals:
  accelerometer: {x: IMU_Accel.AccelX, y: IMU_Accel.AccelY, z: IMU_Accel.AccelZ}
  speed: ESC_Speed.VehicleSpeed
  yaw_rate: {signal: ESC_Dynamics.YawRate, sign: -1}
  steering_wheel_angle: {signal: EPS_SteeringAngle.SteeringWheelAngle, sign: -1}
"""
    )
    found = [f for f in imucald.check(out, drive).findings if f["level"] == "warning"]
    assert any("its signs are not certain" in f["text"] for f in found)
    out.write_text(out.read_text() + "calibration: {orientation: {up: z}}\n")
    found = imucald.check(out, drive).findings
    assert not any("its signs are not certain" in f["text"] for f in found)


@pytest.mark.parametrize(
    ("unit", "known"),
    [("Unit_KiloMeterPerHour", True), ("kilometer/hour", True), ("speed_unit", False)],
)
def test_a_unit_in_words_is_read_and_one_that_is_not_known_is_found_in_the_data(
    unit, known, drive, tmp_path
):
    text = EXAMPLE.read_text().replace('[0|400] "km/h"', f'[0|400] "{unit}"')
    choice = proposed(database_of(text, tmp_path), drive).choice("speed")
    assert choice is not None
    assert choice.sources[""].signal == "ESC_Speed.VehicleSpeed"
    assert choice.sources[""].unit == (None if known else "km/h")
    assert choice.is_sure


def database_of(text: str, folder: Path) -> Path:
    """A database file with a text."""
    path = folder / "other.dbc"
    path.write_text(text)
    return path


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
    proposal = discover({}, GatheredFrames.from_chunks(LogReader([log])))
    offers = {
        choice.quantity: {source.raw["id"] for other in choice.alternatives
                          for source in other.sources.values() if source.raw}
        for choice in proposal.choices
    }  # fmt: skip
    assert 0x077 in offers["speed"]
    assert 0x085 in offers["steering_wheel_angle"]
    assert not any(choice.is_sure for choice in proposal.choices)


def test_bytes_of_a_described_j1939_message_are_not_offered_as_bytes_that_no_database_describes(
    drive,
):
    """Its frames come with another priority than in the database, its rates have an offset as in
    J1939, and the bytes of one of them follow the bends."""
    number, sent = 0x98F02AE2, 0x88F02AE2
    text = EXAMPLE.read_text().replace("BO_ 513 IMU_Gyro", f"BO_ {number} IMU_Gyro")
    text = re.sub(r"^(?!BO_ |BU_).*\b513\b.*$", "", text, flags=re.M)
    text = re.sub(r"(SG_ Rate. .*)1- \(0.01,0\)", r"\g<1>1+ (0.01,-327.68)", text)
    text += (
        'BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";\n'
        f'BA_ "VFrameFormat" BO_ {number} 3;\n'
    )
    frames = concatenate(list(LogReader([drive])))
    frames = frames.take(frames.can_id != 0xC2)  # without the steering angle
    can_id = np.where(frames.can_id == 0x201, sent, frames.can_id).astype(frames.can_id.dtype)
    data = frames.data.copy()
    data[np.ix_(frames.can_id == 0x201, (1, 3, 5))] ^= 0x80
    recording = GatheredFrames.from_chunks([structs.replace(frames, can_id=can_id, data=data)])
    proposal = discover({"car.dbc": load_database_text(text, "dbc")}, recording)
    assert proposal.choice("gyroscope").sources["z"].signal == "IMU_Gyro.RateZ"
    offered = [
        source.raw["id"]
        for choice in proposal.choices
        for other in choice.alternatives
        for source in other.sources.values()
        if source.raw
    ]
    assert sent & 0x1FFFFFFF not in offered


def test_j1939_messages_of_a_database_that_does_not_say_so_are_found_by_their_pgn(drive, tmp_path):
    number, sent = 0x98F02AE2, 0x98F02A33
    text = EXAMPLE.read_text().replace("BO_ 513 IMU_Gyro", f"BO_ {number} IMU_Gyro")
    text = re.sub(r"^(?!BO_ |BU_).*\b513\b.*$", "", text, flags=re.M)
    frames = concatenate(list(LogReader([drive])))
    can_id = np.where(frames.can_id == 0x201, sent, frames.can_id).astype(frames.can_id.dtype)
    database = tmp_path / "car.dbc"
    database.write_text(text)
    recording = GatheredFrames.from_chunks([structs.replace(frames, can_id=can_id)])
    proposal = discover({"car.dbc": load_database(database)}, recording)
    assert proposal.choice("gyroscope").sources["z"].signal == "IMU_Gyro.RateZ"
    out = tmp_path / "car.yaml"
    out.write_text(as_yaml(proposal, ["car.dbc"]))
    assert "database: {path: car.dbc, j1939: true}" in out.read_text()
    with CandumpWriter(tmp_path / "sent.log") as writer:
        writer.write_columns(structs.replace(frames, can_id=can_id))
    report = imucald.check(out, tmp_path / "sent.log")
    assert report.usable, report.findings


def test_of_two_accelerometers_the_one_that_belongs_to_the_gyroscope_is_taken_and_unsure(drive):
    """The other one sits otherwise, and shows the changes of speed as well."""
    frames = GatheredFrames.from_chunks(
        [copied(concatenate(list(LogReader([drive]))), {0x200: 0x180})]
    )
    text = EXAMPLE.read_text()
    axes = re.findall(r" SG_ Accel[XYZ] : .*\n", text)
    order = zip(axes, "XYZ", "YZX", strict=True)
    turned = [line.replace(f"Accel{x}", f"Accel{y}") for line, x, y in order]
    head = next(x for x in text.splitlines() if x.startswith("BO_ 512"))
    other = head.replace("512 IMU_Accel", "384 TCU_Accel")
    text = text.replace(head, f"{other}\n{''.join(turned)}\n{head}")
    proposal = discover({"car.dbc": load_database_text(text, "dbc")}, frames)
    accelerometer, gyroscope = proposal.choice("accelerometer"), proposal.choice("gyroscope")
    assert accelerometer.sources["x"].signal == "IMU_Accel.AccelX"
    assert "TCU_Accel has an accelerometer too" in accelerometer.doubt
    assert gyroscope.is_sure
    for quantity in ("lateral_acceleration", "longitudinal_acceleration"):
        choice = proposal.choice(quantity)
        of_another = choice is not None and choice.sources[""].signal.startswith("TCU_Accel")
        assert not (of_another and choice.is_sure), quantity


@pytest.mark.parametrize(
    "arguments",
    [[], ["a.log", "--interface", "can0"]],
)
def test_what_makes_no_sense_is_refused(arguments, capsys, tmp_path):
    assert cli.main(["init", *arguments]) == 1
    assert "imucald:" in capsys.readouterr().err
