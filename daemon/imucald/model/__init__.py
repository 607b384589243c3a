"""The model file: all parameters of vehicle, road and sensors."""
