"""For a drive whose signals contradict each other, find the errors that `imucald check` reports."""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from imucald.can.logs.text_blocks import STDIN
from imucald.mount.estimate import GOOD_NAMES

if TYPE_CHECKING:
    from imucald.api.configuration import Configuration


def causes(
    options: argparse.Namespace,
    config: Configuration,
    logs: Sequence[str],
    result: Mapping[str, Any],
) -> list[str]:
    """Return the likely causes of the contradictions in a replayed drive; empty if there is no
    contradiction.

    The estimator compares pairs of signals while it runs, so it cannot say which signal of a pair
    is wrong. `check` judges the whole drive. If it finds no error, the text says so. result: as in
    docs/json.md.
    """
    from imucald.api.checking import check

    if result["state"] in GOOD_NAMES or not result["details"].get("faults"):
        return []
    names = ["LOG" if log == STDIN else log for log in logs]
    command = shlex.join(["imucald", "check", "--config", str(options.config), *names])
    if STDIN in logs:
        return [f"two signals contradict each other: save the log, then run '{command}'"]
    found = check(config, logs).findings
    for level in ("error", "warning"):
        if texts := [f"{f['quantity']}: {f['text']}" for f in found if f["level"] == level]:
            return texts
    return [
        "not known: two signals contradict each other in a part of the drive, but over the whole "
        f"drive no sign, axis or unit is wrong. The sensor may move in its holder. '{command}' "
        "shows every signal"
    ]
