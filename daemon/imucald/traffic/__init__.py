"""Send a simulated drive to a log or a bus as CAN traffic. The traffic may include frames of other
units."""
