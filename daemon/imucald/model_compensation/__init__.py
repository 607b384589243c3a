"""Remove known errors of vehicle and sensors from the signals while driving. A model file states
these errors.

The package is loaded only if a configuration names a model. `benchmarks/model_compensation.py` runs
drives with and without a model.
"""

from imucald.model_compensation.compensation import ModelCompensation, compensation_from_model

__all__ = ["ModelCompensation", "compensation_from_model"]
