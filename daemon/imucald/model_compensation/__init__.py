"""What a model file knows of vehicle and sensors, taken out of their signals while driving.

Loaded only where a configuration names a model. `trial` runs a drive with and without one.
"""

from imucald.model_compensation.compensation import ModelCompensation, compensation_from_model

__all__ = ["ModelCompensation", "compensation_from_model"]
