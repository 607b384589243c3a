"""Recorded logs: which reader for which file, one log after another, as columns of frames."""

from __future__ import annotations

from imucald.bus.columns import CAN_EFF_FLAG, FrameColumns, IdMatch

__all__ = ["CAN_EFF_FLAG", "FrameColumns", "IdMatch"]
