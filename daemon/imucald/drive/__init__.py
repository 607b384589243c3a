"""Motion of the vehicle while driving: quantities, equations of motion, and windows of signals."""
