"""A simulated drive as CAN traffic: encoded, with other units, into a log or onto a bus."""
