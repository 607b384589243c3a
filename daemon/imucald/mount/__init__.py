"""Estimation of the sensor's mount: tilt from gravity, yaw from motion, states, correction."""
