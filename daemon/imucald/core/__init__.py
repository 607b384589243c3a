"""Foundation of imucald: rotations, samples, errors, files. `core` imports no other part of
imucald."""
