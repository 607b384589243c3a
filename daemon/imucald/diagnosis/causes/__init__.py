"""The catalogue: one module per cause (see `imucald.diagnosis.cause`)."""
