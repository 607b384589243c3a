"""A diagnosis as a self-contained HTML page."""

from __future__ import annotations

import base64
import importlib.util
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from imucald.core.errors import ImucaldError
from imucald.core.libraries import how_to_install
from imucald.core.text import duration
from imucald.diagnosis.result import Diagnosis, SignalPicture
from imucald.report import numbers, titles
from imucald.report import wording as words
from imucald.report.model_changes import as_diff, shown_changes

if TYPE_CHECKING:
    from jinja2 import Environment

LIBRARIES = ("jinja2", "matplotlib")

MAX_PICTURED = 14
"""Largest number of signals with pictures. The limit keeps the page small enough for an e-mail."""
MAX_ROWS = 200
"""Largest number of rows in a table or list."""
PLACE = '<nav class="contents" aria-label="Contents"></nav>'
"""Placeholder for the contents list in a template."""


@dataclass(frozen=True)
class About:
    """The data of a page's footer about its origin."""

    logs: Sequence[str]
    config: str
    model: str
    """The tested model: name of its file, or a description of its origin."""
    made: str
    """Time and version of the program that made the page."""


def require_libraries() -> None:
    """Raise ImucaldError, with the remedy, if a library for pages is missing."""
    missing = [name for name in LIBRARIES if importlib.util.find_spec(name) is None]
    if missing:
        raise ImucaldError(f"a report needs {words.in_series(missing)}: {how_to_install('report')}")


def report_page(diagnosis: Diagnosis, about: About) -> str:
    """Return the page as HTML text. Raises ImucaldError if a library is missing."""
    require_libraries()
    template = environment().get_template("diagnosis.html")
    changes = shown_changes(diagnosis)
    verdict = words.verdict(diagnosis)
    return template.render(
        d=diagnosis,
        about=about,
        verdict=verdict,
        figures=_key_figures(diagnosis),
        causes=[words.card(cause, diagnosis) for cause in diagnosis.causes],
        likely=[words.card(cause, diagnosis) for cause in diagnosis.likely],
        others=words.other_suspects(diagnosis)[:MAX_ROWS],
        groups=[
            (list(group_titles), words.ways_apart(group))
            for group_titles, group in [*words.look_alike_groups(diagnosis).items()][:MAX_ROWS]
        ],
        signals=_signal_rows(diagnosis),
        nothing_means=words.NOTHING_MEANS,
        pictures=_pictures(diagnosis),
        unpictured=max(0, len(diagnosis.pictures) - MAX_PICTURED),
        candidates=words.not_named(diagnosis)[:MAX_ROWS],
        structure=sorted(diagnosis.structure, key=lambda s: -_size(s.size))[:MAX_ROWS],
        gain_line=words.gain(diagnosis.gain),
        diff=as_diff(changes[:MAX_ROWS]),
        more_changes=max(0, len(changes) - MAX_ROWS),
        model_text=diagnosis.model_after.to_yaml(),
        notes=diagnosis.notes[:MAX_ROWS],
        more_notes=max(0, len(diagnosis.notes) - MAX_ROWS),
        duration=duration(diagnosis.duration_s),
    )


def environment() -> Environment:
    """Return the template environment (Jinja) with the templates of this package and their
    filters."""
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - an extra

    environment = Environment(
        loader=PackageLoader("imucald.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "signal": titles.signal_title,
        "cause": titles.cause_title,
        "unit": numbers.unit_text,
        "number": numbers.number,
        "typographic": numbers.typographic,
        "structure": words.structure_text,
        "breakable": _breakable,
        "with_contents": with_contents,
        "duration": duration,
    }
    return environment


def with_contents(body: str) -> str:
    """Add an anchor to each section heading of a page, and insert the list of these anchors at
    `PLACE`. body: the page's HTML text with escaped content."""
    links: list[str] = []
    names: set[str] = set()

    def anchored(match: re.Match[str]) -> str:
        title = match[1]
        name = base = re.sub(r"\W+", "-", re.sub(r"<[^>]*>|&\w+;", "", title).lower()).strip("-")
        while name in names:
            name = f"{base}-{len(names)}"
        names.add(name)
        links.append(f'<li><a href="#{name}">{title}</a></li>')
        return f'<h2 id="{name}">{title}</h2>'

    text = re.sub(r"<h2>(.*?)</h2>", anchored, body, flags=re.S)
    listed = "\n".join(links)
    filled = PLACE.replace("></nav>", f">\n<ul>\n{listed}\n</ul>\n</nav>")
    return text.replace(PLACE, filled, 1)


def _breakable(key: str) -> str:
    """Allow line breaks in a dotted key after its dots and underscores."""
    from markupsafe import Markup, escape  # noqa: PLC0415 - an extra

    return Markup("").join(
        escape(part) + (Markup("<wbr>") if part in (".", "_") else "")
        for part in re.split(r"([._])", key)
    )


def _size(x: float) -> float:
    return x if math.isfinite(x) else -math.inf


def _key_figures(diagnosis: Diagnosis) -> list[tuple[str, str, str]]:
    figures = []
    rows = [(name, s) for name, s in diagnosis.signals.items() if s.rms_before > 0.0]
    if rows and diagnosis.causes and diagnosis.gain.was_fitted:
        name, best = min(rows, key=lambda row: _size(row[1].rms_after / row[1].rms_before))
        unit = numbers.unit_text(best.unit)
        figures.append((
            "Largest reduction of a residual, on data not used for the fit",
            f"by {words.less(best).removeprefix('-')}",
            f"{titles.signal_title(name)}: {numbers.number(best.rms_before)} → "
            f"{numbers.number(best.rms_after)} {unit}",
        ))  # fmt: skip
    if diagnosis.causes:
        figures.append(("Extended model file", *words.advice(diagnosis)))
    return figures


def _signal_rows(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    rows = []
    for row, s in zip(words.signal_rows(diagnosis), diagnosis.signals.values(), strict=True):
        sizes = {"before": s.rms_before, "after": s.rms_after, "floor": s.noise_floor}
        top = max(sizes.values())
        share = 100.0 / top if top > 0.0 and math.isfinite(top) else 0.0
        bars = {f"bar_{name}": _width(share * x) for name, x in sizes.items()}
        rows.append({**row._asdict(), **bars})
    return rows[:MAX_ROWS]


def _width(share: float) -> str:
    return f"{share:.1f}" if math.isfinite(share) else "0"


def _pictures(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    """Return the pictures of signals: those with a cause or an unexplained pattern first, then by
    the ratio of residual to noise."""
    from imucald.report import plots as draw  # noqa: PLC0415 - loads matplotlib

    touched = {name for cause in diagnosis.causes for name in cause.signals}
    touched |= {s.signal for s in diagnosis.structure}

    def rank(p: SignalPicture) -> tuple[bool, float]:
        known = diagnosis.signals.get(p.signal)
        worth = known.rms_before / known.noise_floor if known and known.noise_floor else -math.inf
        return p.signal in touched, _size(worth)

    chosen = sorted(diagnosis.pictures, key=rank, reverse=True)[:MAX_PICTURED]
    return [
        {
            "signal": p.signal,
            "driver": p.driver_name,
            "touched": p.signal in touched,
            "extended": draw.is_extended(p),
            "time": draw.time_picture(p),
            "segment": draw.segment_picture(p),
            "of_driver": draw.driver_picture(p),
            "spectrum": draw.spectrum_picture(p),
        }
        for p in chosen
    ]


def address_of(svg: str) -> str:
    """Return a picture as a data URL."""
    return "data:image/svg+xml;base64," + base64.b64encode(svg.encode()).decode()
