"""The unit as installed: systemd's own checks of it."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

EXPOSURE_LIMIT = 1.5


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """The folder of units that `install-service` fills, as for a system."""
    if shutil.which("systemd-analyze") is None:
        pytest.skip("not installed: systemd")
    command = [sys.executable, "-m", "imucald", "install-service", "--root", str(tmp_path)]
    done = subprocess.run(
        [*command, "--exec", "/bin/true"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    units = tmp_path / "usr/local/lib/systemd/system"
    # an instance, as the checks look at one
    shutil.copy(units / "imucald@.service", units / "imucald@can0.service")
    return units


def analyze(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["systemd-analyze", *arguments], capture_output=True, text=True, check=False
    )


def test_the_exposure_is_small(installed):
    unit = str(installed / "imucald@can0.service")
    limit = f"--threshold={EXPOSURE_LIMIT * 10:.0f}"
    done = analyze("security", "--offline=true", limit, unit)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Overall exposure level" in done.stdout
    hopeless = analyze("security", "--offline=true", "--threshold=1", unit)
    assert hopeless.returncode != 0, "the threshold is not obeyed here: the test proves nothing"


def test_systemd_finds_no_mistake(installed):
    done = analyze("verify", str(installed / "imucald@can0.service"))
    assert (done.returncode, done.stderr) == (0, "")
    unit = installed / "imucald@can0.service"
    unit.write_text(unit.read_text().replace("WatchdogSec", "WatchdogSecs"))
    assert "WatchdogSecs" in analyze("verify", str(unit)).stderr


def test_the_unit_for_another_start_is_sound(installed):
    shutil.copy(installed / "imucald-again@.service", installed / "imucald-again@can0.service")
    done = analyze("verify", str(installed / "imucald-again@can0.service"))
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("name", ["imucald-metrics.service", "imucald-metrics-http.service"])
def test_the_units_for_prometheus_are_sound_and_sandboxed(installed, name):
    done = analyze("verify", str(installed / name))
    assert (done.returncode, done.stderr) == (0, "")
    done = analyze("security", "--offline=true", "--threshold=30", str(installed / name))
    assert done.returncode == 0, done.stdout
    assert "ExecStart=/bin/true metrics --" in (installed / name).read_text()
    done = analyze("verify", str(installed / "imucald-metrics.timer"))
    assert (done.returncode, done.stderr) == (0, "")


def test_all_that_is_named_is_installed(installed):
    prefix = installed.parents[2]
    names = {str(path.relative_to(prefix)) for path in prefix.rglob("*") if path.is_file()}
    assert names >= {
        "lib/sysctl.d/60-imucald.conf",
        "lib/udev/rules.d/70-imucald.rules",
        "share/imucald/80-can0-classic.network.example",
        "share/imucald/80-can0-fd.network.example",
        "share/imucald/imucald_out.dbc",
        "share/imucald/imucald-bus@.service.example",
        "share/imucald/imucald-alerts.yml",
        "share/imucald/imucald-grafana.json",
    }
    start = "\n  /bin/true run --config /etc/imucald/%i.yaml --interface socketcan"
    unit = (installed / "imucald@.service").read_text()
    assert start in unit
    assert "\nExecReload=/bin/true run --check --config /etc/imucald/%i.yaml\n" in unit
    assert "/usr/bin/imucald" not in unit
