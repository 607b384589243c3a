"""How a sensor sits, in words: true at every mount, near 90 deg of pitch too."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald.core.orientation_words import axis_words, leaning_words, sits_words, steep_words

WAYS = {
    "forward": (1, 0, 0), "back": (-1, 0, 0), "left": (0, 1, 0), "right": (0, -1, 0),
    "up": (0, 0, 1), "down": (0, 0, -1),
}  # fmt: skip


def mount(roll: float, pitch: float, yaw: float) -> np.ndarray:
    return Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix()


@pytest.mark.parametrize(
    ("angles", "words"),
    [
        ((0, 0, 0), "x points forward; y points left; z points up"),
        ((0, 0, 90), "x points left; y points back; z points up"),
        ((180, 0, 0), "x points forward; y points right; z points down"),
        ((0, -90, 0), "x points up; y points left; z points back"),
        ((0, -85, 0), "x points up, 5 deg forward; y points left; z points back, 5 deg up"),
        ((0, 10, 0), "x points forward, 10 deg down; y points left; z points up, 10 deg forward"),
        ((0, 0, -30), "x points forward, 30 deg right; y points left, 30 deg forward; z points up"),
        ((5, 0, 0), "x points forward; y points left, 5 deg up; z points up, 5 deg right"),
    ],
)
def test_the_words_of_mounts_that_are_known_by_heart(angles, words):
    assert sits_words(mount(*angles)) == words


def test_the_words_alone_give_the_axis_back_to_a_degree():
    """What is said is enough to sit a sensor by: any axis of any mount, rebuilt from its words."""
    for R in Rotation.random(300, rng=np.random.default_rng(4)).as_matrix():
        for axis in range(3):
            words = axis_words(R, axis)
            way, *leans = re.findall(r"(?:(\d+) deg )?(\w+)", words.replace(" and", ""))
            main = np.array(WAYS[way[1]], float)
            horizontal, rise = main.copy(), 0.0
            for deg, name in leans:
                turn = math.radians(float(deg))
                if name in ("up", "down"):
                    rise = turn if name == "up" else -turn
                else:
                    horizontal += math.tan(turn) * np.array(WAYS[name], float)
            rebuilt = horizontal / np.linalg.norm(horizontal)
            if not main[2]:
                rebuilt = math.cos(rise) * rebuilt + np.array([0, 0, math.sin(rise)])
            assert math.degrees(math.acos(min(1.0, float(rebuilt @ R[:, axis])))) < 1.1, words


def test_before_the_direction_is_known_only_the_lean_is_stated():
    words = leaning_words(mount(0, 30, 77))
    assert words.startswith("x points 30 deg down; y is level; z points 60 deg up")
    assert words.endswith("which way is forward is not known yet")
    assert words == leaning_words(mount(0, 30, -140))


@pytest.mark.parametrize(("pitch", "sign"), [(89.0, -1.0), (-89.0, 1.0)])
def test_beyond_seventy_degrees_roll_and_yaw_are_stated_to_be_one(pitch, sign):
    quaternion = Rotation.from_euler("ZYX", [20, pitch, 10], degrees=True).as_quat()[[3, 0, 1, 2]]
    words = steep_words(math.radians(pitch), quaternion)
    assert words is not None
    assert " ".join(f"{q:+.4f}" for q in quaternion) in words
    assert ("roll plus yaw" if sign > 0 else "roll minus yaw") in words
    # the truth of the sentence: turning both by 30 deg changes next to nothing, one alone does
    both = mount(10 + 30, pitch, 20 - sign * 30) @ mount(10, pitch, 20).T
    alone = mount(10 + 30, pitch, 20) @ mount(10, pitch, 20).T
    assert Rotation.from_matrix(both).magnitude() < math.radians(1.0)
    assert Rotation.from_matrix(alone).magnitude() > math.radians(29.0)
    assert steep_words(math.radians(69.0), quaternion) is None
