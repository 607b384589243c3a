"""What the vehicle does: ticks, standstill, straight line, speed and its derivative."""
