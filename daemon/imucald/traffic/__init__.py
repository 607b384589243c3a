"""A simulated drive as CAN traffic: encoded, beside other units, into a log or onto a bus."""
