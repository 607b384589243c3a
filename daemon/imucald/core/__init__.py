"""Foundation of the package: rotations, samples, errors, files. `core` imports no other package of
imucald."""
