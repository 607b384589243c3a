"""A second generator of drives, in which effects are hidden for the diagnosis to find.

It is independent of ``imucald.simulation`` and of ``imucald.diagnosis`` on purpose: a model that is
tested on data that it made itself finds nothing but itself. From the package it takes only the
container `Series`. The same physics is written in other terms and solved by other means:

=====================  =================================================  =======================
part                   here                                               simulation
=====================  =================================================  =======================
driver                 a random sequence of manoeuvres in time            a path over distance
tyres                  force builds up over a relaxation length, tanh     slip angle, algebraic
                       curve; sticks at standstill
integrator             Runge-Kutta, many overlapping stretches at once    implicit differences,
                                                                          Newton
steering               the wheels follow the hands with a lag             no lag
body                   sprung and unsprung mass for heave, pitch, roll,   bilinear filters
                       integrated
road                   slope and cross fall as sums of sinusoids of the   Gauss-Markov recursion
                       distance; roughness by random phases
specific force         place of the sensor in space, differentiated       terms of the rotating
                       twice, minus gravity, turned by the attitude       frame, lever-arm formula
angular rate           logarithm of the attitude's increments             Euler kinematics
sensor's low-pass      the analogue transfer function, in the spectrum    recursion
=====================  =================================================  =======================

`hidden_drive(seed, effects)` makes a drive: samples, the baseline model file that the diagnosis
starts from, and the true value of every parameter. `CAUSES` are the catalogue's 26 causes,
`OUTSIDE` those that the catalogue does not have.

The baseline says what a correct model file says: everything right to within `TOLERANCES`. An
effect (`Effect(cause, size)`) moves the truth away from it; the same seed without the effect gives
the same drive otherwise.
"""

from hidden.drive import HiddenDrive, hidden_drive
from hidden.effects import CAUSES, OUTSIDE, OUTSIDE_SIGNALS, SIZES, Effect, random_effect
from hidden.world import TOLERANCES

__all__ = [
    "CAUSES",
    "OUTSIDE",
    "OUTSIDE_SIGNALS",
    "SIZES",
    "TOLERANCES",
    "Effect",
    "HiddenDrive",
    "hidden_drive",
    "random_effect",
]
