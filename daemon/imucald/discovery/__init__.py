"""A configuration proposed from databases and a recording, with its evidence beside each line."""

from __future__ import annotations

from imucald.discovery.discover import discover
from imucald.discovery.proposal import Proposal
from imucald.discovery.recording import Recording
from imucald.discovery.written import as_yaml

__all__ = ["Proposal", "Recording", "as_yaml", "discover"]
