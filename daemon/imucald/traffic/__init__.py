"""Send a simulated drive as CAN traffic, with frames of other units, to a log or a bus."""
