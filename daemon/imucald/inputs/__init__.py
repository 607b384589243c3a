"""Signal acquisition: which signal is which quantity, from frames to samples in SI."""
