"""imucald: finds out how an IMU sits in a vehicle and re-emits its signals in vehicle axes."""

__version__ = "0.1.0"
