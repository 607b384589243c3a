"""Foundation of the package: rotations, samples, errors, files. It imports no other room."""
