"""A live CAN bus: open, filter, receive, send, detect a loss and reconnect."""
