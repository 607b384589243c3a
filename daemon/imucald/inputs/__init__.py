"""Signal acquisition: assign signals to quantities, and convert frames to samples in SI."""
