"""Medians, against numpy's, and runs of flags."""

import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucald.core.arrays import median, true_runs


@given(st.lists(st.floats(-1e9, 1e9), min_size=1, max_size=60))
def test_the_median_is_numpys_to_the_last_bit(values):
    assert median(values) == float(np.median(values))


def test_no_value_has_no_median():
    with pytest.raises(ValueError, match="no median"):
        median([])


def test_a_replay_does_not_load_masked_arrays(tmp_path):
    log = tmp_path / "drive.log"
    config = "config/imucald.yaml"
    here = [sys.executable, "-c"]
    made = "import sys; from imucald.cli import main; sys.exit(main())"
    simulate = ["simulate", "--out", str(log), "--minutes", "0.5", "--seed", "3"]
    subprocess.run([*here, made, *simulate], check=True, capture_output=True)
    replayed = (
        "import sys\nfrom imucald.cli import main\ntry: main()\nexcept SystemExit: pass\n"
        "print('numpy.ma' in sys.modules)"
    )
    found = subprocess.run(
        [*here, replayed, "replay", str(log), "--config", config, "--quiet"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.strip().splitlines()[-1] == "False", found.stderr


def test_runs_of_true_flags_begin_and_end_where_they_do():
    flags = np.array([1, 1, 0, 0, 1, 0, 1], dtype=bool)
    assert true_runs(flags).tolist() == [[0, 2], [4, 5], [6, 7]]
    assert true_runs(~flags).tolist() == [[2, 4], [5, 6]]
    assert true_runs(flags[:0]).tolist() == []
