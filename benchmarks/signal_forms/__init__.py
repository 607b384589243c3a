"""Does the estimator work with signals as real buses carry them? See `__main__`."""
