"""Propose a configuration from databases and a recording. The file states the evidence above each
entry."""

from __future__ import annotations

from imucald.discovery.discover import discover
from imucald.discovery.proposal import Proposal, as_yaml
from imucald.discovery.recording import GatheredFrames

__all__ = ["GatheredFrames", "Proposal", "as_yaml", "discover"]
