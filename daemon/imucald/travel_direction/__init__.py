"""Direction of travel of a carried terminal (method D), and an alternative to it."""
