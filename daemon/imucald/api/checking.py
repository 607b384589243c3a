"""`imucald.check`: report the signals that a configuration decodes from a log, and everything that
looks wrong."""

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
    """The result of a check: the decoded signals, and findings about errors.

    usable: False if something necessary is missing or wrong. findings: the worst first, each with
    `level` (error, warning, note, ok), `quantity` and `text`. problems: the first bad lines, as
    texts with file and line. report: the output of `imucald check --json`, see docs/json.md.
    """

    usable: bool
    findings: tuple[Mapping[str, str], ...]
    problems: tuple[str, ...]
    report: Mapping[str, Any]

    def to_dict(self) -> dict[str, Any]:
        """Return a copy of the output of `imucald check --json`, as plain data."""
        return copy.deepcopy(dict(self.report))

    def __repr__(self) -> str:
        levels = Counter(finding["level"] for finding in self.findings)
        counts = ", ".join(f"{n} of level {level}" for level, n in levels.items())
        return f"Check({'usable' if self.usable else 'not usable'}; findings: {counts or 'none'})"

    def _repr_html_(self) -> str:
        """Return the HTML that a notebook shows."""
        rows = ([f["level"], f["quantity"], f["text"]] for f in self.findings)
        return html_table(("level", "quantity", "finding"), rows)


def check(
    config: Configuration | PathLike,
    log: LogSource | Sequence[LogSource],
    *,
    progress: Progress | None = None,
) -> CheckReport:
    """Check the signals that a configuration decodes from a log: sources, units, rates, gaps,
    suspicious values.

    config: a configuration, or the name of its file. log: a file's name, an open file, or a list
    of the pieces of one recording. Raises ConfigError if the configuration cannot be used, and
    LogError if the log cannot be read.
    """
    checker = Check(Configuration.of(config).loaded)
    sources = [opened(one) for one in pieces(log)]
    reader = LogReader(sources, None, False, progress, checker.router.stated_cycles)
    for chunk in reader:
        checker.feed(chunk)
    checker.bad_lines.update(reader.rejected)
    return check_report(checker, reader.problems)


def check_report(checker: Check, problems: Sequence[str] = ()) -> CheckReport:
    """Return the report of a check. problems: the first bad lines of the log."""
    report = checker.report()
    findings = tuple(report["findings"])
    return CheckReport(report["usable"], findings, tuple(problems), report)
