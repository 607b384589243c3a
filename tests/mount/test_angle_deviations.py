"""The ± beside roll, pitch and yaw is that of the angle itself; truth by sampled rotations."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.core.rotations import rotation_from_angles
from imucald.mount.angle_deviations import angle_deviations
from imucald.mount.estimate import MountEstimate, MountState
from imucald.mount.mount_words import angle_text
from imucald.runtime.summary import mount_dict
from imucald.service.running_status import status_line

DEG = math.radians(1.0)
STD = np.array([1.0, 0.3, 0.5])
TURNED = Rotation.from_euler("ZYX", [40.0, -25.0, 65.0], degrees=True).as_matrix()
COVARIANCES = {
    "uncorrelated": np.diag(STD**2),
    "correlated": TURNED @ np.diag(STD**2) @ TURNED.T,
}


def sampled_deviations(angles_deg: tuple[float, float, float], covariance_deg2: np.ndarray):
    """Rms [deg] and share within two stated deviations of roll, pitch, yaw of sampled mounts."""
    roll, pitch, yaw = angles_deg
    mount = Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True)
    rng = np.random.default_rng(7)
    turns = rng.multivariate_normal(np.zeros(3), covariance_deg2, 40_000)
    found = (Rotation.from_rotvec(turns, degrees=True) * mount).as_euler("ZYX", degrees=True)
    off = (found[:, ::-1] - angles_deg + 180.0) % 360.0 - 180.0
    return np.sqrt(np.mean(off**2, axis=0)), off


def stated(angles_deg: tuple[float, float, float], covariance_deg2: np.ndarray) -> np.ndarray:
    R = rotation_from_angles(*np.radians(angles_deg))
    return np.array(angle_deviations(R, (covariance_deg2 * DEG**2).tolist())) / DEG


@pytest.mark.parametrize("kind", COVARIANCES)
@pytest.mark.parametrize(
    "angles",
    [(0, 0, 0), (14, 28.5, -10.5), (20, -5, 90), (170, 10, -135), (-60, 60, 45), (5, -75, 100)],
)
def test_deviations_are_those_of_sampled_mounts(angles, kind):
    expected, off = sampled_deviations(angles, COVARIANCES[kind])
    found = stated(angles, COVARIANCES[kind])
    assert found == pytest.approx(expected, rel=0.03)
    inside = np.mean(np.abs(off) <= 2.0 * found, axis=0)
    assert inside == pytest.approx([0.9545] * 3, abs=0.008)


def test_at_a_yaw_of_90_deg_the_pitch_is_off_by_the_turn_about_x():
    found = stated((0.0, 0.0, 90.0), np.diag(STD**2))
    assert found == pytest.approx([STD[1], STD[0], STD[2]])


@pytest.mark.parametrize("pitch", [85.0, -88.0, 89.9, 90.0])
def test_near_90_deg_of_pitch_roll_and_yaw_are_not_known(pitch):
    roll, of_pitch, yaw = stated((10.0, pitch, 20.0), np.diag([1.0, 1.0, 1.0]))
    assert roll == yaw == math.inf
    assert of_pitch == pytest.approx(1.0)


def test_where_the_first_order_is_stated_it_holds():
    """Just within the limit: 95 % intervals hold nine times in ten and more."""
    for pitch, std in ((79.0, 1.0), (87.0, 0.29), (60.0, 3.2)):
        covariance = np.diag([std, std, std]) ** 2
        found = stated((0.0, pitch, 30.0), covariance)
        assert np.isfinite(found).all()
        _, off = sampled_deviations((0.0, pitch, 30.0), covariance)
        assert (np.mean(np.abs(off) <= 2.0 * found, axis=0) > 0.93).all()


def test_without_a_heading_roll_and_pitch_are_as_bad_as_the_worse_of_x_and_y():
    covariance = np.diag([1.0, 0.3, 104.0]) ** 2
    assert stated((5.0, 0.0, 77.0), covariance).tolist() == pytest.approx([1.0, 1.0, math.inf])


def test_what_is_printed_and_written_belongs_to_the_angle():
    R = rotation_from_angles(0.0, 0.0, math.pi / 2)
    estimate = MountEstimate(MountState.USABLE, R, np.diag((STD * DEG) ** 2))
    mount = mount_dict(estimate)
    assert mount["std_deg"] == {"x": 1.0, "y": 0.3, "z": 0.5}
    assert mount["angle_std_deg"] == {"roll": 0.3, "pitch": 1.0, "yaw": 0.5}
    assert "pitch +0.00 ±2.00°; yaw +90.00 ±1.00°" in status_line(estimate, "up")
    steep = MountEstimate(
        MountState.USABLE, rotation_from_angles(0.1, 1.55, 0.2), np.diag((STD * DEG) ** 2)
    )
    found = mount_dict(steep)["angle_std_deg"]
    assert found["roll"] is None
    assert found["yaw"] is None
    assert 0.3 < found["pitch"] < 0.5
    assert "roll not known; pitch +88.81 ±" in status_line(steep, "up")
    assert angle_text(81.64, None) == "-"
