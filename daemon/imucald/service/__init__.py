"""The service that `imucald run` starts: it connects bus, pipeline, saved state and status."""
