"""Warm start on simulated drives: is a saved mount confirmed, and a turned sensor found out?

    python -m benchmarks.warm_start [--seeds 20] [--minutes 10]

The saved mount is the true one with an error drawn from its own covariance (0.25 deg an axis), or
that turned by 8 deg about z, or by 5 deg about y. Told are false alarms, what was missed, and when.
"""

from __future__ import annotations

import argparse
import math
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from imucald.estimators import estimator_for
from imucald.frames import rotation_from_vector, vector_from_rotation
from imucald.motion.ticks import ticks_from_samples
from imucald.mount.estimate import MountState
from imucald.mount.restored import Phase, RestoredEstimator, StoredMount
from imucald.session import open_config
from imucald.simulation import random_model, simulate

CONFIG = Path(__file__).parent.parent / "config" / "examples" / "simulated.yaml"
STORED_STD = math.radians(0.25)
CASES = {"same": (0.0, 0.0, 0.0), "turned 8 deg": (0, 0, 8.0), "tilted 5 deg": (0, 5.0, 0)}


@dataclass
class Course:
    """Seconds at which phases were reached first, and the error at the end [deg]."""

    reached: dict[Phase, float]
    error: float


def course(rows: list[list[float]], stored: StoredMount, truth: NDArray[np.float64]) -> Course:
    """Run the estimator of the example configuration behind a stored mount."""
    estimator = RestoredEstimator(estimator_for(open_config(CONFIG).config), stored)
    reached: dict[Phase, float] = {}
    for k, row in enumerate(rows):
        estimator.step(row)
        reached.setdefault(estimator.phase, (k + 1) / 10.0)
    assert estimator.correction is not None
    now = np.array(estimator.correction).reshape(3, 3)
    return Course(reached, float(np.degrees(np.linalg.norm(vector_from_rotation(now @ truth.T)))))


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--minutes", type=float, default=10.0)
    options = parser.parse_args()
    found: dict[str, list[Course]] = {case: [] for case in CASES}
    for seed in range(options.seeds):
        drive = simulate(random_model(seed), seed, options.minutes)
        truth = drive.truth.mounts[0][1]
        rows = ticks_from_samples(drive.samples, 0, int(options.minutes * 600)).tolist()
        error = np.random.default_rng(seed).normal(0.0, STORED_STD, 3)
        for case, degrees in CASES.items():
            R = rotation_from_vector(error + np.radians(degrees)) @ truth
            stored = StoredMount(R, np.eye(3) * STORED_STD**2, MountState.FINE)
            found[case].append(course(rows, stored, truth))
    bad = 0
    for case, courses in found.items():
        wanted = Phase.CONFIRMED if case == "same" else Phase.DOUBTED
        wrong = Phase.DOUBTED if case == "same" else Phase.CONFIRMED
        times = [c.reached[wanted] for c in courses if wanted in c.reached]
        wrongly = sum(wrong in c.reached for c in courses)
        bad += wrongly + len(courses) - len(times)
        errors = [c.error for c in courses]
        print(
            f"{case:>12}: {wanted} {len(times)} of {len(courses)}, wrongly {wrong} {wrongly};"
            f" after {np.median(times):.0f} s (at most {max(times):.0f} s);"
            f" error at the end {np.median(errors):.2f} deg (at most {max(errors):.2f})"
        )
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
