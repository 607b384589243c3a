"""`imucald demo`: the whole chain on a virtual bus ends near the truth, the same every time."""

from __future__ import annotations

import html
import math
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald import cli
from imucald.can.logs.log_reader import LogReader
from imucald.commands.demo_drive import Demonstration, angles_beside
from imucald.core.rotations import rotation_from_angles
from imucald.mount.estimate import MountEstimate, MountState
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine
from imucald.simulation import random_model, simulate
from imucald.simulation.drive import Drive
from imucald.traffic.can_log import write_log
from imucald.traffic.drive_encoder import BusEncoder, example_config
from paths import ROOT

MOUNT_DEG = (-20.0, 8.0, 120.0)


def short_drive(minutes: float, seed: int = 2) -> Drive:
    mount = dict(zip(("roll_deg", "pitch_deg", "yaw_deg"), MOUNT_DEG, strict=True))
    changes = {f"mount.{name}": angle for name, angle in mount.items()}
    return simulate(random_model(seed).with_changes(changes), seed, minutes)


@pytest.fixture(scope="module")
def finished() -> Demonstration:
    with Demonstration(short_drive(4.0), example_config()) as demo:
        for _ in demo.run():
            pass
        return demo


@pytest.mark.slow
def test_the_estimate_ends_near_the_truth(finished: Demonstration) -> None:
    angles = angles_beside(finished.estimate(), finished.truth)
    assert [a.name for a in angles] == ["roll", "pitch", "yaw"]
    for angle, truth in zip(angles, MOUNT_DEG, strict=True):
        assert math.degrees(angle.truth) == pytest.approx(truth)
        assert abs(math.degrees(angle.error)) < 2.0
        assert abs(angle.error) < 4.0 * angle.std
    assert finished.engine.pipeline.first_usable is not None


def test_every_frame_passes_the_bus_undamaged() -> None:
    with Demonstration(short_drive(0.3), example_config()) as demo:
        for _ in demo.run():
            pass
        series = demo.drive.samples["accel"]
        assert demo.listener.frames == len(series.t) > 1000
        assert demo.listener.damaged == 0
        assert demo.engine.router.rejected.total() == 0
        assert demo.link.counters.conflicts == 0


@pytest.mark.slow
def test_corrected_acceleration_is_near_the_truth_as_far_as_noise_allows(
    finished: Demonstration,
) -> None:
    found = finished.compare()
    assert found is not None
    assert found.measured > 3.0
    assert found.corrected < 0.2 * found.measured
    assert found.corrected < 1.5 * found.known_mount


@pytest.mark.slow
def test_replay_of_the_same_drive_gives_the_same_estimate(
    finished: Demonstration, tmp_path: Path
) -> None:
    log = tmp_path / "drive.log"
    write_log(finished.drive, log, BusEncoder(example_config()))
    engine = make_engine(example_config())
    result = Replay(engine, LogReader([log], engine.router.matches)).run()
    ours, theirs = finished.estimate(), engine.pipeline.estimator.estimate()
    assert theirs.R_vehicle_from_sensor is not None
    assert np.array_equal(ours.R_vehicle_from_sensor, theirs.R_vehicle_from_sensor)
    assert result["state"] == ours.state.name.lower()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_demonstration() -> None:
    def values() -> list[tuple[float, ...] | None]:
        with Demonstration(short_drive(0.3), example_config()) as demo:
            assert len(list(demo.run())) == pytest.approx(0.3 * 60 * 4, abs=2)
            return [tuple(s.estimate.angles or ()) for s in demo.snapshots]

    assert values() == values()


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.5, 1.2, -2.0), (3.1, -0.3, 3.1)])
def test_errors_are_those_of_the_angles_at_any_yaw_and_across_180_deg(
    mount: tuple[float, ...],
) -> None:
    """As often inside two deviations as a normal distribution is."""
    R = rotation_from_angles(*mount)
    std = np.array([0.004, 0.002, 0.003])
    rng = np.random.default_rng(1)
    inside = []
    for vector in std * rng.standard_normal((4000, 3)):
        real = Rotation.from_rotvec(-vector) * Rotation.from_matrix(R)
        truth = real.as_matrix()
        estimate = MountEstimate(MountState.USABLE, R, np.diag(std**2))
        found = angles_beside(estimate, truth)
        off = np.array(mount) - real.as_euler("ZYX")[::-1]
        off = np.arctan2(np.sin(off), np.cos(off))
        assert [a.error for a in found] == pytest.approx(off, abs=1e-9)
        inside.append([a.inside for a in found])
    assert np.mean(inside, axis=0) == pytest.approx([0.9545] * 3, abs=0.012)


def test_an_unknown_angle_is_left_out() -> None:
    covariance = np.diag([1e-4, 1e-4, math.inf])
    estimate = MountEstimate(MountState.LEVELLED, np.eye(3), covariance)
    assert [a.name for a in angles_beside(estimate, np.eye(3))] == ["roll", "pitch"]
    assert angles_beside(MountEstimate(MountState.WAITING), np.eye(3)) == []


# the command -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_prints_lines_and_the_result(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    svg = tmp_path / "demo.svg"
    arguments = ["demo", "--seed", "2", "--minutes", "0.5", "--mount", "-5,3,30"]
    assert cli.main([*arguments, "--svg", str(svg)]) == 1  # half a minute is not enough for yaw
    text = capsys.readouterr().out
    assert "0:15" in text
    assert "0:30" in text
    assert "-5.00°" in text
    assert "imucald check" in text
    assert svg.read_text().startswith("<svg")


@pytest.mark.slow
def test_the_picture_of_the_readme_is_todays_and_ends_fine(tmp_path: Path) -> None:
    """Its own command makes it again; last digits and bars may differ from machine to machine."""
    kept = (ROOT / "docs" / "demo.svg").read_text("utf-8")
    (command,) = re.findall(r"<metadata>imucald (.*) FILE</metadata>", kept)
    made = tmp_path / "demo.svg"
    assert cli.main([*command.split(), str(made)]) == 0

    def texts(svg: str) -> list[str]:
        found = re.findall(r"<text [^>]*>(.*?)</text>", svg)
        return [text for text in map(html.unescape, found) if not set(text) & set("▁▂▃▄▅▆▇█")]

    number = re.compile(r"[+-]?\d+\.\d+")
    ours, theirs = texts(kept), texts(made.read_text("utf-8"))
    remake = f"made again by: imucald {command} docs/demo.svg"
    assert [number.sub("#", t) for t in ours] == [number.sub("#", t) for t in theirs], remake
    values = [[float(x) for t in found for x in number.findall(t)] for found in (ours, theirs)]
    assert values[0] == pytest.approx(values[1], abs=0.02), remake
    assert "fine" in ours


@pytest.mark.parametrize(
    ("arguments", "words"),
    [(["--mount", "1,2"], "--mount"), (["--minutes", "0"], "--minutes"),
     (["--minutes", "nan"], "--minutes"), (["--mount", "a,b,c"], "--mount")],
)  # fmt: skip
def test_wrong_options_are_reported(
    arguments: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["demo", *arguments]) == 1
    assert words in capsys.readouterr().err


@pytest.mark.slow
def test_interrupting_on_a_terminal_stops_cleanly() -> None:
    """Ctrl-C in the live picture: status 130, one line, the cursor is shown again."""
    leader, follower = pty.openpty()
    command = [sys.executable, "-m", "imucald", "demo"]
    with subprocess.Popen(command, stdout=follower, stderr=follower, stdin=follower) as process:
        os.close(follower)
        seen = b""
        end = time.monotonic() + 30.0
        while b"km/h" not in seen and b"standing" not in seen and time.monotonic() < end:
            seen += _read(leader)
        process.send_signal(signal.SIGINT)
        while chunk := _read(leader):
            seen += chunk
        assert process.wait(10.0) == 130
    os.close(leader)
    assert b"Traceback" not in seen
    assert b"interrupted" in seen
    assert seen.rindex(b"\x1b[?25h") > seen.rindex(b"\x1b[?25l")


def _read(descriptor: int) -> bytes:
    ready, _, _ = select.select([descriptor], [], [], 10.0)
    try:
        return os.read(descriptor, 65536) if ready else b""
    except OSError:  # the other end is closed
        return b""


def test_package_data_is_all_that_it_needs() -> None:
    """What an installed package has: the data folder holds every file that the demo reads."""
    data = Path(sys.modules["imucald"].__file__ or "").parent / "data"
    loaded = example_config()
    assert loaded.path is not None
    assert loaded.path.parent == data
    assert [loaded.database_path(entry).exists() for entry in loaded.config.database] == [True]
    assert {p.name for p in data.glob("*.dbc")} == {"imucald_example.dbc", "imucald_out.dbc"}
