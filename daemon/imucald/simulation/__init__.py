"""Vehicle, road, sensors and CAN traffic from a seed: a drive with its truth."""

from imucald.model.model import VehicleModel, load_model
from imucald.simulation.drive import Drive, Truth, simulate
from imucald.simulation.random_model import random_model

__all__ = ["Drive", "Truth", "VehicleModel", "load_model", "random_model", "simulate"]
