"""Under the mouse stands what the curve has there, in its unit."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from matplotlib.figure import Figure

from imucald.report.svg_figures import drawn

SVG = "{http://www.w3.org/2000/svg}"
SIZE_IN = (6.0, 3.0)


def fields(svg: str) -> list[tuple[float, float, list[str]]]:
    """Left edge and width [pt] of each field, and the lines of its title."""
    return [
        (float(rect.get("x", "")), float(rect.get("width", "")), title.text.split("\n"))
        for rect in ET.fromstring(svg).iter(f"{SVG}rect")
        for title in rect.iter(f"{SVG}title")
        if title.text
    ]


def picture(x, curves, scale="linear", **labels: str) -> str:
    def draw(figure: Figure) -> None:
        axes = figure.add_subplot(**labels)
        axes.set_xscale(scale)
        for name, y in curves.items():
            axes.plot(x, y, label=name, color="#123456")
        axes.axhline(0.0)

    return drawn(draw, SIZE_IN)


@pytest.mark.parametrize("scale", ["linear", "log"])
def test_a_field_lies_over_the_point_whose_values_it_has(scale: str) -> None:
    x = (np.geomspace if scale == "log" else np.linspace)(0.1, 50.0, 300)
    curves = {"before": 3.0 * x, "after": -x}
    svg = picture(x, curves, scale, xlabel="time [s]", ylabel="r [m/s²]")
    paths = list(ET.fromstring(svg).iter(f"{SVG}path"))
    curve = next(p.get("d", "") for p in paths if "stroke: #123456" in p.get("style", ""))
    drawn_x = np.array([float(a) for a, _ in re.findall(r"(-?[\d.]+) (-?[\d.]+)", curve)])
    assert np.ptp(drawn_x) > 200.0
    found = fields(svg)
    assert 20 < len(found) <= 6.0 * 72.0 / 7.0
    for left, width, (where, before, after) in found:
        at = float(re.fullmatch(r"time ([\d.]+) s", where)[1])
        assert float(re.fullmatch(r"before ([\d.]+) m/s²", before)[1]) == pytest.approx(
            3.0 * at, rel=0.011
        )
        assert float(re.fullmatch(r"after (-[\d.]+) m/s²", after)[1]) == pytest.approx(
            -at, rel=0.011
        )
        if scale == "log":  # the place of a point, from the ends of the drawn line
            share = math.log(at / x[0]) / math.log(x[-1] / x[0])
        else:
            share = (at - x[0]) / (x[-1] - x[0])
        place = drawn_x.min() + share * np.ptp(drawn_x)
        assert left - 1.0 <= place <= left + width + 1.0


def test_a_hole_of_a_curve_shows_no_values() -> None:
    x = np.arange(1000.0)
    y = np.where((x > 300) & (x < 600), np.nan, 1.0)
    found = fields(picture(x, {"a": y}, xlabel="time [s]", ylabel="[m]"))
    places = [float(lines[0].split()[1]) for _, _, lines in found]
    assert len(places) > 20
    assert not [p for p in places if 300 < p < 600]
    covered = [left + width for left, width, lines in found if float(lines[0].split()[1]) <= 300]
    opened = [left for left, _, lines in found if float(lines[0].split()[1]) >= 600]
    assert min(opened) - max(covered) > 70.0


def test_names_of_curves_and_units_are_text() -> None:
    svg = picture(np.arange(9.0), {"<b>&": np.arange(9.0)}, xlabel='<i> ["&]', ylabel="y [<u>]")
    assert {e.tag for e in ET.fromstring(svg).iter()} & {f"{SVG}b", f"{SVG}i", f"{SVG}u"} == set()
    assert fields(svg)[3][2] == ['<i> 3.00 "&', "<b>& 3.00 <u>"]


def test_rules_and_error_bars_have_no_fields() -> None:
    def draw(figure: Figure) -> None:
        axes = figure.add_subplot()
        axes.axhline(1.0)
        axes.axvline(2.0)
        axes.plot([0.0, 1.0], [0.0, 1.0])
        axes.errorbar(np.arange(9.0), np.arange(9.0), xerr=np.ones(9), fmt="o", label="x")

    assert fields(drawn(draw, SIZE_IN)) == []


def test_a_strip_of_dots_says_how_many_there_are_and_where_they_lie() -> None:
    rng = np.random.default_rng(3)
    x = rng.uniform(-2.0, 2.0, 800)
    y = {"as sent": 3.0 * x + rng.normal(0.0, 0.1, 800), "corrected": x}

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot(xlabel="dv/dt [m/s²]", ylabel="force [m/s²]")
        for name, values in y.items():
            axes.plot(x, values, "o", label=name)

    found = fields(drawn(draw, SIZE_IN))
    assert 20 < len(found) <= 6.0 * 72.0 / 7.0
    counts = 0
    for left, width, (where, *clouds) in found:
        low, high = map(float, re.fullmatch(r"dv/dt (\S+) to (\S+) m/s²", where).groups())
        assert left > 0.0
        assert width == pytest.approx(7.0, abs=1.0)
        middles = {}
        for name, line in zip(y, clouds, strict=True):
            match = re.fullmatch(rf"{name} (\S+) m/s² \((\S+) to (\S+), (\d+)\)", line)
            middles[name] = float(match[1])
            assert float(match[2]) <= middles[name] <= float(match[3])
        counts += int(match[4])
        assert low - 0.01 <= middles["corrected"] <= high + 0.01
        assert middles["as sent"] == pytest.approx(3.0 * 0.5 * (low + high), abs=0.4)
    assert counts == 800


def test_a_cell_of_a_map_has_its_ends_and_its_value_and_lies_where_it_is_drawn() -> None:
    value = np.array([[1.0, np.nan, 3.0], [4.0, 5.0, 6.0]])

    def draw(figure: Figure) -> None:
        axes = figure.add_subplot(xlabel="speed [km/h]", ylabel="turn [m/s²]")
        cells = [0.0, 10.0, 20.0, 30.0], [-2.0, 0.0, 2.0]
        mesh = axes.pcolormesh(*cells, value, cmap="viridis", label="left over [m/s²]")
        figure.colorbar(mesh, ax=axes)

    found = fields(drawn(draw, SIZE_IN))
    left = "speed 0 to 10.0 km/h"
    assert [lines for _, _, lines in found] == [
        [left, "turn -2.00 to 0 m/s²", "left over 1.00 m/s²"],
        ["speed 20.0 to 30.0 km/h", "turn -2.00 to 0 m/s²", "left over 3.00 m/s²"],
        [left, "turn 0 to 2.00 m/s²", "left over 4.00 m/s²"],
        ["speed 10.0 to 20.0 km/h", "turn 0 to 2.00 m/s²", "left over 5.00 m/s²"],
        ["speed 20.0 to 30.0 km/h", "turn 0 to 2.00 m/s²", "left over 6.00 m/s²"],
    ]
    width = found[0][1]
    starts = [start - found[0][0] for start, _, _ in found]
    assert starts == pytest.approx([0.0, 2 * width, 0.0, width, 2 * width], abs=0.3)
