"""The fleet: its statistics on simulated drives, its throughput and memory on real logs and rows."""
