"""A page as its reader's browser takes it apart."""

from __future__ import annotations

import base64
import re
from html.parser import HTMLParser

NAME_SPACES = 'xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink"'
VOID = {"meta", "img", "br", "hr", "link", "input", "wbr", "base"}


class Page(HTMLParser):
    """What a page holds; raises where its tags do not match."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.source = text
        self.texts: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self._open: list[str] = []
        self.feed(text)
        assert self._open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self._open.append(tag)

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        if not self._open or self._open[-1] != "style":
            self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())

    @property
    def pictures(self) -> list[str]:
        """The SVG texts, each as a file of its own would have it."""
        sources = [attrs["src"] for tag, attrs in self.tags if tag == "img"]
        head = "data:image/svg+xml;base64,"
        assert all(source.startswith(head) for source in sources)
        inline = [
            svg.replace("<svg", f"<svg {NAME_SPACES}", 1)
            for svg in re.findall(r"<svg.*?</svg>", self.source, re.S)
        ]
        return inline + [base64.b64decode(source[len(head) :]).decode() for source in sources]
