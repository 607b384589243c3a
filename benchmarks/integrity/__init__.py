"""Is what is sent ever good and wrong? Run with python -m benchmarks.integrity."""
