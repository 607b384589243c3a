"""The compiled part: loops in C. The compiled part exists if a C compiler was available when the
package was installed.

Without the compiled part, all functions give bit-identical results, but slowly: lines of candump
and protected frames are processed one by one in Python. Tests compare the kernels with the Python
version. `setup.py` builds the library from `core/kernels`, and only this module loads it. The
Python version of each kernel stands next to the call::

    kernels = compiled.kernels
    if kernels is not None:
        kernels.candump(...)
        return ...

`kernels` is None in four cases: the library is missing, it cannot be loaded, it was built from
sources that differ from the present sources, or the environment has IMUCALD_COMPILED=0.

A kernel takes numpy arrays directly and checks their types and shapes itself. A kernel raises
ValueError if an array does not fit. A kernel does not use an array after the call.
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
"""Environment variable. With the value 0, the compiled part is neither loaded nor built."""
NAME: Final = "_kernels"
SOURCES: Final = Path(__file__).with_name("kernels")
"""Folder of the C sources in a checkout. An installed package has no sources."""

Kernel = Callable[..., int]

_TYPES: Final = {"o": ctypes.py_object, "i": ctypes.c_long, "d": ctypes.c_double}


class Kernels:
    """The functions of the compiled library.

    The letters below are the types of the arguments: o is an array, i an integer, d a float. The
    files in `core/kernels` document the arguments of each function.
    """

    candump: Kernel
    judge_frames: Kernel

    ARGUMENTS: Final = {
        "candump": "oi" + 16 * "o",
        "judge_frames": "ooood" + 7 * "o",
    }

    def __init__(self, library: ctypes.PyDLL) -> None:
        for name, letters in self.ARGUMENTS.items():
            function = getattr(library, name)
            function.argtypes = [_TYPES[letter] for letter in letters]
            function.restype = ctypes.c_long
            setattr(self, name, function)


kernels: Kernels | None = None
"""The loaded compiled part, or None."""
state = ""
"""State of the compiled part in words: "in use", or the reason why it is not used."""


def slow_words() -> str:
    """Return a note that the program is slow without the compiled part, with the reason; "" if the
    compiled part is used.
    """
    if kernels is not None:
        return ""
    return (
        f"slow: the compiled part is missing ({state}). Results are the same, but a replay "
        "takes several times as long. Install gcc and python3-dev, then install imucald again"
    )


def load(folder: Path, sources: Path = SOURCES) -> tuple[Kernels | None, str]:
    """Load the library in a folder. Return its functions (None if not usable), and the state in
    words."""
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
    """Return a checksum of the C sources. The library contains the checksum of the sources from
    which it was built.
    """
    found = 0
    for file in sorted(sources.iterdir()):
        if file.suffix in (".c", ".h"):
            found = zlib.crc32(file.read_bytes(), found)
    return found


@contextmanager
def left_out() -> Iterator[None]:
    """Disable the compiled part within the context. For tests with one thread."""
    global kernels  # noqa: PLW0603
    kept, kernels = kernels, None
    try:
        yield
    finally:
        kernels = kept


kernels, state = load(Path(__file__).parent)
