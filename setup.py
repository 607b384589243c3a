"""The compiled part of the package (`imucald.core.compiled`); all else stands in pyproject.toml.

Where Python's headers are there and no C compiler is, as in many containers, the build brings one:
zig's, a wheel of 100 MB. The part is optional: a package whose part cannot be compiled is installed
without it, and works the same.
IMUCALD_COMPILED=0 leaves it out, and the compiler too, which gives a wheel for every processor.
"""

import os
import shutil
import sys
import sysconfig
import zlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

FOLDER = Path("daemon/imucald/core/kernels")
FLUSHING = ("-Ofast", "-ffast-math", "-funsafe-math-optimizations")
"""With these in CFLAGS gcc links what flushes small numbers to zero, in the whole process."""
ZIG = [sys.executable, "-m", "ziglang", "cc", "-mcpu=baseline"]
"""Without the last, it compiles for the processor at hand alone."""
LEFT_OUT = os.environ.get("IMUCALD_COMPILED") == "0"


def has_compiler() -> bool:
    """Whether the compiler that setuptools would call is there."""
    words = (os.environ.get("CC") or sysconfig.get_config_var("CC") or "cc").split()
    return os.name != "posix" or any(shutil.which(word) for word in words[:1])


def has_headers() -> bool:
    """Whether Python's headers are there; Debian has them in a package of their own."""
    return (Path(sysconfig.get_path("include")) / "Python.h").exists()


class BuildKernels(build_ext):
    """Compiles the files side by side: one after another they take 5 s.

    Always all of them: an installed library lies beside no sources to tell that it is of others,
    and dates of files do not tell it either.
    """

    def build_extension(self, ext):
        """As it is, but for the compiler."""
        Path(self.get_ext_fullpath(ext.name)).unlink(missing_ok=True)
        if linker := getattr(self.compiler, "linker_so", None):
            self.compiler.linker_so = [flag for flag in linker if flag not in FLUSHING]
        if not has_compiler():
            linker = [*ZIG, "-shared"]
            self.compiler.set_executables(compiler_so=[*ZIG, "-fPIC"], linker_so=linker)
        one = self.compiler.compile

        def several(sources, **options):
            with ThreadPoolExecutor(os.cpu_count()) as pool:
                made = list(pool.map(lambda source: one([source], **options), sources))
            return [name for names in made for name in names]

        self.compiler.compile = several
        super().build_extension(ext)


def stamp() -> int:
    """As `imucald.core.compiled.stamp`; to import that would load what is to be built."""
    found = 0
    for file in sorted(FOLDER.iterdir()):
        if file.suffix in (".c", ".h"):
            found = zlib.crc32(file.read_bytes(), found)
    return found


def kernels() -> Extension:
    """The library. No flag may change what a sum of doubles comes to."""
    return Extension(
        "imucald.core._kernels",
        sources=sorted(str(file) for file in FOLDER.glob("*.c")),
        depends=sorted(str(file) for file in FOLDER.glob("*.h")),
        define_macros=[("STAMP", f"{stamp()}ul")],
        extra_compile_args=[
            "-std=c11",
            "-O2",
            "-g0",
            "-fno-fast-math",
            "-ffp-contract=off",
            "-fvisibility=hidden",
        ],
        libraries=["m"],
        optional=True,
    )


if __name__ == "__main__":
    setup(
        ext_modules=[] if LEFT_OUT else [kernels()],
        setup_requires=["ziglang"] if not LEFT_OUT and has_headers() and not has_compiler() else [],
        cmdclass={"build_ext": BuildKernels},
    )
