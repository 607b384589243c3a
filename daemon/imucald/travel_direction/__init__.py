"""Direction of travel of a carried terminal (method D), and an alternative beside it."""
