"""CAN databases: read, and compiled into plans that decode and encode."""
