"""Mount of the sensor: tilt from gravity, yaw from motion, states, correction."""
