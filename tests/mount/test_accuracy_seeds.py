"""The accuracy benchmark makes its figures on drives that nothing was tuned on."""

from __future__ import annotations

import subprocess
import sys

import pytest
from benchmarks.mount_accuracy.__main__ import QUICK, SHIFTS, Size
from benchmarks.mount_accuracy.seeds import FIRST_SEED, SHIFTS_APART, TUNING_SEEDS, tuned_on

from paths import ROOT


@pytest.mark.parametrize("size", [Size(), QUICK])
def test_no_part_falls_on_a_seed_of_tuning(size: Size) -> None:
    seeds = size.seeds()
    assert min(seeds) == FIRST_SEED
    assert max(seeds) < FIRST_SEED + 4000
    assert tuned_on(seeds) == []


def test_parts_have_seeds_of_their_own() -> None:
    size = Size()
    shifts = SHIFTS_APART * (len(SHIFTS) - 1) + size.shift_drives
    drives = size.drives + shifts + size.bound_drives + size.long_drives + size.quiet_drives
    assert len(size.seeds()) == drives


def test_a_first_seed_whose_alarms_were_tuned_on_is_refused() -> None:
    """With 5000, the default once, the false alarms came from seeds 8000 to 8299."""
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.mount_accuracy", "--first", "5000", "--only", "cost"],
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert done.returncode == 2
    assert "tuned on (8000 ...)" in done.stderr


def test_seeds_of_tuning_are_listed_in_order_and_once() -> None:
    ends = [end for seeds in TUNING_SEEDS for end in (seeds.start, seeds.stop)]
    assert ends == sorted(ends)
