"""How the sensor sits: tilt from gravity, yaw from motion, states, correction."""
