"""Build .debs for Debian 12: the daemon with the packages it needs, next to the system's Python.

    python deb/build_deb.py [--out DIR]

Debian's own numpy, python-can, cantools and msgspec are older than what imucald needs, so the
package brings those of the environment that builds it, in /usr/lib/imucald, where no other
program finds them. They are compiled for one Python: run this with that of the target (3.11). The
file is reproducible from one environment but for its time stamps.

The second package, imucald-workbench, has the libraries of the commands that a vehicle has no use
for (simulate, demo, diagnose, pages), which the first leaves out.
"""

from __future__ import annotations

import argparse
import compileall
import importlib.metadata
import py_compile
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

try:
    import help_files
    from packaging.requirements import Requirement

    from imucald.core import compiled
except ModuleNotFoundError as missing:
    sys.exit(f"{missing}; run it with the developers' packages: ./try python deb/build_deb.py")

ROOT = Path(__file__).resolve().parents[1]
LIBRARY = "usr/lib/imucald"
LEFT_OUT = frozenset({"scipy"})
"""Larger than all the rest, and not for a vehicle: it is in the workbench."""
EXTRAS = ("diagnostics",)
WORKBENCH_EXTRAS = ("live", "report")
UNWANTED = ("tests", "__pycache__", "include", "_pyinstaller")
"""Folders of packages that a daemon has no use for."""
OWN_UNWANTED = ("kernels",)
"""And of imucald: the sources of its compiled part."""

LAUNCHER = """#!/usr/bin/python3 -IS
import sys

sys.path.insert(0, "/usr/lib/imucald")
from imucald.cli import main

sys.exit(main())
"""
CONTROL = """Package: imucald
Version: {version}
Architecture: {architecture}
Maintainer: imucald <imucald@localhost>
Installed-Size: {size}
Depends: python3 (>= {low}), python3 (<< {high}), libstdc++6, libgcc-s1
Recommends: can-utils
Section: net
Priority: optional
Description: IMU calibration daemon on CAN
 Finds out how an inertial sensor sits in a vehicle, from what the CAN bus carries, and sends its
 signals corrected to vehicle axes. One service per interface: imucald@can0.
"""
WORKBENCH = """Package: imucald-workbench
Version: {version}
Architecture: {architecture}
Maintainer: imucald <imucald@localhost>
Installed-Size: {size}
Depends: imucald (= {version})
Section: net
Priority: optional
Description: libraries for imucald's commands at a desk
 With them imucald simulates, demonstrates and diagnoses, and shows pages: simulate, demo, diagnose,
 replay --report, monitor --web. A vehicle needs the package imucald alone.
"""
POSTINST = """#!/bin/sh
set -e
if [ -d /run/systemd/system ]; then
  systemctl daemon-reload || true
  udevadm control --reload || true
  /usr/lib/systemd/systemd-sysctl /usr/lib/sysctl.d/60-imucald.conf || true
  if [ -n "$2" ]; then
    systemctl try-restart 'imucald@*.service' imucald-metrics-http.service || true
  fi
fi
"""
PRERM = """#!/bin/sh
set -e
if [ "$1" = remove ] && [ -d /run/systemd/system ]; then
  systemctl stop 'imucald@*.service' 'imucald-metrics*' || true
fi
"""
POSTRM = """#!/bin/sh
set -e
if [ -d /run/systemd/system ]; then systemctl daemon-reload || true; fi
if [ "$1" = purge ]; then
  rm -rf /var/lib/private/imucald /var/lib/imucald
  rm -rf /var/cache/private/imucald /var/cache/imucald
fi
"""


def needed(
    extras: tuple[str, ...] = EXTRAS, left_out: frozenset[str] = LEFT_OUT
) -> list[importlib.metadata.Distribution]:
    """The installed distributions that imucald needs with these extras, itself not among them."""
    found: dict[str, importlib.metadata.Distribution] = {}
    open_names = list(_requirements("imucald", extras))
    while open_names:
        name = open_names.pop()
        if name in found or name in left_out:
            continue
        found[name] = importlib.metadata.distribution(name)
        open_names += _requirements(name, ())
    return [found[name] for name in sorted(found)]


def _requirements(name: str, extras: tuple[str, ...]) -> Iterator[str]:
    for text in importlib.metadata.requires(name) or ():
        requirement = Requirement(text)
        wanted = ({"extra": extra} for extra in (*extras, ""))
        if requirement.marker is None or any(requirement.marker.evaluate(e) for e in wanted):
            yield re.sub(r"[-_.]+", "-", requirement.name).lower()


def copy_packages(target: Path) -> None:
    """Copy the daemon and what it needs into one folder, byte-compiled."""
    unwanted = [*UNWANTED, *OWN_UNWANTED]
    if compiled.kernels is None:
        print(f"note: the package has no compiled part: {compiled.state}", file=sys.stderr)
        unwanted.append(f"{compiled.NAME}.*")
    shutil.copytree(
        ROOT / "daemon/imucald", target / "imucald", ignore=shutil.ignore_patterns(*unwanted)
    )
    _copy(needed(), target)


def copy_workbench(target: Path) -> None:
    """Copy what `copy_packages` leaves out of what the commands at a desk need."""
    there = {distribution.name for distribution in needed()}
    more = needed((*EXTRAS, *WORKBENCH_EXTRAS), frozenset())
    _copy([distribution for distribution in more if distribution.name not in there], target)


def _copy(distributions: list[importlib.metadata.Distribution], target: Path) -> None:
    for distribution in distributions:
        for file in distribution.files or ():
            if ".." in file.parts or any(part in UNWANTED for part in file.parts):
                continue
            place = target / file
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(str(file.locate()), place)
    sys.pycache_prefix = None  # beside their sources, whatever the environment says
    ok = compileall.compile_dir(
        target, quiet=2, invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH
    )
    if not ok:
        print("note: some files of the packages are not for this Python", file=sys.stderr)


def build(out: Path) -> list[Path]:
    """Make both packages; return their paths."""
    version = re.search(r'__version__ = "(.+)"', (ROOT / "daemon/imucald/__init__.py").read_text())
    assert version is not None
    architecture = subprocess.run(
        ["dpkg", "--print-architecture"], capture_output=True, text=True, check=True
    ).stdout.strip()
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        copy_packages(tree / LIBRARY)
        install = [sys.executable, "-m", "imucald", "install-service", "--root", str(tree)]
        install += ["--prefix", "/usr", "--exec", "/usr/bin/imucald"]
        subprocess.run(install, check=True, stdout=subprocess.DEVNULL)
        help_files.write(tree / "usr")
        _write(tree / "usr/bin/imucald", LAUNCHER)
        (tree / "etc/imucald").mkdir(parents=True)
        major, minor = sys.version_info[:2]
        fields = {"version": version[1], "architecture": architecture}
        fields |= {"low": f"{major}.{minor}", "high": f"{major}.{minor + 1}"}
        (tree / "DEBIAN").mkdir()
        for name, text in (("postinst", POSTINST), ("prerm", PRERM), ("postrm", POSTRM)):
            _write(tree / "DEBIAN" / name, text)
        workbench = Path(folder) / "workbench"
        copy_workbench(workbench / LIBRARY)
        (workbench / "DEBIAN").mkdir()
        out.mkdir(parents=True, exist_ok=True)
        return [
            _packed(tree, CONTROL, fields, out / f"imucald_{version[1]}_{architecture}.deb"),
            _packed(
                workbench,
                WORKBENCH,
                fields,
                out / f"imucald-workbench_{version[1]}_{architecture}.deb",
            ),
        ]


def _packed(tree: Path, control: str, fields: dict[str, str], package: Path) -> Path:
    size = sum(path.stat().st_size for path in tree.rglob("*") if path.is_file()) // 1024
    (tree / "DEBIAN/control").write_text(control.format(**fields, size=size))
    command = ["dpkg-deb", "--root-owner-group", "-Zgzip", "--build", str(tree), str(package)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return package


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Build the .deb.")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", metavar="DIR")
    parser.add_argument("--packages-only", type=Path, metavar="DIR", help="/usr/lib/imucald alone")
    options = parser.parse_args()
    if options.packages_only is not None:
        copy_packages(options.packages_only)
    else:
        print(*build(options.out), sep="\n")
