"""`imucald install-service`: put the systemd unit and its companions in place."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from imucald.core.errors import ConfigError

UNIT = "imucald@.service"
FILES = {
    UNIT: "lib/systemd/system/imucald@.service",
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
"""Name in the package -> place below PREFIX."""
_PACKAGED = "/usr/bin/imucald"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `install-service`."""
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
        help="root of an image that all paths are put under",
    )
    parser.add_argument(
        "--exec", metavar="COMMAND", help="what the unit runs (default: this interpreter's imucald)"
    )


def run(options: argparse.Namespace) -> int:
    """Write the files; say what was written, and what comes next."""
    from importlib import resources

    command = options.exec or f"{sys.executable} -m imucald"
    data = resources.files("imucald") / "data"
    base = options.root / options.prefix.relative_to(options.prefix.anchor)
    for name, place in FILES.items():
        text = (data / name).read_text("utf-8")
        if name.endswith(".service"):
            for place_before in ("  ", "ExecStart=", "ExecReload="):
                text = text.replace(f"{place_before}{_PACKAGED} ", f"{place_before}{command} ")
        _write(base / place, text)
    if command.startswith(("/home/", "/root/")):
        print(f"note: the unit hides /home and /root, but runs {command}; install it elsewhere")
    print("next: put a configuration in /etc/imucald/can0.yaml, then")
    print("  systemctl daemon-reload && systemctl enable --now imucald@can0")
    return 0


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}; --prefix names another") from None
    print(path)
