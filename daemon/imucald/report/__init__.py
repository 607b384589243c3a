"""Self-contained pages and drawings; pages need the extra `report`."""
