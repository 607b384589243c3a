"""The model file: every parameter of vehicle, road and sensors."""
