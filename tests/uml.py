"""User-Mode Linux as the tests start it."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from paths import ROOT

LIBRARY = "uml_registers.so"


def on_any_processor(command: Sequence[str], folder: Path) -> list[str]:
    """The command of linux.uml with `uml_registers.c` preloaded, which is compiled into a folder.

    Without a C compiler the command is as it was: most processors need no more.
    """
    compiler = shutil.which("cc")
    if compiler is None:
        return list(command)
    library, source = folder / LIBRARY, ROOT / "tests" / "uml_registers.c"
    subprocess.run([compiler, "-shared", "-fPIC", "-O2", "-o", library, source], check=True)
    return ["env", f"LD_PRELOAD={library}", *command]
