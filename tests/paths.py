"""Where the tests find the project and the measured data beside it."""

from pathlib import Path

ROOT = Path(__file__).parent.parent
SHARED_DATA = ROOT.parent / "shared" / "data"
"""Measured drives; not part of the project: a test that needs them says so when they are absent."""
