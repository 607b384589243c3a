"""Attitude of the vehicle: acceleration correction (method B) and nine-state filter (method C)."""
