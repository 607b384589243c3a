"""Method A: the published solver (CN 201610826380), kept as published."""
