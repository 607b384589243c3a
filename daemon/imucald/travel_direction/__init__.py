"""Direction of travel of a terminal that a person carries: the published method D, and an
alternative."""
