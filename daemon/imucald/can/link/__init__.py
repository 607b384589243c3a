"""A live CAN bus: opened, filtered, received from, sent to, lost and regained."""
