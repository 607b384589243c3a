"""Pages and drawings that one can send on; pages need the extra `report`."""
