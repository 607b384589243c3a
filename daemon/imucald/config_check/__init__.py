"""Report what a configuration decodes from a log or a bus: sources, units, rates, gaps, doubts.

The frames pass through the daemon's own router, so the report shows what `imucald run` would do.
"""

from __future__ import annotations

from imucald.config_check.checker import EVERY_FRAME, Check, columns_of
from imucald.config_check.finding import Finding

__all__ = ["EVERY_FRAME", "Check", "Finding", "columns_of"]
