"""Values of curves under the mouse: titles of SVG, which browsers show without a script."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

import numpy as np

from imucald.report.numbers import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

POINTS_PER_INCH = 72.0
FIELD_PT = 7.0
"""Width of a field that has one title: about what a hand points at."""
LABEL = re.compile(r"\s*(?P<name>.*?)\s*(?:\[(?P<unit>[^\]]*)\])?\s*", re.S)
CLOCK = "min:s"
"""The unit of an axis whose formatter writes the values."""


def pointed_values(figure: Figure) -> str:
    """Return SVG groups of unseen fields that lie over a drawn figure's curves, each with a title.

    A field covers the height of its axes; its title is a point of each curve with a unit, as drawn.
    """
    return "".join(map(_fields, figure.axes))


def _fields(axes: Axes) -> str:
    # Rules over the whole width or height have two points; dots without a line are too many.
    curves = [c for c in axes.lines if len(_points(c)) > 2 and c.get_linestyle() != "None"]
    (left, bottom), (right, top) = _place(axes, axes.transAxes.transform([(0, 0), (1, 1)]))
    seen = [_seen(axes, curve, left, right) for curve in curves]
    every = np.unique(np.concatenate([x for x, _ in seen])) if seen else np.zeros(0)
    if len(every) < 2:
        return ""
    count = min(len(every), int((right - left) / FIELD_PT))
    x = every[np.unique(np.linspace(0, len(every) - 1, count).round().astype(np.int64))]
    # A hole of a curve has no field.
    reach = 0.75 * float(np.median(np.diff(x)))
    middle = 0.5 * (x[1:] + x[:-1])
    start = np.maximum(np.concatenate([[left], middle]), x - reach)
    stop = np.minimum(np.concatenate([middle, [right]]), x + reach)
    fields = [
        f'<rect x="{a:.1f}" width="{b - a:.1f}" height="{bottom - top:.0f}">'
        f"<title>{escape(_title(axes, at, curves, seen))}</title></rect>"
        for a, b, at in zip(start, stop, x, strict=True)
    ]
    inside = "\n".join(fields)
    return f'<g class="values" transform="translate(0 {top:.1f})">\n{inside}\n</g>\n'


def _points(curve: Line2D) -> Array:
    """Places of a curve in the units of its axes; (N, 2)."""
    return np.column_stack([
        np.asarray(curve.get_xdata(), float), np.asarray(curve.get_ydata(), float)
    ])  # fmt: skip


def _place(axes: Axes, display: Array) -> Array:
    """Places in the SVG [pt], y down; (N, 2)."""
    figure = axes.get_figure(root=True)
    assert figure is not None  # axes that were drawn belong to a figure
    width, height = POINTS_PER_INCH * figure.get_size_inches()
    share = figure.transFigure.inverted().transform(display)
    return np.column_stack([width * share[:, 0], height * (1.0 - share[:, 1])])


def _seen(axes: Axes, curve: Line2D, left: float, right: float) -> tuple[Array, Array]:
    """Where a curve's points are [pt], and the points, of those that the picture shows."""
    points = _points(curve)
    points = points[np.isfinite(points).all(axis=1)]
    x = _place(axes, axes.transData.transform(points))[:, 0] if len(points) else np.zeros(0)
    inside = (x >= left) & (x <= right)
    order = np.argsort(x[inside], kind="stable")
    return x[inside][order], points[inside][order]


def _title(axes: Axes, at: float, curves: list[Line2D], seen: list[tuple[Array, Array]]) -> str:
    texts, here = [], ""
    unit = _named(axes.yaxis)[1]
    for curve, (x, points) in zip(curves, seen, strict=True):
        i = int(np.argmin(np.abs(x - at))) if len(x) else -1
        if i < 0 or abs(x[i] - at) > 0.5 * FIELD_PT:
            continue
        here = here or _where(axes, float(points[i, 0]))
        label = str(curve.get_label())
        name = _named(axes.yaxis)[0] if not label or label.startswith("_") else label
        texts.append(f"{name} {number(float(points[i, 1]))} {unit}".strip())
    return "\n".join([here, *texts])


def _where(axes: Axes, x: float) -> str:
    """The place along a picture; the lowest of axes that share it has the label."""
    together = axes.get_shared_x_axes().get_siblings(axes)
    axis = next((a.xaxis for a in together if a.get_xlabel()), axes.xaxis)
    name, unit = _named(axis)
    if unit == CLOCK:
        return f"{name} {axis.get_major_formatter()(x, None)}"
    return f"{name} {number(x)} {unit}".strip()


def _named(axis: Axis) -> tuple[str, str]:
    """Name and unit of an axis, from its label `name [unit]`."""
    match = LABEL.fullmatch(axis.get_label_text())
    return (match["name"], match["unit"] or "") if match else (axis.get_label_text(), "")
