"""`fleet run --diagnose`: evaluate one log to one row, and add the causes that are certain from
this drive alone.

The module is separate, because a template process without the diagnosis starts three times as fast.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from imucald.api.configuration import Configuration
from imucald.api.diagnosing import diagnose
from imucald.core.errors import EstimateError
from imucald.fleet.evaluation import evaluate
from imucald.fleet.task import Outcome, Task


def evaluate_and_diagnose(task: Task) -> Outcome:
    """Do the work of `evaluate`, and add the column `diagnosed`."""
    return evaluate(task, _diagnosed)


def _diagnosed(config: Configuration, path: Path) -> dict[str, Any]:
    """Return the certain causes as a JSON list; None if the drive cannot be diagnosed."""
    try:
        found = diagnose(config, path)
    except EstimateError:
        return {"diagnosed": None}
    return {"diagnosed": json.dumps(sorted(found.causes)) if found.complete else None}
