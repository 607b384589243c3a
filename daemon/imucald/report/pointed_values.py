"""Add SVG titles to pictures, so that browsers show values at the mouse pointer without a script.

For a curve, the title shows the values of its point; for a map, the value of the cell; for dots,
their number and range in a vertical strip.
"""

from __future__ import annotations

import itertools
import re
from typing import TYPE_CHECKING
from xml.sax.saxutils import escape

import numpy as np
from matplotlib.collections import QuadMesh

from imucald.report.numbers import number

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from numpy.typing import NDArray

    Array = NDArray[np.float64]

POINTS_PER_INCH = 72.0
FIELD_PT = 7.0
"""Width of an invisible field with one title [pt]: about the accuracy of pointing by hand."""


def pointed_values(figure: Figure) -> str:
    """Return SVG groups of invisible fields, each with a title, over the parts of a drawn figure.

    A field over curves or dots covers the whole height of its axes. Units are the units of the
    axes.
    """
    return "".join(_curves(axes) + _dots(axes) + _maps(axes) for axes in figure.axes)


def _curves(axes: Axes) -> str:
    # Straight lines over the whole width or height have only two points.
    curves = [c for c in axes.lines if len(_points(c)) > 2 and c.get_linestyle() != "None"]
    (left, bottom), (right, top) = _place(axes, axes.transAxes.transform([(0, 0), (1, 1)]))
    seen = [_seen(axes, curve, left, right) for curve in curves]
    every = np.unique(np.concatenate([x for x, _ in seen])) if seen else np.zeros(0)
    if len(every) < 2:
        return ""
    count = min(len(every), int((right - left) / FIELD_PT))
    x = every[np.unique(np.linspace(0, len(every) - 1, count).round().astype(np.int64))]
    # A gap in a curve has no field.
    reach = 0.75 * float(np.median(np.diff(x)))
    middle = 0.5 * (x[1:] + x[:-1])
    start = np.maximum(np.concatenate([[left], middle]), x - reach)
    stop = np.minimum(np.concatenate([middle, [right]]), x + reach)
    fields = [
        _field(a, b - a, 0.0, bottom - top, _title(axes, at, curves, seen))
        for a, b, at in zip(start, stop, x, strict=True)
    ]
    return _group(fields, top)


def _dots(axes: Axes) -> str:
    """Return fields over vertical strips of dots. There are too many single dots, and they are too
    small for fields of their own."""
    lone = [c for c in axes.lines if len(_points(c)) > 2 and c.get_linestyle() == "None"]
    clouds = list(filter(_label, lone))  # dots of error bars have no label
    (left, bottom), (right, top) = _place(axes, axes.transAxes.transform([(0, 0), (1, 1)]))
    if not clouds:
        return ""
    edges = np.linspace(left, right, max(int((right - left) / FIELD_PT), 1) + 1)
    seen = [_seen(axes, cloud, left, right) for cloud in clouds]
    name, unit = _named(axes.yaxis)
    fields = []
    for a, b in itertools.pairwise(edges.tolist()):
        here = [points[(x >= a) & (x < b)] for x, points in seen]
        if not any(map(len, here)):
            continue
        ends = axes.transData.inverted().transform(_display(axes, np.array([[a, 0.0], [b, 0.0]])))
        lines = [_between(axes.xaxis, *ends[:, 0].tolist())]
        for cloud, points in zip(clouds, here, strict=True):
            if len(points):
                y = points[:, 1]
                low, middle, high = (number(float(v)) for v in (y.min(), np.median(y), y.max()))
                what = _label(cloud) or name
                lines.append(f"{what} {middle} {unit}".strip() + f" ({low} to {high}, {len(y)})")
        fields.append(_field(a, b - a, 0.0, bottom - top, "\n".join(lines)))
    return _group(fields, top)


def _maps(axes: Axes) -> str:
    """Return fields over the cells of a map that have a value. The label of the map contains its
    name and unit."""
    fields = []
    meshes = (c for c in axes.collections if isinstance(c, QuadMesh))
    for mesh in filter(_label, meshes):  # the colour scale next to a map has no label
        corners = np.asarray(mesh.get_coordinates(), float)  # (rows + 1, columns + 1, 2)
        rows, columns = corners.shape[0] - 1, corners.shape[1] - 1
        values: Array = np.ma.filled(np.ma.asarray(mesh.get_array(), float), np.nan)
        values = values.reshape(rows, columns)
        flat = axes.transData.transform(corners.reshape(-1, 2))
        places = _place(axes, flat).reshape(corners.shape)
        name, unit = _parts(_label(mesh))
        for i, j in np.argwhere(np.isfinite(values)).tolist():
            (x0, y0), (x1, y1) = corners[i, j].tolist(), corners[i + 1, j + 1].tolist()
            (left, bottom), (right, top) = places[i, j].tolist(), places[i + 1, j + 1].tolist()
            value = f"{name} {number(float(values[i, j]))} {unit}".strip()
            lines = [_between(axes.xaxis, x0, x1), _between(axes.yaxis, y0, y1), value]
            fields.append(_field(left, right - left, top, bottom - top, "\n".join(lines)))
    return _group(fields, 0.0)


def _field(x: float, width: float, y: float, height: float, title: str) -> str:
    place = f'x="{x:.1f}"' + (f' y="{y:.1f}"' if y else "")
    size = f'width="{width:.1f}" height="{height:.0f}"'
    return f"<rect {place} {size}><title>{escape(title)}</title></rect>"


def _group(fields: list[str], top: float) -> str:
    if not fields:
        return ""
    inside = "\n".join(fields)
    return f'<g class="values" transform="translate(0 {top:.1f})">\n{inside}\n</g>\n'


def _between(axis: Axis, low: float, high: float) -> str:
    name, unit = _named(axis)
    return f"{name} {number(low)} to {number(high)} {unit}".strip()


def _label(drawn: Artist) -> str:
    label = str(drawn.get_label())
    return "" if label.startswith("_") else label


def _points(curve: Line2D) -> Array:
    """Return the points of a curve in the units of its axes, (N, 2)."""
    return np.column_stack([
        np.asarray(curve.get_xdata(), float), np.asarray(curve.get_ydata(), float)
    ])  # fmt: skip


def _place(axes: Axes, display: Array) -> Array:
    """Convert display coordinates (N, 2) to positions in the SVG [pt], y downwards."""
    figure, width, height = _sheet(axes)
    share = figure.transFigure.inverted().transform(display)
    return np.column_stack([width * share[:, 0], height * (1.0 - share[:, 1])])


def _display(axes: Axes, place: Array) -> Array:
    """Convert positions in the SVG (N, 2) [pt] to display coordinates: the inverse of `_place`."""
    figure, width, height = _sheet(axes)
    share = np.column_stack([place[:, 0] / width, 1.0 - place[:, 1] / height])
    display: Array = figure.transFigure.transform(share)
    return display


def _sheet(axes: Axes) -> tuple[Figure, float, float]:
    """Return the figure of drawn axes, and its width and height [pt]."""
    figure = axes.get_figure(root=True)
    assert figure is not None  # axes that were drawn belong to a figure
    width, height = POINTS_PER_INCH * figure.get_size_inches()
    return figure, float(width), float(height)


def _seen(axes: Axes, curve: Line2D, left: float, right: float) -> tuple[Array, Array]:
    """Return the horizontal positions [pt] and the values of the visible points of a curve."""
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
        name = _label(curve) or _named(axes.yaxis)[0]
        texts.append(f"{name} {number(float(points[i, 1]))} {unit}".strip())
    return "\n".join([here, *texts])


def _where(axes: Axes, x: float) -> str:
    """Return a text with the horizontal position x. If several axes share the horizontal axis, its
    label is taken from the lowest axes."""
    together = axes.get_shared_x_axes().get_siblings(axes)
    axis = next((a.xaxis for a in together if a.get_xlabel()), axes.xaxis)
    name, unit = _named(axis)
    if unit == "min:s":  # its tick texts are minutes and seconds
        return f"{name} {axis.get_major_formatter()(x, None)}"
    return f"{name} {number(x)} {unit}".strip()


def _named(axis: Axis) -> tuple[str, str]:
    return _parts(axis.get_label_text())


def _parts(label: str) -> tuple[str, str]:
    match = re.fullmatch(r"\s*(?P<name>.*?)\s*(?:\[(?P<unit>[^\]]*)\])?\s*", label, re.S)
    return (match["name"], match["unit"] or "") if match else (label, "")
