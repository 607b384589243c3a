"""A CAN library: links, logs, databases, end-to-end protection. The package contains no calibration
code."""
