"""Motion of the car while driving: quantities, equations, and their evidence in windows of time."""
