"""Propose a configuration from databases and a recording. The file states the evidence above each
entry."""

from __future__ import annotations

from imucald.discovery.discover import discover
from imucald.discovery.proposal import Proposal
from imucald.discovery.recording import GatheredFrames
from imucald.discovery.written import as_yaml

__all__ = ["GatheredFrames", "Proposal", "as_yaml", "discover"]
