"""Public recordings become frames that any decoder reads back; what is absent is told."""

from __future__ import annotations

import sys

import cantools
import numpy as np
import pytest
from benchmarks.public_logs import __main__ as command
from benchmarks.public_logs import diagnosed, information
from benchmarks.public_logs.frames import START, Message, Signal, write_log
from benchmarks.public_logs.logs import LOGS

from imucald.config import load_config
from imucald.core.errors import EstimateError
from imucald.core.samples import Series
from imucald.model.model import VehicleModel


def test_written_columns_are_read_back_in_their_unit_and_order(tmp_path):
    rng = np.random.default_rng(3)
    t = np.sort(rng.uniform(100.0, 130.0, 200))
    force, speed = rng.normal(0.0, 3.0, (200, 3)), rng.uniform(0.0, 60.0, 40)
    write_log(tmp_path, [
        Message(0x120, "Acc", t, tuple(
            Signal(f"a{axis}", "m/s^2", 0.002, force[:, i]) for i, axis in enumerate("xyz")
        )),
        Message(0x130, "Gps", t[:40] + 0.5, (Signal("v", "m/s", 0.01, speed, False),)),
    ])  # fmt: skip
    database = cantools.database.load_file(tmp_path / "car.dbc")
    lines = (tmp_path / "drive.log").read_text().splitlines()
    stamps = [float(line[1 : line.index(")")]) for line in lines]
    assert stamps == sorted(stamps)
    assert stamps[0] == START
    found: dict[str, list[dict[str, float]]] = {"Acc": [], "Gps": []}
    for line in lines:
        identifier, _, data = line.split()[2].partition("#")
        message = database.get_message_by_frame_id(int(identifier, 16))
        found[message.name].append(message.decode(bytes.fromhex(data)))
    read = np.array([[row["ax"], row["ay"], row["az"]] for row in found["Acc"]])
    np.testing.assert_allclose(read, force, atol=0.0011)
    np.testing.assert_allclose([row["v"] for row in found["Gps"]], speed, atol=0.0051)
    assert database.get_message_by_name("Gps").signals[0].unit == "m/s"


def test_a_step_that_cannot_hold_a_value_is_refused(tmp_path):
    fine = Message(1, "M", np.array([0.0]), (Signal("s", "g", 0.001, np.array([40.0])),))
    with pytest.raises(ValueError, match=r"M\.s: a step of 0\.001 is too fine"):
        write_log(tmp_path, [fine])


def driven(seed: int, late: float) -> dict[str, Series]:
    """Ten minutes straight on; noise of 0.3 m/s^2 to the side over 1 s, a speed of 5 Hz, late."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 600.0, 0.05)
    slow = np.random.default_rng(99).uniform(0.0, 6.0, 8)
    speed = 12.0 + sum(2.0 * np.sin((0.1 + 0.08 * k) * t + phase) for k, phase in enumerate(slow))
    aside = 0.3 * np.repeat(rng.standard_normal(600), 20)
    force = np.column_stack([np.gradient(speed, t), aside, np.full(len(t), 9.81)])
    return {"accel": Series(t, force), "speed": Series(t[::4] + late, speed[::4])}


@pytest.mark.parametrize("late", [0.0, 0.8])
def test_what_a_log_knows_by_itself_is_how_far_its_yaw_scatters(late):
    found = [information.fitted(driven(seed, late), 10.0) for seed in range(20)]
    std, delays, gains, yaws = (np.array(column) for column in zip(*found, strict=True))
    assert delays == pytest.approx(late, abs=0.11)
    assert gains == pytest.approx(1.0, abs=0.05)
    assert np.median(std) == pytest.approx(np.std(yaws), rel=0.4)
    assert 0.05 < np.median(std) < 3.0


def test_absent_repositories_are_reported_with_their_command_and_fail(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setattr(sys, "argv", ["public_logs", "--data", str(tmp_path)])
    assert command.main() == 1
    output = capsys.readouterr().out
    for log in LOGS:
        assert f"git clone {log.repository.url} " in output
    assert "nothing was measured" in output


@pytest.mark.parametrize("log", LOGS, ids=lambda log: log.name)
def test_every_log_has_a_configuration_by_hand(log):
    assert load_config(log.configuration).config.signals.accelerometer[0].x is not None


class _Cause:
    def __init__(self, name):
        self.name = name


class _Diagnosis:
    def __init__(self, certain, likely):
        self.causes, self.likely = [_Cause(c) for c in certain], [_Cause(c) for c in likely]
        self.look_alikes, self.verdict = [], "found"


@pytest.mark.parametrize(
    ("certain", "likely", "words"),
    [
        (["gyro_scale"], [], "named (verdict found)"),
        ([], ["gyro_scale"], "likely (verdict found)"),
        ([], [], "MISSED (verdict found)"),
        (["dropouts"], [], "MISSED; CERTAIN BESIDE IT: dropouts (verdict found)"),
        (["gyro_scale", "dropouts"], ["road"],
         "named; CERTAIN BESIDE IT: dropouts; likely too: road (verdict found)"),
    ],
)  # fmt: skip
def test_a_hidden_effect_is_named_likely_or_missed_and_other_names_are_reported(
    certain, likely, words, monkeypatch
):
    monkeypatch.setattr(diagnosed, "diagnose", lambda *_: _Diagnosis(certain, likely))
    assert diagnosed._said({}, VehicleModel(), ("gyro_scale",)) == words


def test_certain_causes_of_a_log_without_an_effect_and_refusals_are_reported(monkeypatch):
    monkeypatch.setattr(diagnosed, "diagnose", lambda *_: _Diagnosis(["dropouts"], []))
    assert diagnosed._said({}, VehicleModel(), ()) == "certain: dropouts (verdict found)"

    def too_short(*_):
        raise EstimateError("less than four stretches")

    monkeypatch.setattr(diagnosed, "diagnose", too_short)
    assert diagnosed._said({}, VehicleModel(), ()) == "refused: less than four stretches"
