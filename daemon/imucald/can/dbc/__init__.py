"""CAN databases: read them, and compile them into plans for decoding and encoding."""
