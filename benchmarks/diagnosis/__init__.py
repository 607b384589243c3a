"""Does the diagnosis name what is hidden? Drives of the second generator, and measured logs."""

import os
import sys

from benchmarks.measured import ROOT

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # the matrices are small
sys.path.insert(0, str(ROOT / "tests"))  # where the second generator lives
