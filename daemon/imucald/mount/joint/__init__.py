"""One estimate of how both sensors answer to the vehicle's motion: a matrix and a zero each."""
