"""How well the mount is found on simulated drives; run with python -m benchmarks.mount_accuracy."""
