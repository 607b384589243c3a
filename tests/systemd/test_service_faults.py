"""The installed service under real faults: systemd is process 1, frames pass a kernel's CAN.

All scenes (see scenario.py) play on one machine, one after the other: a boot costs more than they.
"""

from __future__ import annotations

import itertools
import json
import statistics
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from machine import Outcome, run_machine

import shuttle

pytestmark = pytest.mark.slow

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
LIMIT_S = 1800.0
"""It hangs; the scenes took 730 s beside ten others' work on two processors."""
USABLE_AGAIN_S = 2.0
RESUME_S = 1.0
OVER_BARE = 1.25
"""On a machine where even a bare Python with the same libraries needs longer than RESUME_S for its
start as a unit (an emulated kernel beside other tests does), at most a quarter longer than it.

Each attempt stands between two bare starts, and the longer of the two counts: load comes in spells
of several attempts. The middle one of all attempts is held to a quarter. A single one is off by
chance as much as one bare start is beside its neighbour, which the same run shows: where bare
starts next to one another took 1.4 and 2.7 s, so may ours."""
OVER_BARE_KILLED = 1.5
"""The same after a kill, where the mount is judged again besides: 2.46 s where a bare start took
2.06 s (the middle ones of ten on a machine with ten others' work)."""
MOST_RESTARTS = 10
"""In a minute."""

STARTER = """#!/usr/bin/python3 -IS
import sys
sys.path.insert(0, "/usr/lib/imucald")
from imucald.cli import main
sys.exit(main())
"""
"""As the Debian package has it."""
HANGING = """#!/usr/bin/python3 -IS
import pathlib, sys, time
sys.path.insert(0, "/usr/lib/imucald")
from imucald.cli import main
from imucald.service.live import Daemon
serve_once = Daemon.serve_once
def hanging(self, *arguments):
    if pathlib.Path("/run/imucald/vcan0/hang").exists():
        pathlib.Path("/run/imucald/vcan0/hang").unlink()
        time.sleep(1000)
    return serve_once(self, *arguments)
Daemon.serve_once = hanging
sys.exit(main(sys.argv[1:]))
"""
SCRIPT = """
cp -r {packages} /usr/lib/imucald && chmod -R a+rX /usr/lib/imucald || exit 3
mkdir -p /etc/imucald && cp {drive}/shuttle.* /etc/imucald/ && cd /etc/imucald || exit 4
mv shuttle.yaml vcan0.yaml && chmod 755 . && chmod 644 * || exit 5
chmod 755 /usr/bin/imucald
exec python3 -u /opt/scenario.py
"""


@pytest.fixture(scope="module")
def outcome(systemd_root: Path, tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    if sys.version_info[:2] != (3, 11):
        pytest.skip("the machine's Python is 3.11, and runs this environment's packages")
    folder = tmp_path_factory.mktemp("machine")
    drive = tmp_path_factory.mktemp("drive")
    shuttle.write(drive, cycles=3)
    packages = tmp_path_factory.mktemp("packages") / "imucald"
    build = [sys.executable, str(ROOT / "deb/build_deb.py"), "--packages-only", str(packages)]
    subprocess.run(build, check=True, capture_output=True)
    files = {
        "/opt/scenario.py": (HERE / "scenario.py").read_text(),
        "/usr/bin/imucald": STARTER,
        "/usr/bin/imucald-hanging": HANGING,
    }
    script = SCRIPT.format(packages=packages, drive=drive)
    shared = [packages, drive]
    return run_machine(systemd_root, folder, script, files=files, shared=shared, limit=LIMIT_S)


def scene(outcome: Outcome, name: str) -> dict[str, Any]:
    for line in outcome.output.splitlines():
        if line.startswith("RESULT "):
            found = json.loads(line.removeprefix("RESULT "))
            if name in found:
                return dict(found[name])
    text = f"{outcome.output[-6000:]}\n{outcome.console[-1500:]}"
    pytest.fail(f"no result of {name} (status {outcome.status}):\n{text}")


def late(found: dict[str, Any], limit: float, share: float) -> list[str]:
    """What took longer than the limit [s] and than this share of a bare start, see `OVER_BARE`."""
    times, peer = found["times"], found["peer"]
    pairs = list(itertools.pairwise(peer))
    chance = max(max(pair) / min(pair) for pair in pairs)
    of_bare = [took / max(pair) for took, pair in zip(times, pairs, strict=True)]
    out = [
        f"{took:.2f} s beside bare starts of {pair[0]:.2f} and {pair[1]:.2f} s"
        for took, ratio, pair in zip(times, of_bare, pairs, strict=True)
        if took >= limit and ratio >= share * chance
    ]
    if statistics.median(times) >= limit and statistics.median(of_bare) >= share:
        out.append(f"the middle one, {statistics.median(times):.2f} s")
    return out


def in_words(times: list[float]) -> str:
    """For `pytest -rP`, where the figures of docs/service.md come from."""
    return f"median {statistics.median(times):.2f}, at most {max(times):.2f}, of {len(times)}"


def test_it_starts_with_the_interface_as_nobody_in_particular(outcome):
    found = scene(outcome, "begin")
    assert found["active"] == "active"
    assert "waiting" in found["status"]
    assert found["user"] != "root"
    assert found["mode"] == "0o700"
    assert float(found["exposure"].split(": ")[1].split()[0]) <= 1.5


def test_it_calibrates_from_the_bus_and_says_so_in_its_status_line(outcome):
    found = scene(outcome, "calibrate")
    assert found["state"] in {"usable", "fine"}
    assert abs(found["yaw"] - 25.0) < 3.0
    assert found["generation"] >= 1
    assert found["status"].startswith(found["state"])
    assert "yaw +2" in found["status"]


def test_after_a_kill_it_is_usable_again_within_two_seconds_from_its_state(outcome):
    found = scene(outcome, "killed")
    print("usable after a kill [s]:", in_words(found["times"]))
    print("a bare Python with its libraries starts in [s]:", in_words(found["peer"]))
    assert not late(found, USABLE_AGAIN_S, OVER_BARE_KILLED), "the machine does not explain that"
    assert found["quality"] == 1
    assert found["restarts"] == len(found["times"])
    assert found["kept"] == 3, "configuration, inputs and outputs, as they were read"


def test_a_hung_loop_is_killed_by_the_watchdog_and_restarted(outcome):
    found = scene(outcome, "hung")
    assert found["restarts"] == 1
    assert found["said"]
    assert found["took"] < 40.0, "3 s of the watchdog, the rest is a busy host"


def test_no_loop_starts_it_more_than_ten_times_a_minute_and_the_first_restart_is_at_once(outcome):
    found = scene(outcome, "crash_loop")
    print("first restart after a crash [s]:", round(found["first"], 2))
    assert found["first"] < USABLE_AGAIN_S
    assert 4 < found["restarts"] <= MOST_RESTARTS
    assert found["active"] == "active", "it goes on when its cause is gone"


def test_what_systemd_cannot_start_is_started_again_later_unless_it_is_stopped(outcome):
    found = scene(outcome, "no_folder")
    assert found["code"] == "239", "the folder of the cache could be made"
    assert found["restarts"] == 0
    assert found["again"] < 40.0
    assert found["waits"] == "active"
    assert found["stopped"] in ("inactive", "failed")


def test_a_database_too_large_for_the_unit_changes_nothing_on_reload_and_makes_no_loop(outcome):
    found = scene(outcome, "heavy_database")
    assert found["same_process"]
    assert found["refused"] != 0, "systemctl reload fails"
    assert found["code"] == "78"
    assert found["told"]
    assert found["restarts"] == 0


def test_root_gives_orders_to_the_sandboxed_daemon_and_nobody_else_does(outcome):
    found = scene(outcome, "ordered")
    assert found["mode"] == "0o600"
    assert found["others"][0] == 1
    assert "run it as root: sudo" in found["others"][1]
    assert found["state"] in {"usable", "fine"}
    assert found["hold"][0] == 0, found["hold"]
    assert (found["held"], found["held_after"]) == (True, True), "a hold outlasts a restart"
    assert found["release"][0] == 0, found["release"]
    assert found["set"][0] == 0, found["set"]
    assert found["yaw"] == pytest.approx(25.0, abs=0.01)
    assert found["events"][0] == 0, "everybody may read them"
    for text in (found["events"][1], found["journal"]):
        assert "set-mount: roll +0, pitch +0, yaw +25 deg" in text
        assert "(by root (pid " in text
    assert found["quiet"] == [7, ""], "nothing comes on the bus"
    assert (found["reset"][0], found["after"]) == (0, "waiting")


def test_the_units_for_prometheus_write_and_serve_what_the_daemon_says(outcome):
    found = scene(outcome, "metrics")
    assert not found["without_collector"], "a folder that is not there is not made"
    assert found["mode"] == "0o644"
    assert found["timer"] == "active"
    for text in (found["text"], found["http"]):
        assert 'imucald_up{bus="vcan0"} 1' in text
        assert 'imucald_mount_angle_degrees{bus="vcan0",angle="yaw"} 2' in text


def test_in_a_namespace_of_its_own_it_reaches_one_bus_and_sends_what_is_let_through(outcome):
    found = scene(outcome, "one_interface")
    assert found["active"] == "active"
    assert found["interfaces"] == ["lo", "vcan0"]
    assert found["allowed"]
    assert not found["foreign"]
    assert found["other"] != 0


def test_reloading_keeps_process_and_estimate_and_refuses_nonsense(outcome):
    found = scene(outcome, "reloaded")
    assert found["same_process"]
    assert found["refused"] != 0
    assert found["told"]
    assert found["active"] == "active"
    assert len(set(found["yaw"])) == 1
    assert found["yaw"][0] is not None


def test_it_stops_within_a_second_with_its_state_saved(outcome):
    found = scene(outcome, "stopped")
    assert found["took"] < 1.5, "a second, and what systemd takes to tell"
    assert found["files"] == ["0", "1"]
    assert found["result"] == "success"
    assert found["yaw"][0] == pytest.approx(found["yaw"][1], abs=1e-6)
    assert found["state"] == "restored"


def test_it_comes_and_goes_with_its_interface(outcome):
    found = scene(outcome, "interface_lost")
    assert max(found["down"]) < RESUME_S
    print("frames back after a new interface [s]:", in_words(found["times"]))
    print("a bare Python with its libraries starts in [s]:", in_words(found["peer"]))
    assert not late(found, RESUME_S, OVER_BARE), "the machine does not explain that"
    assert found["same_process"]


def test_a_stepped_wall_clock_moves_nothing(outcome):
    found = scene(outcome, "clock_stepped")["found"]
    for other in found[1:]:
        assert other == pytest.approx(found[0], abs=0.01)


def test_a_corrupt_state_is_set_aside_and_reported(outcome):
    found = scene(outcome, "corrupted")
    assert (found["state"], found["quality"]) == ("waiting", 0)
    assert len(found["problems"]) == len(found["aside"]) == 2
    assert found["told"]


def test_a_wrong_configuration_is_reported_and_not_tried_again_and_again(outcome):
    found = scene(outcome, "misconfigured")
    assert found["active"] == "failed"
    assert found["code"] == "78"
    assert found["told"]
