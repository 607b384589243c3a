"""Self-contained HTML pages, and drawings. Pages need the extra `report`."""
