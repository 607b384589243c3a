"""What the full estimator takes for granted before any data: figures of sensors, roads, vehicles.

Every one is a promise that the intervals rest on, so each says where it comes from. None may come
from the simulation alone, which also judges the estimator: its generator (`simulation`) draws from
the same sources, and where a figure was fitted to simulated errors it says so, with the command.
What a user can set (accelerometer bias, crown, cross-axis error) has its reason in `config`.
"""

from __future__ import annotations

# The sensor. What was read in a data sheet is named with it; the rest is called an assumption.
# MPU-6050: PS-MPU-6000A-00 rev. 3.4, 6.2. A maker's "typical" is taken for one standard deviation
# (Bosch Sensortec's forum says so of its own).

ACCEL_SCALE_STD = 0.003
"""Scale error per axis (part). Assumption: bare parts state up to 3 % (MPU-6050, initial
calibration tolerance), today's about 1 %, and a unit that was set at the end of its line is
better. Half of it turns into a tilt (`common_errors`): 0.08 deg."""
CROSS_AXIS = ((0.001, 0.12), (0.005, 0.18), (0.01, 0.2), (0.02, 0.22), (0.04, 0.18), (0.08, 0.1))
"""Cross-axis error (part, rms) where none is configured, with probabilities. Of its size hardly
more than the order is known, so sizes from a half to 4 % are about as probable as one another. Data
sheets of bare parts state 2 % (MPU-6050, 6.2; ICM-20948, DS-000189, 3.2) and 3 % (ADXL350, table
1) and do not say whether that is usual or the most; one unit in eight was set at the end of its
line to a tenth of 1 %, others are soldered, glued and bent to several times as much. The largest is
twice the largest that is usual, for 4 % to lie within what is reckoned with. The rest is for the
evidence to say (`cross_axis`)."""
SPEED_SCALE_STD = 0.02
"""Scale error of a speed (part): tyres from new to worn down to 1.6 mm roll 2 % less, and a change
of load or pressure makes 1 % (assumption)."""
GAIN_STD = 0.017
"""What else is in the response to dv/dt or to turns (part), above all the gyroscope's scale: within
3 % (MPU-6050, 6.1). Of limits without more knowledge the standard deviation is their root-third
(evaluation of measurement data, JCGM 100:2008, 4.3.7). Squat, and leaning that the vertical
follows, are smaller: a third of 1 to 2 deg/g, as a manoeuvre of 5 s is a third of its time
constant, is 1 %."""
GYRO_MISALIGNMENT_STD = 0.002
"""Turn of the gyroscope's triad against the accelerometer's [rad], 0.1 deg: both are in a package.
A calibrated unit states that from axis to axis (ADIS16475 data sheet, features); of a bare part it
is an assumption."""
BIAS_DRIFT_STD = 0.04
"""The zero error moves by that much while the sensor warms up [m/s^2], 4 mg. Assumption:
0.1 mg/K times 40 K from a cold start; an older part states 35 mg over 0 to 70 degC (MPU-6050)."""
BIAS_FLOOR_STD = 0.002
"""What wandering leaves in the direction of gravity over a drive [rad]: 2 mg, a half of the above
that no mean over the drive follows (assumption)."""

# The road.

SLOPE_STD = 0.02
"""Slope along, and about its mean across (tangent), rms. Rolling terrain is designed with grades
up to 3 to 5 % and normal cross slopes of 1.5 to 2 % with 4 to 8 % in bends (AASHTO, A Policy on
Geometric Design, ch. 3 and 4); gravity in measured drives differs by 0.7 to 3 deg (1.2 to 5 %) from
one stop to the next."""
SLOPE_LENGTH = 200.0
"""Distance over which a slope forgets itself [m]: vertical curves at 50 to 100 km/h are 60 to 400 m
long (AASHTO, sag and crest curves for 2 to 4 % of change)."""

# The vehicle.

PITCHING_STD = 0.0014
"""Pitch that squat and dive leave in dv/dt [rad]. Their gradients differ, as anti-dive and
anti-squat geometry do, by some tenths of their size of 1 to 2 deg/g (0.002 to 0.004 rad/(m/s^2));
times 1 m/s^2 of usual braking. The simulation draws the same difference."""

YAW_PER_CROWN = 0.06
"""Yaw error that goes with an unknown lean of the road (rad per rad): a car that is held straight
on it slips sideways by the rear axle's load over its cornering stiffness, which is 12 to 20 times
the load per rad (assumption; 110 kN/rad under 750 kg). It says how roll and yaw go together, not
how large yaw's deviation is."""

# What is left over; fitted to the errors of simulated drives.

SIDESLIP_STD = 0.0014
"""What sideslip and body roll leave in the yaw from turns [rad]: chosen on simulated drives by
`python -m benchmarks.mount_accuracy --only accuracy` (seeds of tuning, records/mount-accuracy.md).
Sideslip at 2 m/s^2 is of the order of 0.01 rad; the even part that averages out is not in it."""
YAW_FLOOR_STD = 0.0007
"""Both kinds of yaw stay off by that much [rad]: chosen on simulated drives of 4 h, by
`python -m benchmarks.mount_accuracy --only long`."""
