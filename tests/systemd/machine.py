"""A machine with systemd as its first process, for tests of the service as it is installed.

User-Mode Linux (a Linux kernel that runs as an ordinary process) boots a minimal Debian folder. The
folder is built once, kept in the user's cache and never written to again: each run sees it through
an overlay in memory, so runs neither disturb one another nor leave anything behind. A run gets
files to put in place, folders of this machine to look at, and one script; what the script printed
and its exit status come back through an exchange folder. A missing status is a failure.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from guarded import Guarded
from uml import on_any_processor

SUITE = "bookworm"
PACKAGES = (
    *("systemd", "systemd-sysv", "dbus", "udev", "kmod", "iproute2"),
    *("python3", "python3-venv", "can-utils"),
)
PROGRAMS = {"linux.uml": "user-mode-linux", "mmdebstrap": "mmdebstrap", "depmod": "kmod"}
UML_MODULES = Path("/usr/lib/uml/modules")
MEMORY = "768M"  # virtual; taken only as used
UNWANTED_UNITS = (  # nothing that a test could need, each a second of its boot
    *("apt-daily.timer", "apt-daily-upgrade.timer", "e2scrub_all.timer", "fstrim.timer"),
    *("dpkg-db-backup.timer", "e2scrub_reap.service", "getty.target", "systemd-logind.service"),
    *("systemd-update-utmp.service", "systemd-update-utmp-runlevel.service"),
    *("systemd-random-seed.service", "systemd-binfmt.service", "modprobe@drm.service"),
)
INIT = "/imucald-init"  # process 1 until systemd takes over


@dataclass(frozen=True)
class Outcome:
    """What a run left: the script's exit status, what it printed, what the machine printed."""

    status: int
    output: str
    console: str


def why_not() -> str | None:
    """Return why such a machine cannot be run here, None when it can."""
    path = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"
    missing = [name for program, name in PROGRAMS.items() if not shutil.which(program, path=path)]
    if missing:
        return f"not installed: apt-get install {' '.join(missing)}"
    if os.geteuid() != 0:
        return "only root can build a Debian folder with files of several owners"
    return None


def debian_root() -> Path:
    """Return the Debian folder, built if the cache has none for these packages and modules."""
    modules = max(UML_MODULES.iterdir())
    recipe = repr((SUITE, PACKAGES, modules.name, _init_script()))
    name = f"systemd-root-{hashlib.sha256(recipe.encode()).hexdigest()[:12]}"
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "imucald"
    cache.mkdir(parents=True, exist_ok=True)
    root = cache / name
    with _locked(cache / "lock"):
        if not root.exists():
            unfinished = cache / f"{name}.unfinished"
            shutil.rmtree(unfinished, ignore_errors=True)
            _build(unfinished, modules)
            unfinished.rename(root)
    return root


@contextmanager
def _locked(file: Path) -> Iterator[None]:
    with file.open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield


def _build(root: Path, modules: Path) -> None:
    include = f"--include={','.join(PACKAGES)}"
    command = ["mmdebstrap", "--quiet", "--variant=minbase", include, SUITE, str(root)]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    inside = root / "usr/lib/modules" / modules.name
    shutil.copytree(modules, inside)
    subprocess.run(["depmod", "--basedir", str(root / "usr"), modules.name], check=True)
    init = root / INIT.lstrip("/")
    init.write_text(_init_script())
    init.chmod(0o755)


def _init_script() -> str:
    """Return what runs first: the overlay, the exchange folder, shared folders, then systemd."""
    return """#!/bin/sh
mount -t proc proc /proc
modprobe overlay
mount -t tmpfs tmpfs /mnt
mkdir /mnt/upper /mnt/work /mnt/root
mount -t overlay overlay -o lowerdir=/,upperdir=/mnt/upper,workdir=/mnt/work /mnt/root
exchange=$(sed -n 's/.*imucald\\.exchange=\\([^ ]*\\).*/\\1/p' /proc/cmdline)
mkdir /mnt/root/exchange
mount -t hostfs -o "$exchange" none /mnt/root/exchange
while read -r folder; do
  mkdir -p "/mnt/root$folder"
  mount -t hostfs -o "ro,$folder" none "/mnt/root$folder"
done < /mnt/root/exchange/shared
cp -a /mnt/root/exchange/files/. /mnt/root/
umount /proc
exec switch_root /mnt/root /sbin/init
"""


def run_machine(
    root: Path,
    folder: Path,
    script: str,
    *,
    files: Mapping[str, str] | None = None,
    shared: Sequence[Path] = (),
    limit: float = 180.0,
) -> Outcome:
    """Boot the Debian folder, run a shell script in it as a unit, and power off.

    folder: an empty folder for what is exchanged. files: absolute path -> content, put in place
    before systemd starts. shared: folders of this machine, seen under the same path, read-only.
    """
    exchange = folder / "exchange"
    _write(exchange / "script", "#!/bin/sh\n" + script, executable=True)
    _write(exchange / "wrapper", _WRAPPER, executable=True)
    _write(exchange / "shared", "".join(f"{path}\n" for path in shared))
    for path, content in {**_UNITS, **(files or {})}.items():
        _write(exchange / "files" / path.lstrip("/"), content)
    console = _boot(root, exchange, limit)
    try:
        status = int((exchange / "status").read_text())
    except (OSError, ValueError):
        status = -1
    output = exchange / "output"
    text = output.read_text(errors="replace") if output.exists() else ""
    return Outcome(status, text, console)


_WRAPPER = """#!/bin/sh
/exchange/script > /exchange/output 2>&1
echo $? > /exchange/status
sync
systemctl poweroff --force --force
"""

_UNITS = {
    "/etc/systemd/system/imucald-test-script.service": """[Unit]
Description=The script of this test run
[Service]
Type=oneshot
ExecStart=/exchange/wrapper
""",
    "/etc/systemd/system/multi-user.target.d/script.conf": """[Unit]
Wants=imucald-test-script.service
""",
}


def _write(path: Path, content: str, executable: bool = False) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content)
    if executable:
        path.chmod(0o755)


def _boot(root: Path, exchange: Path, limit: float) -> str:
    """Run the kernel until it powers off; return what was printed on its console."""
    command = [
        *("linux.uml", f"mem={MEMORY}", "rootfstype=hostfs", f"rootflags={root}", "ro"),
        *(f"init={INIT}", f"imucald.exchange={exchange}", f"uml_dir={exchange}"),
        *("con=null", "con0=fd:0,fd:1", "quiet", "systemd.show_status=auto"),
        *(f"systemd.mask={unit}" for unit in UNWANTED_UNITS),
    ]
    console = exchange / "console"
    machine = Guarded(on_any_processor(command, exchange), console)
    machine.wait(limit)
    machine.end()
    return console.read_text(errors="replace")
