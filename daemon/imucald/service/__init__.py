"""The running service: wiring of bus, pipeline and status."""
