"""Ground of the house: rotations, samples, errors, files. Imports no other room."""
