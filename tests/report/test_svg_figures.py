"""Figures are written short, and still draw what they drew."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
from matplotlib.figure import Figure

from imucald.report.svg_figures import drawn, short_path


def points_of(path: str) -> list[tuple[str, float, float]]:
    """Command and place of every point of a path of lines, further points spelled out."""
    found: list[tuple[str, float, float]] = []
    command = ""
    for letter, x, y in re.findall(r"([MLz]?) ?(?:(-?[\d.]+) (-?[\d.]+))?", path):
        command = letter or command
        if x:
            found.append((command, float(x), float(y)))
    return found


def test_a_long_line_goes_through_the_same_places() -> None:
    rng = np.random.default_rng(7)
    x, y = np.arange(300.0) * 2.345678, rng.normal(scale=90.0, size=300)
    path = "".join(
        f"{'L' if i else 'M'} {a:.6f} {b:.6f} \n" for i, (a, b) in enumerate(zip(x, y, strict=True))
    )
    short = short_path(path)
    found = points_of(short)
    assert [command for command, _, _ in found] == ["M"] + ["L"] * 299
    np.testing.assert_allclose([p[1:] for p in found], np.column_stack([x, y]), atol=0.0501)
    assert len(short) < 0.55 * len(path)


def test_points_that_repeat_are_dropped_and_gaps_stay() -> None:
    held = "M 1 2 \n" + "L 3.04 4 \nL 3.01 4 \n" * 50 + "M 9 9 \nL 10 9 \nz\n"
    assert short_path(held) == "M1 2 L3 4 M9 9 L10 9 z"


def test_a_small_marker_keeps_its_shape() -> None:
    assert short_path("M 0 3.125 \nC 0.55 -0.004 1 2 3 4 \nz\n") == "M0 3.12 C0.55 0 1 2 3 4 z"


def test_a_figure_is_short_and_whole() -> None:
    def draw(figure: Figure) -> None:
        t = np.linspace(0.0, 600.0, 4000)
        axes = figure.add_subplot(xlabel="time [s]")
        axes.plot(t, np.sin(t / 20.0))
        axes.plot(t[::40], np.cos(t[::40] / 20.0), "o")

    svg = drawn(draw, (6.0, 3.0))
    assert svg.startswith("<svg")
    assert svg.endswith("</svg>\n")
    assert "time [s]" in svg
    assert svg.count("<use") > 100
    assert len(svg) < 60_000
    assert "rotate(-0" not in svg
    tree = ElementTree.fromstring(
        re.sub(r" xmlns=\"[^\"]+\"", "", svg).replace("xlink:href", "href")
    )
    groups = {len(g.findall("use")): g for g in tree.iter("g") if g.findall("use")}
    assert "#ff7f0e" in groups[100].get("style", "")  # the second curve's colour, said once
    assert all("style" not in use.attrib for use in groups[100].findall("use"))
