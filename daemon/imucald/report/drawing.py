"""Draw the mount of a sensor: a car from the side, from above and from behind, with the axes of the
sensor.

The drawing is plain SVG text, made without any library. Report pages, the README and the live page
show the same drawing. The views are orthographic. In the views from the side and from above,
forward is to the right. The axes' colours are distinguishable with any colour blindness (Okabe and
Ito). Light or dark mode follows the reader's setting.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from typing import Any

import numpy as np

from imucald.core.arrays import Array
from imucald.core.orientation_words import AXES
from imucald.core.rotations import Matrix3, rotation_from_quaternion
from imucald.mount.mount_words import half_width

Point = tuple[float, float]

VIEW_WIDTH, VIEW_HEIGHT = 300.0, 200.0
CENTRE: Point = (150.0, 106.0)
"""Position of the sensor in each view."""
AXIS_LENGTH = 66.0
BOX = np.array([22.0, 16.0, 6.0])
"""Half sizes of the sensor's box along its axes. The box is flat, so that its faces can be
distinguished."""
END_ON = 0.2
"""If the drawn length of an axis is shorter than this share of its full length, the axis points at
the reader or away from the reader."""
LABEL_GAP = 11.0
TURN_RADIUS = 46.0

STYLE = """
.sits{--si-ink:#1d2733;--si-soft:#5b6776;--si-car:#e9edf2;--si-line:#aab4c0;--si-glass:#d5dee8;
--si-x:#c24a00;--si-y:#00795a;--si-z:#0067ac;--si-box:#ffffff;--si-side:#c9d1da;
font:13px "Helvetica Neue",Arial,"Liberation Sans",sans-serif}
@media (prefers-color-scheme:dark){.sits{--si-ink:#e6e9ee;--si-soft:#a5afbd;--si-car:#29313b;
--si-line:#596675;--si-glass:#3a4653;--si-x:#ff8a4a;--si-y:#37c79b;--si-z:#62b6f2;
--si-box:#d7dde4;--si-side:#8f9aa6}}
.sits text{fill:var(--si-ink)}.sits .soft{fill:var(--si-soft);font-size:11px}
.sits .car{fill:var(--si-car);stroke:var(--si-line);stroke-width:1.2;stroke-linejoin:round}
.sits .glass{fill:var(--si-glass);stroke:var(--si-line);stroke-width:1}
.sits .tyre{fill:var(--si-line)}.sits .road{stroke:var(--si-line);stroke-width:1}
.sits .face{stroke:var(--si-soft);stroke-width:.8;stroke-linejoin:round;fill-opacity:.92}
.sits .axis{stroke-width:3;stroke-linecap:round;fill:none}
.sits .name{font-weight:700;font-size:14px}
.sits .turn{fill:none;stroke:var(--si-ink);stroke-width:2}
"""


@dataclass(frozen=True)
class View:
    """One orthographic view. right, up: the vehicle directions that point right and up in the
    picture.

    behind: names of the vehicle directions at the edges of the picture. car: drawing of the car
    around `CENTRE`.
    """

    title: str
    right: tuple[float, float, float]
    up: tuple[float, float, float]
    edges: tuple[str, str]
    car: str

    @property
    def towards(self) -> Array:
        """The vehicle direction that points at the reader, unit vector (3,)."""
        return np.cross(np.array(self.right), np.array(self.up))

    def place(self, v: Array) -> Point:
        """Return the point in the picture at which the vector `v` from the sensor ends."""
        x, y = float(v @ np.array(self.right)), float(v @ np.array(self.up))
        return CENTRE[0] + x, CENTRE[1] - y


_SIDE = (
    '<path class="car" d="M22 132q-3-22 9-27l46-9q26-25 50-27h42q26 2 48 28l44 8q16 4 17 27l-8 4'
    'h-16a20 20 0 0 0-40 0H100a20 20 0 0 0-40 0H30z"/>'
    '<path class="glass" d="M88 95q20-18 40-19h14v20zM150 76h17q18 2 34 20h-51z"/>'
    '<circle class="tyre" cx="80" cy="137" r="16"/><circle class="tyre" cx="234" cy="137" r="16"/>'
    '<path class="road" d="M8 153h284"/>'
)
_ABOVE = (
    '<path class="car" d="M26 76q4-14 20-15h196q28 3 34 45q-6 42-34 45H46q-16-1-20-15'
    'q-4-30 0-60z"/>'
    '<path class="glass" d="M196 68q14 38 0 76l18 4q14-42 0-84z"/>'
    '<path class="glass" d="M78 70q-8 36 0 72l-14 4q-8-40 0-80z"/>'
    '<path class="glass" d="M90 66h92l8 6H86zM90 146h92l8-6H86z"/>'
)
_BEHIND = (
    '<path class="car" d="M84 138v-28q1-12 10-16l14-28q5-7 18-8h48q13 1 18 8l14 28q9 4 10 16v28z"/>'
    '<path class="glass" d="M106 92l12-22q3-4 10-4h44q7 0 10 4l12 22z"/>'
    '<path class="tyre" d="M90 138h24v16H90zM186 138h24v16h-24z"/>'
    '<path class="road" d="M60 154h180"/>'
)
VIEWS = (
    View("from the side", (1, 0, 0), (0, 0, 1), ("back", "forward"), _SIDE),
    View("from above", (1, 0, 0), (0, 1, 0), ("back", "forward"), _ABOVE),
    View("from behind", (0, -1, 0), (0, 0, 1), ("left", "right"), _BEHIND),
)


def drawing(R_vehicle_from_sensor: Matrix3, words: str) -> str:
    """Return the drawing as SVG text. words: text below the drawing, which is also the description
    for readers who cannot see it."""
    views = [_view(view, _sensor(view, R_vehicle_from_sensor)) for view in VIEWS]
    return _sheet(views, [words], words)


def view_drawings(R_vehicle_from_sensor: Matrix3 | None) -> list[str]:
    """Return each view as a separate SVG, for pages that arrange the views themselves. The page
    must contain `STYLE`. The SVG texts have no name space, because they are used within HTML.
    """
    return [
        f'<svg class="sits" role="img" viewBox="0 0 {VIEW_WIDTH:g} {VIEW_HEIGHT:g}">'
        f"<title>The sensor {view.title}</title>"
        f"{_view(view, _sensor(view, R_vehicle_from_sensor))}</svg>"
        for view in VIEWS
    ]


def known_rotation(mount: Mapping[str, Any]) -> Matrix3 | None:
    """Return the rotation of a mount, as in docs/json.md. None if yaw is unknown, because a drawing
    must not show an unknown angle."""
    q = mount["quaternion_wxyz"]
    is_known = q is not None and half_width(mount["std_deg"]["z"]) is not None
    return rotation_from_quaternion(q) if is_known else None


def axes_drawing() -> str:
    """Return a drawing of the vehicle's axes, and of the positive directions of roll, pitch and
    yaw, as SVG text."""
    turns = "positive pitch: nose down", "positive yaw: to the left", "positive roll: left side up"
    views = [
        _view(view, "".join(_axes(view, np.eye(3))) + _turn(view, text))
        for view, text in zip(VIEWS, turns, strict=True)
    ]
    words = "Vehicle axes: x forward, y left, z up. Each turn is right-handed about its axis."
    return _sheet(views, [words], words)


def _sheet(views: Sequence[str], lines: Sequence[str], title: str) -> str:
    width = VIEW_WIDTH * len(views)
    wrapped = [part for line in lines for part in _wrapped(line, 118)]
    height = VIEW_HEIGHT + 20.0 * len(wrapped) + (8.0 if wrapped else 0.0)
    body = "".join(
        f'<g transform="translate({i * VIEW_WIDTH:g} 0)">{v}</g>' for i, v in enumerate(views)
    )
    text = "".join(
        f'<text x="{width / 2:g}" y="{VIEW_HEIGHT + 14 + 20 * i:g}" text-anchor="middle">'
        f"{escape(line)}</text>"
        for i, line in enumerate(wrapped)
    )
    return (
        f'<svg class="sits" xmlns="http://www.w3.org/2000/svg" role="img" '
        f'viewBox="0 0 {width:g} {height:g}"><title>{escape(title)}</title>'
        f"<style>{STYLE}</style>{body}{text}</svg>\n"
    )


def _wrapped(line: str, columns: int) -> Iterator[str]:
    """Break a line after a semicolon if it is longer than `columns`."""
    row = ""
    for part in line.split("; "):
        if row and len(row) + len(part) > columns:
            yield row + ";"
            row = part
        else:
            row = f"{row}; {part}" if row else part
    yield row


def _view(view: View, inside: str) -> str:
    left, right = view.edges
    return (
        f'<text class="soft" x="{CENTRE[0]:g}" y="14" text-anchor="middle">{view.title}</text>'
        f"{view.car}"
        f'<text class="soft" x="8" y="190">{left}</text>'
        f'<text class="soft" x="{VIEW_WIDTH - 8:g}" y="190" text-anchor="end">{right}</text>'
        f"{inside}"
    )


def _sensor(view: View, R: Matrix3 | None) -> str:
    """Draw in this order: arrows that point away, the box, arrows that point at the reader, and
    rings on top."""
    if R is None:
        return ""
    depth = view.towards @ R
    axes = _axes(view, R)
    hidden = [depth[i] < 0.0 and not _is_end_on(view, R[:, i]) for i in range(3)]
    behind = "".join(axis for axis, is_hidden in zip(axes, hidden, strict=True) if is_hidden)
    before = "".join(axis for axis, is_hidden in zip(axes, hidden, strict=True) if not is_hidden)
    return behind + "".join(_faces(view, R)) + before


def _faces(view: View, R: Matrix3) -> Iterator[str]:
    """Yield the visible faces of the sensor's box, the farthest face first."""
    seen = []
    for axis in range(3):
        for sign in (1.0, -1.0):
            normal = sign * R[:, axis]
            towards = float(normal @ view.towards)
            if towards > 1e-3:
                seen.append((towards, axis, sign))
    for _, axis, sign in sorted(seen):
        a, b = (i for i in range(3) if i != axis)
        corners = []
        for s, t in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
            local = np.zeros(3)
            local[[axis, a, b]] = sign * BOX[axis], s * BOX[a], t * BOX[b]
            corners.append(view.place(R @ local))
        colour = "var(--si-box)" if axis == 2 and sign > 0 else "var(--si-side)"
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in corners)
        yield f'<polygon class="face" fill="{colour}" points="{points}"/>'


def _axes(view: View, R: Matrix3) -> list[str]:
    return [_axis(view, R[:, i], AXES[i]) for i in range(3)]


def _is_end_on(view: View, v: Array) -> bool:
    """True if the reader looks along the axis. Such an axis is drawn as a ring."""
    (x0, y0), (x1, y1) = CENTRE, view.place(AXIS_LENGTH * v)
    return math.hypot(x1 - x0, y1 - y0) < END_ON * AXIS_LENGTH


def _axis(view: View, v: Array, name: str) -> str:
    """Draw an axis: an arrow, or a ring if the axis points at the reader (ring with a dot) or away
    (ring with a cross)."""
    colour = f"var(--si-{name})"
    if _is_end_on(view, v):
        return _end_on(float(v @ view.towards) > 0.0, colour, name)
    (x0, y0), (x1, y1) = CENTRE, view.place(AXIS_LENGTH * v)
    length = math.hypot(x1 - x0, y1 - y0)
    ux, uy = (x1 - x0) / length, (y1 - y0) / length
    head = 10.0 * min(1.0, length / 30.0)
    bx, by = x1 - head * ux, y1 - head * uy
    wings = f"{bx - 0.5 * head * uy:.1f},{by + 0.5 * head * ux:.1f} " + (
        f"{bx + 0.5 * head * uy:.1f},{by - 0.5 * head * ux:.1f}"
    )
    lx, ly = x1 + LABEL_GAP * ux, y1 + LABEL_GAP * uy + 4.5
    return (
        f'<path class="axis" stroke="{colour}" d="M{x0:.1f} {y0:.1f}L{bx:.1f} {by:.1f}"/>'
        f'<polygon fill="{colour}" points="{x1:.1f},{y1:.1f} {wings}"/>'
        f'<text class="name" style="fill:{colour}" x="{lx:.1f}" y="{ly:.1f}" '
        f'text-anchor="middle">{name}</text>'
    )


def _end_on(at_reader: bool, colour: str, name: str) -> str:
    x, y = CENTRE
    ring = f'<circle cx="{x:g}" cy="{y:g}" r="8" fill="var(--si-box)" stroke="{colour}" '
    ring += 'stroke-width="2.5"/>'
    inside = (
        f'<circle cx="{x:g}" cy="{y:g}" r="2.8" fill="{colour}"/>'
        if at_reader
        else f'<path class="axis" stroke="{colour}" style="stroke-width:2" '
        f'd="M{x - 4:g} {y - 4:g}l8 8m0-8l-8 8"/>'
    )
    label = f'<text class="name" style="fill:{colour}" x="{x - 32:g}" y="{y + 28:g}">{name}</text>'
    return ring + inside + label


def _turn(view: View, text: str) -> str:
    """Draw a circular arrow for a positive rotation about the axis that is perpendicular to the
    picture."""
    axis = int(np.argmax(np.abs(view.towards)))
    to_the_left = float(view.towards[axis]) > 0.0  # as seen from the tip of the axis
    start, stop = (114.0, 336.0) if to_the_left else (336.0, 114.0)
    (x0, y0), (x1, y1) = _on_circle(start), _on_circle(stop)
    sweep = 0 if to_the_left else 1
    ahead = stop + (14.0 if to_the_left else -14.0)
    tip = _on_circle(ahead)
    inner, outer = _on_circle(stop, TURN_RADIUS - 6.0), _on_circle(stop, TURN_RADIUS + 6.0)
    points = " ".join(f"{x:.1f},{y:.1f}" for x, y in (tip, inner, outer))
    return (
        f'<path class="turn" d="M{x0:.1f} {y0:.1f}A{TURN_RADIUS:g} {TURN_RADIUS:g} 0 1 {sweep} '
        f'{x1:.1f} {y1:.1f}"/><polygon style="fill:var(--si-ink)" points="{points}"/>'
        f'<text x="{CENTRE[0]:g}" y="178" text-anchor="middle">{text}</text>'
    )


def _on_circle(degrees: float, radius: float | None = None) -> Point:
    """Return a point on a circle about `CENTRE`. The angle is counter-clockwise from the right."""
    r, angle = TURN_RADIUS if radius is None else radius, math.radians(degrees)
    return CENTRE[0] + r * math.cos(angle), CENTRE[1] - r * math.sin(angle)
