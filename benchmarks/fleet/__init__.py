"""The fleet: statistics on simulated drives, throughput and memory on logs and rows."""
