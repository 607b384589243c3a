"""Everything that knows a CAN frame, and nothing that knows calibration."""
