"""What makes it a service: wiring of bus, pipeline and status."""
