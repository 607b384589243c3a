"""`imucald.check`: what a configuration decodes from a log, and what looks wrong."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from imucald.api.configuration import Configuration, PathLike
from imucald.api.html import html_table
from imucald.api.logs import LogSource, opened, pieces
from imucald.api.run import Progress
from imucald.can.logs.log_reader import LogReader
from imucald.config_check import Check


@dataclass(frozen=True, eq=False, repr=False)
class CheckReport:
    """What was decoded, and what looks wrong.

    usable: whether nothing necessary is missing or wrong. findings: each with `level` (error,
    warning, note, ok), `quantity` and `text`, the worst first. problems: the first bad lines, as
    texts with file and line. report: all that `imucald check --json` prints, see docs/json.md.
    """

    usable: bool
    findings: tuple[Mapping[str, str], ...]
    problems: tuple[str, ...]
    report: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Exactly what `imucald check --json` prints, as plain data; a copy."""
        return copy.deepcopy(dict(self.report))

    def __repr__(self) -> str:
        levels = Counter(finding["level"] for finding in self.findings)
        counts = ", ".join(f"{n} of level {level}" for level, n in levels.items())
        return f"Check({'usable' if self.usable else 'not usable'}; findings: {counts or 'none'})"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        rows = ([f["level"], f["quantity"], f["text"]] for f in self.findings)
        return html_table(("level", "quantity", "finding"), rows)


def check(
    config: Configuration | PathLike,
    log: LogSource | Sequence[LogSource],
    *,
    progress: Progress | None = None,
) -> CheckReport:
    """Check what a configuration decodes from a log: sources, units, rates, gaps, doubts.

    config: a configuration, or its file's name. log: a name, an open file, or a list of the pieces
    of one recording. Raises ConfigError where the configuration cannot be used, LogError for a log
    that cannot be read.
    """
    checker = Check(Configuration.of(config).loaded)
    sources = [opened(one) for one in pieces(log)]
    reader = LogReader(sources, None, False, progress, checker.router.stated_cycles)
    for chunk in reader:
        checker.feed(chunk)
    checker.bad_lines.update(reader.rejected)
    return check_report(checker, reader.problems)


def check_report(checker: Check, problems: Sequence[str] = ()) -> CheckReport:
    """Return the report of a checker."""
    report = checker.report()
    findings = tuple(report["findings"])
    return CheckReport(report["usable"], findings, tuple(problems), report)
