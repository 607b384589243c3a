"""Motion of the vehicle: ticks, standstill, straight line, speed and its derivative, signal
health."""
