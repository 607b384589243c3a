"""Vehicle, road, sensors and CAN traffic from a seed: a drive with its truth."""
