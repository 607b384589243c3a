"""The .deb, built here, installed on a fresh Debian 12, run, upgraded and removed there."""

from __future__ import annotations

import io
import json
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

import shuttle

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SCRIPT = """
set -e
dpkg -i {package}
test -d /etc/imucald
cp {drive}/shuttle.dbc /etc/imucald/
cp {drive}/shuttle.yaml /etc/imucald/vcan0.yaml
chmod 644 /etc/imucald/*
imucald --version
modprobe vcan
ip link add dev vcan0 type vcan
ip link set up dev vcan0
systemctl enable --now imucald@vcan0
echo "ACTIVE $(systemctl is-active imucald@vcan0)"
sleep 1
echo "STATUS $(imucald status vcan0 --json | tr -d '\\n')"
echo "RECEIVE $(cat /proc/sys/net/core/rmem_max)"
old=$(systemctl show imucald@vcan0 --property=MainPID --value)
dpkg -i {package}
new=$(systemctl show imucald@vcan0 --property=MainPID --value)
[ "$old" != "$new" ] && echo "UPGRADED $(systemctl is-active imucald@vcan0)"
dpkg -r imucald
echo "REMOVED $(systemctl is-active imucald@vcan0)"
[ -e /usr/lib/imucald ] || echo "NOTHING LEFT"
[ -e /etc/imucald/vcan0.yaml ] && echo "CONFIGURATION KEPT"
"""


@pytest.fixture(scope="module")
def package(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if sys.version_info[:2] != (3, 11) or shutil.which("dpkg-deb") is None:
        pytest.skip("the package is built on Debian, with the Python of Debian 12")
    folder = tmp_path_factory.mktemp("deb")
    build = [sys.executable, str(ROOT / "deb/build_deb.py"), "--out", str(folder)]
    subprocess.run(build, check=True, capture_output=True)
    (made,) = folder.glob("imucald_*.deb")
    return made


def test_it_installs_runs_upgrades_and_goes_without_a_trace(package, run_under_systemd, tmp_path):
    drive = tmp_path / "drive"
    drive.mkdir()
    shuttle.write(drive, cycles=1)
    script = SCRIPT.format(package=package, drive=drive)
    outcome = run_under_systemd(script, shared=[package.parent, drive])
    text = outcome.output
    assert outcome.status == 0, text + outcome.console[-1500:]
    facts = dict(line.split(" ", 1) for line in text.splitlines() if line[:3].isupper())
    assert facts["ACTIVE"] == facts["UPGRADED"] == "active"
    assert json.loads(facts["STATUS"])["state"] == "waiting"
    assert int(facts["RECEIVE"]) == 8388608
    assert facts["REMOVED"] == "inactive"
    assert "NOTHING LEFT" in text
    assert "CONFIGURATION KEPT" in text


def listed(package: Path) -> set[str]:
    command = ["dpkg-deb", "--fsys-tarfile", str(package)]
    archive = subprocess.run(command, capture_output=True, check=True).stdout
    with tarfile.open(fileobj=io.BytesIO(archive)) as found:
        return {member.name.removeprefix("./") for member in found if member.isfile()}


def test_the_workbench_brings_what_the_vehicles_package_leaves_out(package: Path) -> None:
    (workbench,) = package.parent.glob("imucald-workbench_*.deb")
    ours, theirs = listed(package), listed(workbench)
    for name in ("scipy", "matplotlib", "jinja2", "aiohttp"):
        place = f"usr/lib/imucald/{name}/__init__.py"
        assert place in theirs
        assert place not in ours
    assert not ours & theirs, "two packages cannot install one file"


def test_without_the_developers_packages_it_says_how_to_run() -> None:
    command = [sys.executable, "-I", "-S", str(ROOT / "deb/build_deb.py"), "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "./try python deb/build_deb.py" in done.stderr
    assert "Traceback" not in done.stderr


def test_it_brings_the_man_page_and_the_completions(package: Path) -> None:
    listing = subprocess.run(
        ["dpkg-deb", "--contents", str(package)], capture_output=True, text=True, check=True
    ).stdout
    for place in (
        "usr/share/man/man1/imucald.1.gz",
        "usr/share/bash-completion/completions/imucald",
        "usr/share/zsh/vendor-completions/_imucald",
        "usr/share/fish/vendor_completions.d/imucald.fish",
    ):
        assert place in listing
