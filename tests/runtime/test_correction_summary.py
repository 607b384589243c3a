"""What JSON, Python and screens say of the correction and of what it leaves."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.api.mount import CorrectionResult
from imucald.mount.estimate import Correction, MountEstimate, MountState, SentDeviations
from imucald.mount.mount_words import sent_words
from imucald.runtime.summary import correction_dict

R = Rotation.from_euler("ZYX", [40.0, -6.0, 3.0], degrees=True).as_matrix()


def test_an_estimate_of_matrices_and_offsets_is_printed_with_the_deviations_it_states():
    W, V = R + 0.01, R - 0.02
    known = MountEstimate(
        MountState.FINE,
        R,
        np.eye(3),
        matrices=Correction.with_matrices(R, W, V, [0.1, -0.2, 0.3], [0.01, 0.0, -0.02]),
        deviations=SentDeviations(*np.radians([0.3, 0.1, 0.4, 0.6]), 0.05, 0.08, 0.01, math.inf),
    )
    found = CorrectionResult.from_summary(correction_dict(known))
    assert found is not None
    f = np.array([1.0, -2.0, 9.5])
    assert found.matrix @ f - found.offset_mps2 == pytest.approx(W @ f - [0.1, -0.2, 0.3], abs=1e-6)
    assert found.gyro_matrix @ f - found.gyro_offset_rad_s == pytest.approx(
        V @ f - [0.01, 0.0, -0.02], abs=1e-6
    )
    assert found.cross_talk_std_deg == pytest.approx({"xy": 0.3, "yx": 0.1, "zx": 0.4, "zy": 0.6})
    assert found.zero_std_mps2 == pytest.approx([0.05, 0.08])
    assert found.gyro_cross_talk_std_deg["xz"] == pytest.approx(math.degrees(0.01), abs=1e-4)
    assert math.isnan(found.gyro_cross_talk_std_deg["yz"])
    assert sent_words(correction_dict(known)) == (
        "cross-talk xy ±0.60° yx ±0.20° zx ±0.80° zy ±1.20°, level zero ±0.10 ±0.16 m/s², "
        "rate xz ±1.15° yz -"
    )


def test_of_a_rotation_alone_both_matrices_are_it_and_nothing_is_taken_off():
    known = MountEstimate(MountState.USABLE, R, np.diag(np.radians([0.9, 0.4, 0.2]) ** 2))
    found = correction_dict(known)
    assert found is not None
    assert set(found) == {
        "matrix", "offset_mps2", "cross_talk_std_deg", "zero_std_mps2", "gyro_matrix",
        "gyro_offset_rad_s", "gyro_cross_talk_std_deg",
    }  # fmt: skip
    assert found["matrix"] == found["gyro_matrix"]
    assert np.array(found["matrix"]) == pytest.approx(R, abs=1e-7)
    assert found["offset_mps2"] == found["gyro_offset_rad_s"] == [0.0, 0.0, 0.0]
    assert found["cross_talk_std_deg"] == {"xy": 0.2, "yx": 0.2, "zx": 0.4, "zy": 0.9}


def test_before_there_is_an_estimate_there_is_none():
    assert correction_dict(MountEstimate(MountState.WAITING)) is None
    assert CorrectionResult.from_summary(None) is None
    assert sent_words(None) == ""
    without = correction_dict(MountEstimate(MountState.LEVELLED, R))
    assert sent_words(without) == ""
