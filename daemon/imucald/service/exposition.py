"""Request the Prometheus texts of daemons, and merge several texts into one.

This module does not import numpy.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

from imucald.core.errors import LinkError
from imucald.core.text import encodable
from imucald.service.asking import ask

METRICS_TYPE = "text/plain; version=0.0.4; charset=utf-8"
"""Media type of Prometheus text."""
UP = "imucald_up"
_BUS = re.compile(r'[{,]bus="((?:[^"\\]|\\.)*)"')


def bus_of(socket: Path) -> str:
    """Return the name of a daemon's bus, from the path of its status socket."""
    if socket.name == "status.sock":
        return socket.parent.name
    return socket.stem.removeprefix("imucald-")


def gathered(sockets: Iterable[Path]) -> str:
    """Return the merged metrics of the daemons that own these sockets. A metric states for each
    daemon whether it answers.

    The label `bus` of a daemon is the name that the daemon gives its bus. Daemons on one bus have
    the names of their sockets, because a label names one daemon only.
    """
    texts: dict[Path, str] = {}
    absent = []
    for path in sockets:
        try:
            texts[path] = ask(path, "metrics", 2.0)
        except LinkError:
            absent.append(path)
    given = {path: _label(text) for path, text in texts.items()}
    buses = Counter(given.values())
    answers = {escaped(bus_of(path)): 0 for path in absent}
    for path, bus in given.items():
        own = escaped(bus_of(path)) if bus is None or buses[bus] > 1 else bus
        texts[path] = texts[path].replace(f'{{bus="{bus}"', f'{{bus="{own}"')
        answers[own] = 1
    return merged([_up(answers), *texts.values()])


def _label(text: str) -> str | None:
    named = _BUS.search(text)
    return named[1] if named else None


def escaped(text: str) -> str:
    """Escape a text for the quoted value of a label."""
    return encodable(text).replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")


def _up(answers: Mapping[str, int]) -> str:
    lines = "".join(f'{UP}{{bus="{bus}"}} {up}\n' for bus, up in answers.items())
    return f"# HELP {UP} 1 where the daemon of a bus answers.\n# TYPE {UP} gauge\n{lines}"


def merged(texts: Iterable[str]) -> str:
    """Merge several texts: each metric family appears once, with the lines of all texts."""
    heads: dict[str, str] = {}
    lines: dict[str, list[str]] = {}
    for text in texts:
        family = ""
        for line in text.split("\n"):  # and at no other line break: a name may hold one
            if line.startswith("# "):
                family = line.split(" ", 3)[2]
                if line not in heads.setdefault(family, ""):
                    heads[family] += f"{line}\n"
            elif line:
                lines.setdefault(family, []).append(f"{line}\n")
    return "".join(heads[name] + "".join(lines.get(name, ())) for name in heads)
