"""End-to-end protection of messages: counters, checksums, time-outs."""
