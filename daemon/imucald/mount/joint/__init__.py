"""Joint estimator of a matrix and a zero error for the accelerometer and for the gyroscope."""
