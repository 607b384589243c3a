"""The compact passenger car that is assumed for an unknown vehicle.

The values are assumptions about cars of the C segment (wheelbase 2.6 to 2.7 m, track about 1.5 m,
steering ratio 14 to 17). These values are also the defaults of `vehicle:` and of the model file.
"""

WHEELBASE = 2.68
"""Wheelbase [m]."""
TRACK = 1.53
"""Track width [m]."""
STEERING_RATIO = 15.5
"""Steering-wheel angle divided by road-wheel angle."""
UNDERSTEER = 0.0025
"""Understeer gradient K in r = v * delta / (n * L * (1 + K v^2 / L)) [rad/(m/s^2)]. The value
equals 1.4 deg/g, as in a passenger car (Gillespie, Fundamentals of Vehicle Dynamics, ch. 6: some 1
to 4 deg/g)."""
