"""The history of the vehicles' mounts, from the estimates and covariances of all drives: statistics
without I/O."""
