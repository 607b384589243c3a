"""Statistics of a fleet: the history of each vehicle's mount, computed from the mount estimates of
all drives. The modules have no I/O."""
