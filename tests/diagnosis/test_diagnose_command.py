"""`imucald diagnose` as a person uses it; the diagnosis itself is made by hand here."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import made_diagnosis as made
import pytest
import yaml

from imucald import cli
from imucald.api import diagnosing
from imucald.commands.diagnose_view import print_diagnosis
from imucald.simulation import load_model

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parent.parent.parent
CONFIG = str(ROOT / "config" / "examples" / "passenger_car.yaml")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory) -> bytes:
    log = tmp_path_factory.mktemp("drive") / "drive.log"
    assert cli.main(["simulate", "--minutes", "0.2", "--out", str(log)]) == 0
    return log.read_bytes()


@pytest.fixture
def log(simulated, tmp_path) -> Path:
    path = tmp_path / "drive.log"
    path.write_bytes(simulated)
    return path


@pytest.fixture
def asked(monkeypatch):
    """Stands in for the diagnosis; holds what it was asked."""
    calls: dict[str, object] = {"answer": made.found()}

    def baseline_model(loaded, recordings):
        calls["recordings"] = recordings
        return made.BEFORE

    def diagnose(drives, model, progress, limit_s):
        calls["drives"], calls["model"], calls["limit_s"] = drives, model, limit_s
        progress(0.5, "halfway")
        return calls["answer"]

    monkeypatch.setattr(diagnosing, "baseline_model", baseline_model)
    monkeypatch.setattr(diagnosing, "diagnosed", diagnose)
    return calls


@pytest.fixture
def diagnosed(capsys):
    def diagnosed(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        status = cli.main(["diagnose", "--config", CONFIG, *(str(a) for a in arguments)])
        return (status, *capsys.readouterr())

    return diagnosed


def test_the_summary_says_what_was_found_in_words(asked, diagnosed, log):
    status, out, err = diagnosed(log)
    assert (status, err) == (0, "")
    assert "Found: body roll (9.62 instead of 4.50 deg/g)" in out
    assert "suspension.roll_gradient" in out
    assert "9.62 ± 0.35 deg/g" in out  # 95 %: two deviations
    assert "4.50 deg/g" in out, "what the file said"
    assert "673 nats likelier" in out
    assert "Next: Use the extended model file (--write-model FILE)" in out
    assert "Rows with 'nothing' may exceed the floor" in out
    assert "against it: it predicts worse in 40 % of the segments" in out
    assert re.search("not named.*\n *accelerometer scale +not decidable here", out)
    assert "note: no temperature signal" in out


def test_changes_are_those_of_a_model_file_only_where_there_is_one(asked, diagnosed, log, tmp_path):
    _, out, _ = diagnosed(log)
    assert "found, suspension.roll_gradient: 0.008 -> 0.0171235" in out
    assert "model file, suspension" not in out
    _, out, _ = diagnosed(log, "--write-model", tmp_path / "extended.yaml")
    assert "model file, suspension.roll_gradient: 0.008 -> 0.0171235" in out


def test_a_time_limit_is_handed_on(asked, diagnosed, log):
    assert diagnosed(log, "--time-limit", "7.5")[0] == 0
    assert asked["limit_s"] == 7.5


@pytest.mark.parametrize(("verdict", "words"), [
    ("ambiguous", "a drive that would distinguish these causes:"),
    ("ambiguous", "ambiguous: accelerometer bias. "),
    ("unknown", "at 0.62 Hz, while cornering"),
    ("nothing", "Nothing found in "),
])  # fmt: skip
def test_the_other_verdicts_are_reported_and_are_no_failure(asked, diagnosed, log, verdict, words):
    asked["answer"] = made.ALL[verdict]()
    status, out, _ = diagnosed(log)
    assert status == 0
    assert words in " ".join(out.split())


def test_each_log_is_a_drive_of_its_own(asked, diagnosed, log, tmp_path):
    second = tmp_path / "second.log"
    assert cli.main(["simulate", "--minutes", "0.2", "--seed", "2", "--out", str(second)]) == 0
    assert diagnosed(log, second)[0] == 0
    assert len(asked["drives"]) == 2
    assert asked["drives"][0] == asked["recordings"][0].samples
    assert set(asked["drives"][1]) >= {"accel", "gyro", "speed", "steering"}
    assert asked["model"] is made.BEFORE


def test_a_model_file_is_put_to_the_test_instead_of_a_plain_car(asked, diagnosed, log, tmp_path):
    model = tmp_path / "model.yaml"
    model.write_text(made.AFTER.to_yaml())
    assert diagnosed(log, "--model", model)[0] == 0
    assert asked["model"] == made.AFTER
    assert "recordings" not in asked


def test_json_has_the_documented_keys_and_is_alone_on_standard_output(asked, diagnosed, log):
    status, out, err = diagnosed(log, "--json", "-")
    assert (status, err) == (0, "")
    result = json.loads(out)
    assert result["verdict"] == "found"
    roll = result["causes"][0]
    assert roll["name"] == "body_roll"
    assert roll["parameters"]["suspension.roll_gradient"] == {
        "value": 0.017123457, "std": 0.00031, "unit": "rad/(m/s^2)", "stated": 0.008,
        "tolerance": 0.0025,
    }  # fmt: skip
    assert result["signals"]["accel_y"] == {
        "rms_before": 0.312, "rms_after": 0.101, "noise_floor": 0.094, "unit": "m/s^2",
        "slow_before": 0.3, "slow_after": 0.08, "left": "offset +0.13 m/s^2",
        "rms_unseen": 0.102, "verdict": "found",
    }  # fmt: skip
    assert result["gain"] == {
        "held_out_log_likelihood": 673.0, "interval": [590.0, 755.0],
        "worse": [], "recommended": True,
    }  # fmt: skip
    assert set(result) >= {"look_alikes", "to_separate", "duration_s", "structure", "candidates"}
    assert result["logs"] == [str(log)]
    change = result["model_changes"]["suspension.roll_gradient"]
    assert change == {"before": 0.008, "after": 0.01712345678}


def test_the_written_model_loads_and_says_where_it_comes_from(asked, diagnosed, log, tmp_path):
    model = tmp_path / "extended.yaml"
    status, out, _ = diagnosed(log, "--write-model", model)
    assert status == 0
    assert f"written: {model}" in out
    assert load_model(model) == made.AFTER
    modeline, *head = [line for line in model.read_text().splitlines() if line.startswith("#")]
    assert modeline.startswith("# yaml-language-server: $schema=")
    assert "drive.log (12 s)" in head[1]
    assert "Found: body roll (9.62 instead of 4.50 deg/g) and accelerometer bias" in head[2]
    assert "suspension.roll_gradient: 0.008 -> 0.0171235" in head[3]


def test_the_file_of_look_alikes_says_that_it_may_hold_the_wrong_one(
    asked, diagnosed, log, tmp_path
):
    model = tmp_path / "extended.yaml"
    asked["answer"] = replace(made.ambiguous(), model_after=made.AFTER)
    _, out, _ = diagnosed(log, "--write-model", model)
    assert "for prediction only: it contains one of several causes that fit equally well" in (
        " ".join(out.split())  # where a line breaks depends on the length of the path
    )
    assert "ambiguous: mount rotation. The mount of the sensor differs" in out
    assert (
        "# For prediction only: one of several causes that fit equally well.\n" in model.read_text()
    )
    assert load_model(model) == made.AFTER


def test_a_hostile_file_name_stays_in_the_comment(asked, diagnosed, log, tmp_path):
    strange = log.rename(tmp_path / "a\nroute: {kind: city}\n.log")
    model = tmp_path / "extended.yaml"
    assert diagnosed(strange, "--write-model", model, "--quiet")[0] == 0
    assert load_model(model) == made.AFTER
    assert yaml.safe_load(model.read_text())["route"]["kind"] == made.AFTER.route.kind


def test_the_report_is_one_page_in_its_folder(asked, diagnosed, log, tmp_path):
    folder = tmp_path / "report"
    for _ in range(2):  # a second time too, into the same folder
        status, out, _ = diagnosed(log, "--report", folder)
        assert status == 0
        assert f"written: {folder / 'index.html'}" in out
        assert [p.name for p in folder.iterdir()] == ["index.html"]
    page = (folder / "index.html").read_text()
    assert "drive.log" in page
    assert "passenger_car.yaml" in page


def test_quiet_says_nothing(asked, diagnosed, log, tmp_path):
    out = tmp_path / "result.json"
    assert diagnosed(log, "--json", out, "--quiet") == (0, "", "")
    assert json.loads(out.read_text())["verdict"] == "found"


def test_what_reading_rejected_is_a_note(asked, diagnosed, log):
    lines = log.read_text().splitlines()
    hits = 0
    for i, line in enumerate(lines):
        if " 200#" in line and hits < 20:
            lines[i] = line[:-16] + "00" * 8
            hits += 1
    log.write_text("\n".join(lines) + "\n(16 broken\n")
    status, out, err = diagnosed(log, "--json", "-")
    assert status == 0
    (note,) = [n for n in json.loads(out)["notes"] if "rejected" in n]
    assert "drive.log: " in note
    assert "checksum" in note
    assert f"drive.log:{len(lines) + 1}" in err


def test_why_nothing_could_be_diagnosed_says_what_was_rejected(diagnosed, log):
    lines = log.read_text().splitlines()
    frozen = [f"{line[:-16]}{'00' * 8}" if " 200#" in line else line for line in lines]
    log.write_text("\n".join(frozen) + "\n")
    status, out, err = diagnosed(log, "--quiet")
    assert (status, out) == (1, "")
    assert "valid accelerometer samples: none in the last minute" in err
    assert "drive.log: " in err
    assert "were rejected (checksum" in err


# mistakes ----------------------------------------------------------------------------------------


def refused(diagnosed, asked, *arguments: object) -> str:
    """The one line that says why nothing was begun."""
    status, out, err = diagnosed(*arguments)
    assert (status, out) == (1, "")
    assert err.count("\n") == 1
    assert "drives" not in asked
    return err


@pytest.mark.parametrize("option", ["--json", "--write-model"])
@pytest.mark.parametrize("target", ["nowhere/x", "."])
def test_a_file_that_cannot_be_written_is_reported_first(
    asked, diagnosed, log, tmp_path, option, target
):
    assert "cannot be written" in refused(diagnosed, asked, log, option, tmp_path / target)


@pytest.mark.parametrize("option", ["--json", "--write-model", "--report"])
def test_no_input_is_overwritten(asked, diagnosed, log, simulated, option):
    text = refused(diagnosed, asked, log, option, log)
    assert "would overwrite" in text or "Not a directory" in text
    assert log.read_bytes() == simulated


def test_nor_the_model_that_was_read_nor_one_output_by_another(asked, diagnosed, log, tmp_path):
    model = tmp_path / "model.yaml"
    model.write_text(made.BEFORE.to_yaml())
    options = ("--model", model, "--write-model", model)
    assert "would overwrite" in refused(diagnosed, asked, log, *options)
    same = tmp_path / "same"
    options = ("--json", same, "--write-model", same)
    assert "would overwrite" in refused(diagnosed, asked, log, *options)
    options = ("--json", same, "--report", same)
    assert "would overwrite" in refused(diagnosed, asked, log, *options)
    options = ("--json", "-", "--write-model", "-")
    assert "is given twice" in refused(diagnosed, asked, log, *options)
    assert not same.exists()


def test_a_report_needs_the_folder_above_it(asked, diagnosed, log, tmp_path):
    text = refused(diagnosed, asked, log, "--report", tmp_path / "no" / "where")
    assert "no directory" in text


def test_a_missing_library_is_reported_before_the_work(
    asked, diagnosed, log, tmp_path, monkeypatch
):
    monkeypatch.setattr("imucald.report.page.LIBRARIES", ("no_such_library",))
    text = refused(diagnosed, asked, log, "--report", tmp_path / "report")
    assert ".[report]" in text


@pytest.mark.parametrize("missing", ["log", "model", "config"])
def test_what_is_missing_is_named(asked, diagnosed, log, tmp_path, missing):
    none = tmp_path / "none"
    arguments = {
        "log": (log, none), "model": (log, "--model", none), "config": (log, "--config", none),
    }[missing]  # fmt: skip
    assert f"{none}: cannot be opened" in refused(diagnosed, asked, *arguments)


def test_the_same_log_twice_is_a_mistake(asked, diagnosed, log, tmp_path):
    text = refused(diagnosed, asked, log, tmp_path / "." / log.name)
    assert "given twice" in text
    assert "given twice" in refused(diagnosed, asked, "-", "-")


@pytest.mark.parametrize("change", [
    lambda text: text,
    lambda text: text.replace(b" can0 ", b" can7 "),
    lambda text: text.replace(b"(16000", b"(16111"),
    lambda text: text[: len(text) // 2],
    lambda text: b"".join(text.splitlines(keepends=True)[:4000]) + b"".join(
        text.splitlines(keepends=True)[4020:]
    ),
])  # fmt: skip
def test_one_recording_under_two_names_is_refused(asked, diagnosed, log, tmp_path, change):
    second = tmp_path / "second.log"
    second.write_bytes(change(log.read_bytes()))
    text = refused(diagnosed, asked, log, second)
    assert f"{second}: is the same recording as {log}" in text


def test_a_wrong_model_file_is_reported_with_its_line(asked, diagnosed, log, tmp_path):
    model = tmp_path / "model.yaml"
    model.write_text("chassis:\n  steering_ration: 15\n")
    text = refused(diagnosed, asked, log, "--model", model)
    assert f"{model}:2: chassis.steering_ration" in text


def test_an_installation_without_scipy_says_so(log):
    code = (
        "import sys; sys.modules['scipy'] = None; from imucald import cli; "
        f"sys.exit(cli.main(['diagnose', {str(log)!r}, '--config', {CONFIG!r}]))"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("imucald: diagnose needs the library scipy, which is not")
    assert done.stderr.count("\n") == 1


def test_a_log_without_a_frame_of_ours_is_reported(asked, diagnosed, tmp_path):
    other = tmp_path / "other.log"
    other.write_text("(1.000000) can0 7FF#00\n" * 3)
    assert "no usable frame" in refused(diagnosed, asked, other)


# the terminal ------------------------------------------------------------------------------------


def test_names_are_no_markup_and_long_lists_are_cut(capsys):
    from imucald.diagnosis.result import Candidate

    strange = "[red]bold[/red] [/x]"
    lost = tuple(
        Candidate(f"cause_{i}", "not decidable here", -1.0 - i, strange) for i in range(500)
    )
    print_diagnosis(made.found(candidates=lost, notes=(strange,) * 500, to_separate=strange))
    out = capsys.readouterr().out
    assert strange in out
    assert "488 more causes were not named" in out
    assert "488 more notes" in out
    assert len(out.splitlines()) < 80


SLOW = """
import signal, sys, time, types
def diagnose(drives, model, progress, limit_s):
    print("begun", flush=True)
    time.sleep(60)
module = types.ModuleType("imucald.diagnosis.diagnose")
module.diagnose = diagnose
sys.modules[module.__name__] = module
from imucald import cli
signal.signal(signal.SIGINT, signal.default_int_handler)
sys.exit(cli.main())
"""


def test_ctrl_c_ends_it_in_one_line_and_writes_nothing(log, tmp_path):
    model, out = tmp_path / "model.yaml", tmp_path / "out.json"
    model.write_text(made.BEFORE.to_yaml())
    process = subprocess.Popen(
        [sys.executable, "-c", SLOW, "diagnose", str(log), "--config", CONFIG, "--model",
         str(model), "--json", str(out)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "COLUMNS": "80"},
    )  # fmt: skip
    assert process.stdout.readline() == "begun\n"
    time.sleep(0.1)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=20)
    assert process.returncode == 130
    assert err == "imucald: interrupted\n"
    assert not out.exists()
