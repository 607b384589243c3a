"""Where the vcan tests really run: a kernel with CAN, in a network namespace of their own.

Three grounds, the first that works is taken:

1. this kernel, in a fresh network namespace (root, or any user through a user namespace);
2. this kernel and namespace as they are, where interfaces may be made (containers with rights);
3. User-Mode Linux: Debian's Linux kernel that runs as an ordinary process, with this machine's
   file tree as its root, so that the same interpreter and checkout are there.

A ground runs one pytest process over the given test ids. What came of each test is handed out
through a file of reports, one JSON object per line; a test without reports has failed.
"""

from __future__ import annotations

import functools
import os
import shlex
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from guarded import Guarded
from uml import on_any_processor

REPORTS_VARIABLE = "IMUCALD_VCAN_REPORTS"  # set inside: the file to which reports are written
REQUIRE_VARIABLE = "IMUCALD_REQUIRE_VCAN"  # set to 1 by CI: a missing ground is a failure
UML_MEMORY = "1024M"  # virtual; taken only as used
UML_MODULES = Path("/usr/lib/uml/modules")
UML_CAN_MODULES = (  # in the order in which they need each other
    "net/can/can.ko",
    "net/can/can-raw.ko",
    "drivers/net/can/dev/can-dev.ko",
    "drivers/net/can/vcan.ko",
    "drivers/net/can/vxcan.ko",
)
INNER_LIMIT_S = 1200  # a whole inner run; far above what it takes, below what a CI allows
HANG_TRACE_S = 90  # one test this long: print where every thread stands
REMEDY = (
    "load the module vcan, or apt-get install user-mode-linux kmod iproute2 can-utils"
    " (./try tests does that as root)"
)
SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


@dataclass(frozen=True)
class Ground:
    """A way to run something where vcan interfaces can be made.

    `prefix` is put before the command, or is None for User-Mode Linux.
    """

    name: str
    prefix: tuple[str, ...] | None


@dataclass(frozen=True)
class InnerRun:
    """One started inner pytest process and the folder of its files."""

    folder: Path
    process: Guarded


def which(program: str) -> str | None:
    """Find a program, also in the folders that an ordinary user's PATH leaves out."""
    return shutil.which(program, path=os.environ.get("PATH", "") + ":" + SYSTEM_PATH)


@functools.cache
def find_ground() -> Ground | str:
    """Return the first ground that works here, or the reason why there is none."""
    missing = [program for program in ("ip", "candump", "cansend") if which(program) is None]
    if missing:
        return f"not installed: {', '.join(missing)}; {REMEDY}"
    for name, prefix in (
        ("network namespace", ("unshare", "--net")),
        ("user and network namespace", ("unshare", "--map-root-user", "--net")),
        ("this namespace", ()),
    ):
        if _can_make_vcan(prefix):
            return Ground(name, prefix)
    if which("linux.uml") and which("insmod") and _uml_modules() is not None:
        return Ground("User-Mode Linux", None)
    return f"this kernel offers no CAN and User-Mode Linux is missing; {REMEDY}"


def _can_make_vcan(prefix: Sequence[str]) -> bool:
    probe = "imucprobe"  # an interface name, at most 15 characters
    script = f"ip link add dev {probe} type vcan && ip link del dev {probe}"
    try:
        done = subprocess.run(
            [*prefix, "sh", "-c", script], capture_output=True, timeout=20, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def _uml_modules() -> Path | None:
    """Return the kernel folder of modules that belongs to the installed linux.uml."""
    found = sorted(UML_MODULES.glob("*/kernel/" + UML_CAN_MODULES[0]))
    return found[-1].parents[2] if found else None


def start_inner_pytest(ground: Ground, root: Path, folder: Path, ids: Sequence[str]) -> InnerRun:
    """Start pytest over these test ids on the ground; the folder receives all its files."""
    folder.mkdir(parents=True)
    (folder / "ids.txt").write_text("\n".join(ids) + "\n")
    (folder / "reports.jsonl").touch()
    script = folder / "inner.sh"
    script.write_text(_inner_script(ground, root, folder))
    script.chmod(0o755)
    command = _command(ground, script, folder)
    return InnerRun(folder, Guarded(command, folder / "console.txt"))


def _command(ground: Ground, script: Path, folder: Path) -> list[str]:
    if ground.prefix is not None:
        return [*ground.prefix, str(script)]
    kernel = [
        str(which("linux.uml")),
        f"mem={UML_MEMORY}",
        "rootfstype=hostfs",
        "rootflags=/",
        "rw",
        f"init={script}",
        f"uml_dir={folder}",
        "con=null",
        "con0=fd:0,fd:1",
        "quiet",
    ]
    return on_any_processor(kernel, folder)


def _inner_script(ground: Ground, root: Path, folder: Path) -> str:
    """Return the shell script that runs inside, as process 1 under User-Mode Linux."""
    uml = ground.prefix is None
    lines = ["#!/bin/sh"]
    lines += [f"export {name}={shlex.quote(text)}" for name, text in _environment(folder).items()]
    if uml:
        lines += [
            "mount -t proc proc /proc; mount -t sysfs sysfs /sys; mount -t tmpfs tmpfs /run",
            "mountpoint -q /dev || mount -t devtmpfs devtmpfs /dev",
            "mkdir -p /dev/shm; mount -t tmpfs tmpfs /dev/shm",
            *[f"insmod {_uml_modules()}/{module}" for module in UML_CAN_MODULES],
            "mkdir /run/tmp; export TMPDIR=/run/tmp",  # memory: quick, and gone afterwards
        ]
    pytest = [
        *(sys.executable, "-m", "pytest", "-v", "--color=no", "-o", "addopts="),
        *("-p", "no:cacheprovider"),
        *("-p", "no:xdist", "-o", f"faulthandler_timeout={HANG_TRACE_S}"),
        *("--rootdir", str(root), f"@{folder}/ids.txt"),
    ]
    lines += [
        "ip link set up dev lo",
        f"cd {shlex.quote(str(root))}",
        f"timeout --kill-after=10 {INNER_LIMIT_S} {shlex.join(pytest)}",
        f"echo $? > {shlex.quote(str(folder / 'status'))}",
    ]
    if uml:
        lines += ["sync", "halt -f"]
    return "\n".join(lines) + "\n"


def _environment(folder: Path) -> dict[str, str]:
    """Return the environment inside: like this one where that matters, and nothing else."""
    byte_code = ("PYTHONPYCACHEPREFIX", "PYTHONDONTWRITEBYTECODE")
    kept = ("HOME", "LANG", "VIRTUAL_ENV", "PYTHONPATH", "CI", *byte_code)
    names = [name for name in os.environ if name in kept or name.startswith("IMUCALD_")]
    return {
        **{name: os.environ[name] for name in sorted(names)},
        "PATH": os.environ.get("PATH", "") + ":" + SYSTEM_PATH,
        REPORTS_VARIABLE: str(folder / "reports.jsonl"),
    }
