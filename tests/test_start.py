"""The start of a process: quick because it loads nothing that it does not need."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from importlib import resources

from imucald.can.logs.log_reader import CandumpWriter
from imucald.cli import PROCESS_SETTINGS
from simulated_bus import CONFIG, drive_frames

HEAVY = ("can", "scipy", "asammdf", "pandas", "matplotlib", "asyncio", "rich", "cantools.tester",
         "http.server", "subprocess", "paho", "kuksa_client", "foxglove",
         "prometheus_client")  # fmt: skip
"""Each costs 20 ms to a second, or tens of megabytes."""
PROBE = """
import json, os, sys
from imucald.cli import main
status = main(sys.argv[1:])
settings = {k: os.environ.get(k) for k in %r}
print(json.dumps([status, sorted(set(sys.modules) & set(%r)), settings]), file=sys.stderr)
"""


def run(*arguments: str) -> tuple[int, list[str], dict[str, str]]:
    """Run a command in a process of its own: status, heavy modules loaded, process settings."""
    probe = PROBE % (tuple(PROCESS_SETTINGS), HEAVY)
    environment = {k: v for k, v in os.environ.items() if k not in PROCESS_SETTINGS}
    process = subprocess.run(
        [sys.executable, "-c", probe, *arguments],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    status, loaded, settings = json.loads(process.stderr.splitlines()[-1])
    return status, loaded, settings


def test_a_replay_loads_no_heavy_module_and_runs_linear_algebra_on_one_thread(tmp_path):
    log = tmp_path / "short.log"
    with CandumpWriter(log) as writer:
        writer.write_columns(drive_frames().take(slice(0, 2000)))
    out = tmp_path / "out.log"
    status, loaded, settings = run(
        "replay", str(log), "--config", str(CONFIG), "--quiet", "--out", str(out)
    )
    assert status == 0
    assert loaded == []
    assert settings == PROCESS_SETTINGS
    assert out.stat().st_size > 1000


def test_the_daemon_with_its_sockets_loads_no_heavy_module(tmp_path):
    options = ["--seconds", "0.1", "--status-socket", str(tmp_path / "s")]
    where = ["--interface", "socketcan", "--channel", "imucald9"]  # python-can is not needed
    status, loaded, _ = run("run", "--config", str(CONFIG), *where, *options)
    assert status in (0, 1), "no such interface, or no CAN in this kernel"
    assert loaded == []


def test_help_loads_no_numpy_even():
    process = subprocess.run(
        [sys.executable, "-X", "importtime", "-m", "imucald", "--help"],
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = {line.rpartition("|")[2].strip() for line in process.stderr.splitlines()}
    assert "imucald.cli" in loaded
    assert not loaded & {"numpy", "yaml", "cantools", *HEAVY}


def test_cantools_can_be_had_whole_after_a_database_was_read():
    code = (
        "from imucald.runtime.output.output_frames import output_database\n"
        "output_database()\n"
        "import sys\n"
        "print(*(name in sys.modules for name in ('can', 'cantools')))\n"
        "import cantools\n"
        "print(cantools.tester.Tester.__name__, *sys.argv[1:])\n"
        "print(len(cantools.database.load_file(sys.argv[1]).messages))\n"
    )
    file = resources.files("imucald") / "data" / "imucald_out.dbc"
    process = subprocess.run(
        [sys.executable, "-c", code, str(file)], capture_output=True, text=True, check=False
    )
    messages = re.findall(r"^BO_ ", file.read_text("utf-8"), re.M)
    assert process.stderr == ""
    assert process.stdout.splitlines() == [
        "False False",
        f"Tester {file}",
        str(len(messages)),
    ]


def test_metrics_of_daemons_are_collected_without_numpy(tmp_path):
    code = (
        "import sys; from imucald.cli import main; main(sys.argv[1:]);"
        "sys.exit('numpy' in sys.modules)"
    )
    command = [sys.executable, "-c", code, "metrics", "--textfile", str(tmp_path / "m.prom")]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    assert (tmp_path / "m.prom").exists(), "its unit refuses system calls that numpy makes"
