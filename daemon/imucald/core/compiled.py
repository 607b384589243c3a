"""The compiled part: loops in C, present if a C compiler was there when the package was installed.

Everything works without it, with the same bits, but slowly. Frames and samples are then taken one
by one in Python. Tests compare the kernels with this Python version. `setup.py` builds the library
from `core/kernels`, and only this module loads it. Each kernel has its Python version next to the
call::

    kernels = compiled.kernels
    if kernels is not None:
        kernels.candump(...)
        return ...

`kernels` is None in four cases: the library is missing, it cannot be loaded, it was built from
other sources than those next to it, or the environment has IMUCALD_COMPILED=0.

A kernel takes numpy arrays directly and checks their types and shapes itself. A function raises
ValueError if an array does not fit. A function keeps no array after the call.
"""

from __future__ import annotations

import ctypes
import os
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import Final

SWITCH: Final = "IMUCALD_COMPILED"
"""With the value 0, the compiled part is neither loaded nor built."""
NAME: Final = "_kernels"
SOURCES: Final = Path(__file__).with_name("kernels")
"""Sources in a checkout; an installed package has none."""

Kernel = Callable[..., int]

_TYPES: Final = {"o": ctypes.py_object, "i": ctypes.c_long, "d": ctypes.c_double}


class Kernels:
    """The functions of the library.

    The letters below are the arguments of each function: o an array, i a whole number, d a float.
    `core/kernels` documents their meaning at each function.
    """

    candump: Kernel
    hop_figures: Kernel
    judge_frames: Kernel
    rail_hops: Kernel
    tick_sums: Kernel

    ARGUMENTS: Final = {
        "candump": "oi" + 16 * "o",
        "hop_figures": 13 * "o",
        "judge_frames": "ooood" + 7 * "o",
        "rail_hops": "oi" + 11 * "o",
        "tick_sums": "oooido",
    }

    def __init__(self, library: ctypes.PyDLL) -> None:
        for name, letters in self.ARGUMENTS.items():
            function = getattr(library, name)
            function.argtypes = [_TYPES[letter] for letter in letters]
            function.restype = ctypes.c_long
            setattr(self, name, function)


kernels: Kernels | None = None
"""The compiled part, or None."""
state = ""
"""State of the compiled part in words: "in use", or the reason why not."""


def slow_words() -> str:
    """Return a note that results take long without the compiled part, and why; "" if the part is
    used.
    """
    if kernels is not None:
        return ""
    return (
        f"slow: the compiled part is missing ({state}). Results are the same, but a replay "
        "takes several times as long. Install gcc and python3-dev, then install imucald again"
    )


def load(folder: Path, sources: Path = SOURCES) -> tuple[Kernels | None, str]:
    """Return the library of a folder, and its state in words."""
    if os.environ.get(SWITCH) == "0":
        return None, f"switched off by {SWITCH}=0"
    names = (folder / (NAME + suffix) for suffix in EXTENSION_SUFFIXES)
    file = next((name for name in names if name.exists()), None)
    if file is None:
        return None, "not built"
    try:
        library = ctypes.PyDLL(str(file))
        library.stamp.restype = ctypes.c_ulong
        if sources.is_dir() and library.stamp() != stamp(sources):
            return None, "built from other sources"
        found = Kernels(library)
    except (OSError, AttributeError) as error:
        return None, f"cannot be loaded: {error}"
    return found, "in use"


def stamp(sources: Path) -> int:
    """Return a number that changes with the sources.

    The library contains the number of its own sources.
    """
    found = 0
    for file in sorted(sources.iterdir()):
        if file.suffix in (".c", ".h"):
            found = zlib.crc32(file.read_bytes(), found)
    return found


@contextmanager
def left_out() -> Iterator[None]:
    """Disable the compiled part for a while; for tests, in one thread."""
    global kernels  # noqa: PLW0603
    kept, kernels = kernels, None
    try:
        yield
    finally:
        kernels = kept


kernels, state = load(Path(__file__).parent)
