"""The drawing of how a sensor sits: every arrow ends where projection says."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imucald import cli
from imucald.report.drawing import AXIS_LENGTH, CENTRE, axes_drawing, drawing, view_drawings
from paths import ROOT

SEEN = {"side": ((1, 0, 0), (0, 0, 1)), "above": ((1, 0, 0), (0, 1, 0)),
        "behind": ((0, -1, 0), (0, 0, 1))}  # fmt: skip
"""By view, the vehicle's way that is to the right of the picture, and that is up."""


def arrow_tips(svg: str) -> dict[str, tuple[float, float]]:
    """By axis, where its arrow ends, from the centre, up positive."""
    found = {}
    for colour, x, y in re.findall(r'fill="var\(--si-([xyz])\)" points="([-\d.]+),([-\d.]+)', svg):
        found[colour] = (float(x) - CENTRE[0], CENTRE[1] - float(y))
    return found


@pytest.mark.parametrize("seed", range(5))
def test_arrows_end_where_the_axes_are_in_each_view(seed):
    R = Rotation.random(rng=np.random.default_rng(seed)).as_matrix()
    for svg, (right, up) in zip(view_drawings(R), SEEN.values(), strict=True):
        tips = arrow_tips(svg)
        assert tips
        for axis, tip in tips.items():
            v = AXIS_LENGTH * R[:, "xyz".index(axis)]
            assert tip == pytest.approx((v @ np.array(right), v @ np.array(up)), abs=0.06)


def test_an_axis_along_the_view_is_a_ring_with_a_dot_or_a_cross():
    side, above, behind = view_drawings(np.eye(3))
    assert set(arrow_tips(side)) == {"x", "z"}  # y points away from who stands to the right
    assert set(arrow_tips(above)) == {"x", "y"}
    assert set(arrow_tips(behind)) == {"y", "z"}
    cross, dot = 'l8 8m0-8l-8 8"', 'r="2.8"'
    assert cross in side
    assert dot not in side
    assert dot in above
    assert cross in behind


def test_without_a_mount_there_is_a_car_and_no_sensor():
    for svg in view_drawings(None):
        assert 'class="car"' in svg
        assert not arrow_tips(svg)
        assert "polygon" not in svg


def test_turns_of_the_drawn_axes_go_the_way_of_the_rotation():
    """The round arrow of each view against a small positive turn of a point, by scipy."""
    views = re.findall(r"<g transform.*?</g>", axes_drawing(), re.S)
    for svg, (right, up), angle in zip(views, SEEN.values(), (1, 2, 0), strict=True):
        sweep = re.search(r'class="turn" d="M([-\d.]+) ([-\d.]+)A46 46 0 1 ([01])', svg)
        assert sweep is not None
        vector = np.eye(3)[angle]
        start = float(sweep[1]) - CENTRE[0], CENTRE[1] - float(sweep[2])
        point = start[0] * np.array(right) + start[1] * np.array(up)
        moved = Rotation.from_rotvec(0.1 * vector).apply(point)
        seen = moved @ np.array(right), moved @ np.array(up)
        to_the_left = start[0] * seen[1] - start[1] * seen[0] > 0.0
        assert int(sweep[3]) == (0 if to_the_left else 1)


def test_files_are_xml_and_need_nothing_else():
    R = Rotation.from_euler("ZYX", [30, -85, 3], degrees=True).as_matrix()
    for svg in (drawing(R, 'a <b> & "c"'), axes_drawing()):
        root = ET.fromstring(svg)
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        assert "href" not in svg
        assert svg.count("http") == 1  # the name space


def test_the_pictures_of_the_docs_are_those_of_the_command(tmp_path, capsys):
    for arguments, name in (
        (["--axes"], "axes.svg"),
        (["--mount", "14,28.5,-10.5"], "sits.svg"),
    ):
        assert cli.main(["draw", *arguments, "--out", str(tmp_path / name)]) == 0
        assert (tmp_path / name).read_text() == (ROOT / "docs" / name).read_text()
    assert "x points forward, 28 deg down and 10 deg right" in capsys.readouterr().out


def test_angles_and_quaternion_of_one_mount_say_the_same(capsys):
    q = Rotation.from_euler("ZYX", [40, -20, 170], degrees=True).as_quat()[[3, 0, 1, 2]]
    assert cli.main(["draw", "--mount", "170,-20,40"]) == 0
    by_angles = capsys.readouterr().out
    assert cli.main(["draw", "--quaternion", ",".join(map(str, q))]) == 0
    assert capsys.readouterr().out == by_angles


@pytest.mark.parametrize(
    "arguments", [["--mount", "1,2"], ["--mount", "1,2,nan"], ["--quaternion", "1,1,0,0"]]
)
def test_what_is_no_mount_is_refused(arguments, capsys):
    assert cli.main(["draw", *arguments]) == 1
    assert arguments[0] in capsys.readouterr().err


def test_a_steep_mount_is_reported_with_its_quaternion(capsys):
    assert cli.main(["draw", "--mount", "10,-86,30"]) == 0
    output = capsys.readouterr().out
    w = math.cos(math.radians(-86 / 2))
    assert "roll plus yaw" in output
    assert "quaternion w x y z" in output
    assert f"{w:+.2f}"[:3] in output
