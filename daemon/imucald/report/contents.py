"""The contents list of a page: links to its sections."""

from __future__ import annotations

import re

PLACE = '<nav class="contents" aria-label="Contents"></nav>'
"""Placeholder for the contents list in a template."""
HEADING = re.compile(r"<h2>(.*?)</h2>", re.S)


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

    text = HEADING.sub(anchored, body)
    listed = "\n".join(links)
    filled = PLACE.replace("></nav>", f">\n<ul>\n{listed}\n</ul>\n</nav>")
    return text.replace(PLACE, filled, 1)
