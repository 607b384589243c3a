"""`imucald install-service`: install the systemd unit and its additional files."""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from collections.abc import Iterable
from pathlib import Path

from imucald.core.errors import ConfigError

FILES = {
    "imucald@.service": "lib/systemd/system/imucald@.service",
    "imucald-again@.service": "lib/systemd/system/imucald-again@.service",
    "imucald-metrics.service": "lib/systemd/system/imucald-metrics.service",
    "imucald-metrics.timer": "lib/systemd/system/imucald-metrics.timer",
    "imucald-metrics-http.service": "lib/systemd/system/imucald-metrics-http.service",
    "imucald-alerts.yml": "share/imucald/imucald-alerts.yml",
    "imucald-grafana.json": "share/imucald/imucald-grafana.json",
    "imucald-bus@.service.example": "share/imucald/imucald-bus@.service.example",
    "60-imucald.sysctl.conf": "lib/sysctl.d/60-imucald.conf",
    "70-imucald.udev.rules": "lib/udev/rules.d/70-imucald.rules",
    "80-can0-classic.network.example": "share/imucald/80-can0-classic.network.example",
    "80-can0-fd.network.example": "share/imucald/80-can0-fd.network.example",
    "imucald_out.dbc": "share/imucald/imucald_out.dbc",
    "imucald_example.yaml": "share/imucald/imucald_example.yaml",
}
"""From the name of each file in the package to its path below PREFIX."""
_PACKAGED = "/usr/bin/imucald"
HIDDEN = tuple(map(Path, ("/home", "/root", "/run/user", "/tmp", "/var/tmp")))
"""Folders that a unit cannot see because of ProtectHome=yes and PrivateTmp=yes."""

_REMEDY = (
    "Install imucald into another folder, for example with: "
    "sudo python3 -m venv /opt/imucald && sudo /opt/imucald/bin/pip install . "
    "Then run: sudo /opt/imucald/bin/imucald install-service"
)
_REMEDY_IMAGE = "Name the program of the image, for example: --exec /opt/imucald/bin/imucald"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `install-service`."""
    parser.epilog = (
        "Writing to the system needs root: sudo imucald install-service. The program must not "
        "be installed under /home, /root or /tmp, since systemd hides these folders from the "
        "units."
    )
    parser.add_argument(
        "--prefix",
        type=Path,
        default=Path("/usr/local"),
        metavar="DIR",
        help="install below DIR/lib and DIR/share (default: /usr/local)",
    )
    parser.add_argument(
        "--root",
        type=Path,
        default=Path("/"),
        metavar="DIR",
        help="write into an image: all paths are put under DIR (default: /, this system). If the "
        "image has its program elsewhere, name that with --exec",
    )
    parser.add_argument(
        "--exec",
        metavar="COMMAND",
        help="command that the unit runs (default: the imucald that you call now)",
    )


def run(options: argparse.Namespace) -> int:
    """Write the files. Print the written files and the next steps."""
    from importlib import resources

    command = options.exec or f"{sys.executable} -m imucald"
    data = resources.files("imucald") / "data"
    package = [] if options.exec else [str(Path(__file__).parents[1])]
    _refuse_hidden([*_words(command)[:1], *package], options.root)
    base = options.root / options.prefix.relative_to(options.prefix.anchor)
    for name, place in FILES.items():
        text = (data / name).read_text("utf-8")
        if name.endswith(".service"):
            for place_before in ("  ", "ExecStart=", "ExecReload="):
                text = text.replace(f"{place_before}{_PACKAGED} ", f"{place_before}{command} ")
        _write(base / place, text)
    print("next: put the configuration in /etc/imucald/can0.yaml, its databases next to it, then")
    print("  sysctl --system && udevadm control --reload")
    print("  systemctl daemon-reload && systemctl enable --now imucald@can0")
    print("the send queue is set when an interface is added: for an interface that exists already,")
    print("restart the machine or load the interface's driver again")
    return 0


def _words(command: str) -> list[str]:
    try:
        found = shlex.split(command)
    except ValueError as error:
        raise ConfigError(f"--exec {command!r}: {error}") from None
    if not found:
        raise ConfigError("--exec names no program")
    return found


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except PermissionError as error:
        raise ConfigError(f"{path}: {error.strerror}; run it with sudo") from None
    except OSError as error:
        text = f"{error.strerror or error}; name another folder with --prefix"
        raise ConfigError(f"{path}: {text}") from None
    print(path)


def _refuse_hidden(programs: Iterable[str], root: Path) -> None:
    """Raise ConfigError if a systemd unit could not see one of these files, or the target of its
    symbolic link. The links of an image are not followed."""
    is_image = root != Path("/")
    for program in map(Path, filter(os.path.isabs, programs)):
        for path in (program, program if is_image else program.resolve()):
            if hiding := [str(folder) for folder in HIDDEN if path.is_relative_to(folder)]:
                raise ConfigError(
                    f"the service would run {path}, but systemd hides {hiding[0]} from it. Nothing "
                    f"was written. {_REMEDY_IMAGE if is_image else _REMEDY}"
                )
