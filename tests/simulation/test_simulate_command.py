"""`imucald simulate` as a person uses it."""

import json
from pathlib import Path

import pytest
from scipy.spatial.transform import Rotation

from imucald.can.python_can import can
from imucald.cli import main
from imucald.config import load_config
from imucald.simulation import load_model, random_model
from imucald.simulation import simulate as run_model
from imucald.traffic.can_log import live_frames
from imucald.traffic.drive_encoder import BusEncoder, example_config
from paths import ROOT


def simulate(tmp_path, *options):
    out = tmp_path / "drive.log"
    status = main(["simulate", "--out", str(out), "--minutes", "0.2", *options])
    return status, out, tmp_path / "drive.truth.json"


def test_log_and_truth_are_written(tmp_path, capsys):
    options = ("--mount", "-5,3.5,120", "--shift", "6,0,0,4", "--seed", "7")
    status, out, truth_path = simulate(tmp_path, *options)
    assert status == 0
    assert out.read_text().startswith("(1600000000.0")
    truth = json.loads(truth_path.read_text())
    w, x, y, z = truth["mount"]["quaternion_wxyz"]
    expected = Rotation.from_euler("ZYX", [120, 3.5, -5], degrees=True)
    assert (Rotation.from_quat([x, y, z, w]).inv() * expected).magnitude() < 1e-9
    assert truth["mount"]["yaw_deg"] == pytest.approx(120.0)
    assert truth["shifts"][0]["t_s"] == 6.0
    assert truth["shifts"][0]["mount"]["yaw_deg"] == pytest.approx(124.0)
    assert truth["seed"] == 7
    assert truth["model"]["road"]["grade_rms"] == 0.02
    assert "mean_crown_deg" in truth
    assert "drive.log" in capsys.readouterr().out


def test_the_same_seed_gives_the_same_file(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    logs = [simulate(tmp_path / name, "--seed", "3")[1].read_bytes() for name in "ab"]
    assert logs[0] == logs[1]
    assert len(logs[0]) > 100_000


def test_a_written_model_gives_the_same_drive(tmp_path):
    model = tmp_path / "model.yaml"
    _, out, _ = simulate(tmp_path, "--seed", "3", "--write-model", str(model))
    first = out.read_bytes()
    assert load_model(model).route.kind == "mixed"
    _, out, _ = simulate(tmp_path, "--seed", "3", "--model", str(model))
    assert out.read_bytes() == first


def test_background_fills_the_bus(tmp_path):
    _, out, _ = simulate(tmp_path)
    alone = len(out.read_text().splitlines())
    _, out, _ = simulate(tmp_path, "--background")
    assert len(out.read_text().splitlines()) - alone == pytest.approx(12 * 2300, rel=0.15)


def test_parameters_can_be_set(tmp_path):
    options = ("--set", "route.standing_first_s=12", "--set", "accel.bias=[1, 0, 0]",
               "--set", "accel.vibration=false", "--route", "parked")  # fmt: skip
    status, _, truth = simulate(tmp_path, *options)
    assert status == 0
    model = json.loads(truth.read_text())["model"]
    assert model["accel"]["bias"] == [1.0, 0.0, 0.0]
    assert model["accel"]["vibration"] is False
    assert model["route"]["kind"] == "parked"


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (("--mount", "1,2"), "3 numbers"),
        (("--mount", "a,b,c"), "3 numbers"),
        (("--shift", "1,2,3"), "4 numbers"),
        (("--shift", "-1,2,3,4"), "t_s"),
        (("--set", "road"), "KEY=VALUE"),
        (("--set", "road.crown=1"), "road.crown"),
        (("--set", "gyro.scale=0.03"), "a list of 3 numbers, such as [0.03,0.03,0.03]; got 0.03"),
        (("--minutes", "0"), "minutes"),
        (("--minutes", "nan"), "minutes"),
        (("--model", "nothing.yaml"), "nothing.yaml"),
        (("--config", "nothing.yaml"), "nothing.yaml"),
        (("--write-model", "/nowhere/model.yaml"), "cannot be written"),
    ],
)
def test_mistakes_end_in_one_clear_line(tmp_path, capsys, options, reason):
    status, _, _ = simulate(tmp_path, *options)
    assert status == 1
    text = capsys.readouterr().err
    assert reason in text
    assert "Traceback" not in text


def test_the_log_can_go_to_standard_output(capfdbinary):
    assert main(["simulate", "--out", "-", "--minutes", "0.1"]) == 0
    written = capfdbinary.readouterr().out
    assert written.startswith(b"(1600000000.0")
    assert written.endswith(b"\n")
    assert written.count(b"\n") > 2000


def test_somewhere_to_write_is_needed(capsys):
    for options in ([], ["--interface", "virtual"], ["--channel", "x"]):
        assert main(["simulate", *options]) == 1
        assert "--interface" in capsys.readouterr().err


@pytest.mark.slow
def test_a_drive_is_sent_onto_a_bus_in_its_time(capsys):
    options = ["--interface", "virtual", "--channel", "simulated", "--minutes", "0.02"]
    with can.Bus(interface="virtual", channel="simulated") as listener:
        assert main(["simulate", *options, "--set", "speed.enabled=false"]) == 0
        frames = []
        while (frame := listener.recv(0.0)) is not None:
            frames.append(frame)
    drive = run_model(random_model(1).with_changes({"speed.enabled": False}), 1, 0.02)
    expected = list(live_frames(drive, BusEncoder(example_config())))
    assert [(f.arbitration_id, bytes(f.data)) for f in frames] == [row[1:] for row in expected]
    assert f"{len(expected)} frames sent" in capsys.readouterr().out
    span = frames[-1].timestamp - frames[0].timestamp
    assert span == pytest.approx(expected[-1][0] - expected[0][0], abs=0.3)


def test_the_shipped_example_configuration_is_the_packages_own():
    shipped = Path(__file__).parents[2] / "config" / "examples" / "passenger_car.yaml"
    ours, theirs = example_config(), load_config(shipped)
    assert ours.config.signals == theirs.config.signals
    assert ours.config.messages == theirs.config.messages
    assert (
        ours.database_path(ours.config.database[0]).samefile(
            theirs.database_path(theirs.config.database[0])
        )
        or ours.database_path(ours.config.database[0]).read_text()
        == theirs.database_path(theirs.config.database[0]).read_text()
    )


def test_the_drive_keeps_to_the_side_that_the_configuration_states(tmp_path, capsys):
    text = (ROOT / "config" / "examples" / "passenger_car.yaml").read_text()
    text = text.replace("../../dbc", str(ROOT / "dbc"))
    config, model = tmp_path / "car.yaml", tmp_path / "model.yaml"

    def side(stated, *options):
        config.write_text(text.replace("driving_side: right", f"driving_side: {stated}"))
        options = ("--config", str(config), *options)
        status, _, truth = simulate(tmp_path, "--minutes", "0.02", *options)
        assert status == 0
        return json.loads(truth.read_text())["model"]["route"]["driving_side"]

    assert side("left") == "left"
    assert side("unknown") == "right", "the default of a model"
    assert side("left", "--set", "route.driving_side=right") == "right"
    model.write_text("road: {crown_mean: 0.02}\n")
    assert side("left", "--model", str(model)) == "left"
    assert "warning" not in capsys.readouterr().err
    model.write_text("route: {driving_side: right}\n")
    assert side("left", "--model", str(model)) == "right"
    assert "the model file is used" in capsys.readouterr().err
    assert side("left", "--model", str(model), "--set", "route.driving_side=left") == "left"
    assert "warning" not in capsys.readouterr().err


@pytest.mark.parametrize("change", ["speed.scale=1.04", "accel.scale=[0, 0.96, 0]"])
def test_a_factor_in_place_of_a_gain_error_is_refused_with_the_remedy(tmp_path, capsys, change):
    out = tmp_path / "drive.log"
    assert main(["simulate", "--out", str(out), "--set", change]) == 1
    error = capsys.readouterr().err
    assert f"{change.partition('=')[0]} is " in error
    assert "0.04 means values that are 4 % too large" in error
    assert not out.exists()


@pytest.mark.parametrize(
    ("start", "stamp"),
    [("2026-05-01T08:00", 1777622400.0), ("2026-05-01T10:00+02:00", 1777622400.0)],
)
def test_the_log_starts_when_it_is_asked_to(tmp_path: Path, start: str, stamp: float) -> None:
    log = tmp_path / "d.log"
    assert main(["simulate", "--minutes", "0.1", "--start", start, "--out", str(log)]) == 0
    first = float(log.read_text()[1:].partition(")")[0])
    assert stamp <= first < stamp + 0.1


@pytest.mark.parametrize("start", ["yesterday", "1969-01-01", "2200-01-01"])
def test_a_start_that_is_no_date_is_refused(
    tmp_path: Path, start: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "--start", start, "--out", str(tmp_path / "d.log")]) == 1
    assert f"--start '{start}'" in capsys.readouterr().err
