"""Attitude of the vehicle: method B (motion compensation of the accelerometer) and method C
(nine-state filter)."""
