"""A CAN library: links, logs, databases, end-to-end protection. It contains no calibration code."""
