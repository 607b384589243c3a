"""Thousands of logs of hundreds of vehicles: each log is evaluated separately, then all results are
analysed together."""
