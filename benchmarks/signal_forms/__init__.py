"""Are signals borne as they come on real buses? See `__main__`."""
