"""The vehicles' story, from the estimates and covariances of all drives: statistics without I/O."""
