"""A CAN library: links, logs, databases, end-to-end protection. It knows no calibration."""
