"""The compiled part: loops in C, where a C compiler was there when the package was installed.

Everything works without it, to the last bit the same, but slowly: frames and samples are then taken
one by one in Python, which is also what the kernels are held against. `setup.py` builds it from
`core/kernels`; it is loaded here and nowhere else. Each kernel has its Python version next to the
place that calls it::

    kernels = compiled.kernels
    if kernels is not None:
        kernels.candump(...)
        return ...

`kernels` is None where the library is not there, cannot be loaded, was built from other sources
than those that lie next to it, or takes sums in another order than this numpy; and with
IMUCALD_COMPILED=0 in the environment.

A kernel takes numpy arrays as they are and checks their types and shapes itself; it raises
ValueError where one does not fit. It keeps none of them.
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

import numpy as np

SWITCH: Final = "IMUCALD_COMPILED"
"""Set to 0 it leaves the compiled part out: it is not loaded, and not built."""
NAME: Final = "_kernels"
SOURCES: Final = Path(__file__).with_name("kernels")
"""Of a checkout; an installed package is without them."""

Kernel = Callable[..., int]

_HUGE, _ENDLESS, _ONE = np.array([1e300]), np.array([np.inf]), np.array([1.0])
_TYPES: Final = {"o": ctypes.py_object, "i": ctypes.c_long, "d": ctypes.c_double}


class Kernels:
    """The functions of the library.

    Each has its arguments below, as letters: o an array, i a whole number, d a float. What they
    mean stands next to the function in `core/kernels`.
    """

    add_cross_spectra: Kernel
    add_steps: Kernel
    band_products: Kernel
    block_sums: Kernel
    candump: Kernel
    count_manoeuvres: Kernel
    creep_filters: Kernel
    find_step: Kernel
    fit_segments: Kernel
    free_of_angles: Kernel
    fused_means: Kernel
    gravity_sums: Kernel
    gyro_energies: Kernel
    hop_figures: Kernel
    judge_frames: Kernel
    large_turns: Kernel
    left_over: Kernel
    less_angle: Kernel
    masked_sums: Kernel
    match_frames: Kernel
    microseconds: Kernel
    near_steps: Kernel
    pair_sums: Kernel
    push_window: Kernel
    rail_hops: Kernel
    renew_levels: Kernel
    renewed_gains: Kernel
    scores: Kernel
    signal_column: Kernel
    signal_pairs: Kernel
    span_changes: Kernel
    steering_sums: Kernel
    stream_times: Kernel
    sums: Kernel
    tapered: Kernel
    tick_sums: Kernel
    turn_samples: Kernel
    turned_alone: Kernel
    vehicle_axes: Kernel
    vertical: Kernel
    window_weights: Kernel
    yaw_sums: Kernel

    ARGUMENTS: Final = {
        "add_cross_spectra": "oodooo",
        "add_steps": 6 * "o",
        "band_products": "oooooio",
        "block_sums": 6 * "o",
        "candump": "oi" + 16 * "o",
        "count_manoeuvres": "oooio",
        "creep_filters": 11 * "o",
        "find_step": "oooooiiooo",
        "fit_segments": 12 * "o",
        "free_of_angles": 8 * "o",
        "fused_means": "ooooooodooo",
        "gravity_sums": 8 * "o" + "do",
        "gyro_energies": 7 * "o",
        "hop_figures": 13 * "o",
        "judge_frames": "ooood" + 7 * "o",
        "large_turns": "ooido",
        "left_over": 6 * "o",
        "less_angle": 11 * "o",
        "masked_sums": "ooo",
        "match_frames": 6 * "o",
        "microseconds": "oo",
        "near_steps": "ooio",
        "pair_sums": "oooio",
        "push_window": 11 * "o" + "do",
        "rail_hops": "oi" + 11 * "o",
        "renew_levels": 8 * "o" + "dioo",
        "renewed_gains": 7 * "o",
        "scores": 7 * "o" + "ioo",
        "signal_column": 8 * "o",
        "signal_pairs": 14 * "o" + "iio",
        "span_changes": 8 * "o",
        "steering_sums": "ooooddo",
        "stream_times": "oioo",
        "sums": "ooo",
        "tapered": "oooio",
        "tick_sums": "oooido",
        "turn_samples": 5 * "o",
        "turned_alone": 8 * "o",
        "vehicle_axes": "ooooooio",
        "vertical": 9 * "o" + "diiii" + 5 * "o",
        "window_weights": "oooodo",
        "yaw_sums": "oooooddoo",
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
"""Whether it is used, in words: "in use", or why not."""


def slow_words() -> str:
    """That results take long without the compiled part, and why it is not used; "" where it is."""
    if kernels is not None:
        return ""
    return (
        f"slow, as there is no compiled part ({state}): results are the same, a replay takes some "
        "15 times as long; with gcc and python3-dev at installation it is built"
    )


def load(folder: Path, sources: Path = SOURCES) -> tuple[Kernels | None, str]:
    """The library of a folder, and what is to be said of it."""
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
    if not _sums_agree(found):
        return None, "takes sums in another order than this numpy"
    return found, "in use"


def _sums_agree(found: Kernels) -> bool:
    """Whether sums of the library are those of this numpy, whose order no document fixes."""
    for shape in ((3, 200), (200, 3)):
        terms = 1.0 / np.arange(1.0, 1.0 + shape[0] * shape[1]).reshape(shape)
        rows, columns = np.empty(shape[0]), np.empty(shape[1])
        found.sums(terms, rows, columns)
        if (rows != terms.sum(axis=1)).any() or (columns != terms.sum(axis=0)).any():
            return False
    return True


def stamp(sources: Path) -> int:
    """A number that changes with the sources; the library says that of those it was built from."""
    found = 0
    for file in sorted(sources.iterdir()):
        if file.suffix in (".c", ".h"):
            found = zlib.crc32(file.read_bytes(), found)
    return found


def note(flags: int) -> None:
    """Have numpy say what a kernel met, as its `errstate` asks for: it warns, or raises."""
    if flags & 1:
        np.multiply(_HUGE, _HUGE)
    if flags & 2:
        np.subtract(_ENDLESS, _ENDLESS)
    if flags & 4:
        np.divide(_ONE, 0.0)


@contextmanager
def left_out() -> Iterator[None]:
    """Do without the compiled part for a while; for tests, in one thread."""
    global kernels  # noqa: PLW0603
    kept, kernels = kernels, None
    try:
        yield
    finally:
        kernels = kept


kernels, state = load(Path(__file__).parent)
