"""Direction of travel of a carried terminal (method D), and a modern alternative beside it."""
