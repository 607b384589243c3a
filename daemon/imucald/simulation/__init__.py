"""Simulate vehicle, road, sensors and CAN timing from a seed. The result is a drive with its true
motion."""

from imucald.model.model import VehicleModel, load_model
from imucald.simulation.drive import Drive, Truth, simulate
from imucald.simulation.random_model import random_model

__all__ = ["Drive", "Truth", "VehicleModel", "load_model", "random_model", "simulate"]
