"""Report the signals that a configuration decodes from a log or a bus: sources, units, rates, gaps,
suspicious values.

The frames are decoded by the same router as in the daemon. The report therefore shows how `imucald
run` would decode them.
"""

from __future__ import annotations

from imucald.config_check.checker import EVERY_FRAME, Check
from imucald.config_check.finding import Finding

__all__ = ["EVERY_FRAME", "Check", "Finding"]
