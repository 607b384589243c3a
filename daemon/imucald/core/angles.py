"""Factors between degrees and radians, defined once. All angles inside the package are in radians.

The functions `math.degrees`, `math.radians`, `np.rad2deg` and `np.deg2rad` multiply by exactly
these numbers.
"""

from __future__ import annotations

import math

RAD_PER_DEG = math.pi / 180.0
"""One degree [rad]."""

DEG_PER_RAD = 180.0 / math.pi
"""One radian [deg]."""
