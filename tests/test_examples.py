"""The examples run for strangers: their own commands, in a copy of a clone, end as they say."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from shutil import copy2
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald import replay
from paths import ROOT

NAMES = sorted(path.stem for path in (ROOT / "config" / "examples").glob("*.yaml"))
COMMAND = re.compile(r"^#   imucald (\w+) (.*)$", re.MULTILINE)
ENDS = re.compile(r"^# Ends: (\w+)(, usable from the first second on)?$", re.MULTILINE)
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a clone would have, and nothing else: files that git ignores are not in it."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", "--",
         "config", "dbc", "daemon"],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if listed.returncode:
        pytest.skip(f"this is no git checkout: {listed.stderr.strip()}")
    folder = tmp_path_factory.mktemp("clone")
    for name in filter(None, listed.stdout.split("\0")):
        if (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            copy2(ROOT / name, folder / name)
    return folder


@pytest.fixture(scope="module")
def imucald(clone: Path) -> Callable[..., str]:
    """Run the clone's imucald in its folder; its output."""
    environment = os.environ | {"PYTHONPATH": str(clone / "daemon"), "NO_COLOR": "1"}

    def run(*arguments: str) -> str:
        done = subprocess.run(
            [sys.executable, "-m", "imucald", *arguments],
            cwd=clone, env=environment, capture_output=True, text=True, timeout=240, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    return run


def replayed(imucald: Callable[..., str], clone: Path, name: str, log: str) -> dict[str, Any]:
    """The JSON of replaying a log with an example."""
    result = clone / f"{name}.json"
    imucald("replay", "--config", f"config/examples/{name}.yaml", log, "--json", str(result))
    found: dict[str, Any] = json.loads(result.read_text())
    return found


def is_true(found: dict[str, Any], truth: dict[str, Any]) -> bool:
    """Whether the truth is within two standard deviations about each axis of the vehicle."""
    mounts = [Rotation.from_quat(mount["quaternion_wxyz"], scalar_first=True)
              for mount in (found["mount"], truth["mount"])]  # fmt: skip
    error = (mounts[0] * mounts[1].inv()).as_rotvec(degrees=True)
    std = np.array([found["mount"]["std_deg"][axis] for axis in "xyz"])
    return bool((np.abs(error) < 2.0 * std).all())


def simulated(imucald: Callable[..., str], clone: Path, name: str) -> list[list[str]]:
    """Run the first command of an example's header; return the others'."""
    header = (clone / "config" / "examples" / f"{name}.yaml").read_text()
    first, *others = [[kind, *shlex.split(rest)] for kind, rest in COMMAND.findall(header)]
    assert [first[0], *(other[0] for other in others)] == ["simulate", "check", "replay"]
    assert all(f"config/examples/{name}.yaml" in line for line in (first, *others))
    imucald(*first)
    return others


@pytest.mark.parametrize("name", NAMES)
def test_an_example_ends_as_its_header_says_and_its_mount_is_the_true_one(
    name: str, clone: Path, imucald: Callable[..., str]
) -> None:
    check, replay = simulated(imucald, clone, name)
    assert "This configuration can be used: no warnings." in imucald(*check, "--strict")
    stated = ENDS.search((clone / f"config/examples/{name}.yaml").read_text())
    assert stated is not None
    result = clone / "result.json"
    imucald(*replay, "--json", str(result))
    found = json.loads(result.read_text())
    assert found["state"] == stated[1]
    if stated[2]:
        assert found["first_usable_s"] < 1.0
    truth = json.loads((clone / "drive.truth.json").read_text())
    assert is_true(found, truth), (found["mount"], truth["mount"])
    assert not is_true(found, {"mount": {"quaternion_wxyz": [1, 0, 0, 0]}})
    assert found["frames"]["rejected"] == {}


def test_values_that_j1939_calls_no_measurement_are_counted_and_nothing_else_happens(
    clone: Path, imucald: Callable[..., str]
) -> None:
    simulated(imucald, clone, "j1939_truck")
    rejected = {"FFFF": "not_available", "FE10": "out_of_range"}
    put = dict.fromkeys(rejected, 0)
    lines = (clone / "drive.log").read_text().splitlines()
    for i in range(0, len(lines), 7):
        head, mark, data = lines[i].partition("18FEF100#")
        if mark:  # CCVS1: the speed stands in bytes 1 and 2, low byte first
            raw = min(put, key=put.__getitem__)
            put[raw] += 1
            lines[i] = f"{head}{mark}{data[:2]}{raw[2:]}{raw[:2]}{data[6:]}"
    (clone / "changed.log").write_text("\n".join(lines) + "\n")
    found = replayed(imucald, clone, "j1939_truck", "changed.log")
    reasons = {reason: put[raw] for raw, reason in rejected.items()}
    assert found["frames"]["rejected"] == reasons
    assert min(put.values()) > 100
    assert found["state"] == "fine"
    assert is_true(found, json.loads((clone / "drive.truth.json").read_text()))


def test_answers_of_other_obd_requests_are_left_alone(
    clone: Path, imucald: Callable[..., str]
) -> None:
    simulated(imucald, clone, "obd_dongle")
    plain = replayed(imucald, clone, "obd_dongle", "drive.log")
    more = []
    for line in (clone / "drive.log").read_text().splitlines():
        more.append(line)
        if "7E8#" in line:  # engine speed, the same of service 02, a negative answer
            head = line.partition("#")[0]
            others = ("04410C1AF8000000", "04420D0055000000", "037F0112AAAAAAAA")
            more += [f"{head}#{data}" for data in others]
    (clone / "more.log").write_text("\n".join(more) + "\n")
    found = replayed(imucald, clone, "obd_dongle", "more.log")
    assert found["mount"] == plain["mount"]
    assert found["frames"]["rejected"] == {}


def test_the_table_has_every_example_with_its_end() -> None:
    table = (ROOT / "config" / "examples" / "README.md").read_text()
    rows = dict(re.findall(r"^\| \[(\w+)\.yaml\]\(\1\.yaml\) .* \| (\w+) \|$", table, re.MULTILINE))
    ends = {}
    for name in NAMES:
        found = ENDS.search((ROOT / "config" / "examples" / f"{name}.yaml").read_text())
        ends[name] = None if found is None else found[1]
    assert rows == ends


def test_the_csv_of_a_phone_becomes_a_log_whose_samples_are_its_rows(tmp_path: Path) -> None:
    rows = tmp_path / "phone.csv"
    rows.write_text(
        "t,AccelX,AccelY,AccelZ,GyroX,GyroY,GyroZ,Speed\n"
        + "".join(
            f"{1.6e9 + k / 50},0.1,-0.2,9.8,0.01,-0.02,{k / 100},{'' if k % 50 else k / 10}\n"
            for k in range(500)
        )
    )
    examples = ROOT / "config" / "examples"
    log, config = tmp_path / "phone.log", tmp_path / "phone.yaml"
    subprocess.run([sys.executable, examples / "phone_csv.py", rows, log], check=True)
    axes = "{x: Phone%s.%sX, y: Phone%s.%sY, z: Phone%s.%sZ}"
    config.write_text(
        f"database: {examples / 'dbc' / 'phone.dbc'}\n"
        "signals:\n"
        f"  accelerometer: {axes % (('Accel',) * 6)}\n"
        f"  gyroscope: {axes % (('Gyro',) * 6)}\n"
        "  speed: PhoneSpeed.Speed\n"
    )
    drive = replay(str(config), log)
    accel, speed = drive.raw("accel").to_pydict(), drive.raw("speed").to_pydict()
    assert [len(accel["t_s"]), len(speed["t_s"])] == [500, 10]
    assert accel["raw_accel_z_mps2"][7] == pytest.approx(9.8, abs=0.001)
    assert accel["t_s"][-1] == pytest.approx(499 / 50, abs=1e-3)
