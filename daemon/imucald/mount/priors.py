"""Assumptions of the full estimator before any data: figures of sensors, roads, vehicles.

The intervals rely on every figure, so each has its source. No figure may come from the
simulation alone, because the simulation also judges the estimator. Its generator (`simulation`)
draws from the same sources. A figure that was fitted to simulated errors says so and gives the
command. The reasons for figures that a user can set (accelerometer bias, crown, cross-axis error)
are in `config`.
"""

from __future__ import annotations

# The sensor. Data sheets are named where a figure was read in one; the other figures are called
# assumptions. MPU-6050: PS-MPU-6000A-00 rev. 3.4, 6.2. A "typical" value of a maker is used as one
# standard deviation (Bosch Sensortec's forum says so of its own).

ACCEL_SCALE_STD = 0.003
"""Scale error per axis (part).

Assumption: bare parts state up to 3 % (MPU-6050, initial calibration tolerance), today's parts
about 1 %, and a unit that was calibrated at the end of its line is better. Half of the error turns
into a tilt (`common_errors`): 0.08 deg.
"""
CROSS_AXIS = ((0.001, 0.12), (0.005, 0.18), (0.01, 0.2), (0.02, 0.22), (0.04, 0.18), (0.08, 0.1))
"""Cross-axis error (part, rms) where none is configured, with probabilities.

Hardly more than the order of magnitude is known, so sizes from 0.5 % to 4 % are about equally
probable. Data sheets of bare parts state 2 % (MPU-6050, 6.2; ICM-20948, DS-000189, 3.2) and 3 %
(ADXL350, table 1). The data sheets do not say whether this is a usual or a largest value. One unit
in eight was calibrated at the end of its line to a tenth of 1 %; others are soldered, glued and
bent to several times as much. The largest size is twice the largest usual one, so that 4 % lies
well within the assumed range. The evidence decides the rest (`cross_axis`).
"""
SPEED_SCALE_STD = 0.02
"""Scale error of a speed (part).

Tyres worn from new to 1.6 mm roll 2 % less, and a change of load or pressure makes 1 %
(assumption).
"""
GAIN_STD = 0.017
"""Other errors in the response to dv/dt or to turns (part), mainly the gyroscope's scale: within
3 % (MPU-6050, 6.1). Where only limits are known, the standard deviation is the limit over the root
of three (evaluation of measurement data, JCGM 100:2008, 4.3.7). Squat, and leaning that the
vertical follows, are smaller. A manoeuvre of 5 s is a third of its time constant, so the effect is
a third of 1 to 2 deg/g, which is 1 %.
"""
GYRO_MISALIGNMENT_STD = 0.002
"""Rotation of the gyroscope's triad against the accelerometer's [rad], 0.1 deg: both are in one
package. A calibrated unit states this from axis to axis (ADIS16475 data sheet, features); for a
bare part it is an assumption.
"""
BIAS_DRIFT_STD = 0.04
"""Change of the zero error while the sensor warms up [m/s^2], 4 mg.

Assumption: 0.1 mg/K times 40 K from a cold start; an older part states 35 mg over 0 to 70 degC
(MPU-6050).
"""
BIAS_FLOOR_STD = 0.002
"""Error that a wandering zero leaves in the direction of gravity over a drive [rad]: 2 mg, half of
the above, which no mean over the drive follows (assumption).
"""

# The road.

SLOPE_STD = 0.02
"""Slope along the road, and across it about its mean (tangent), rms.

Rolling terrain is designed with grades up to 3 to 5 %, normal cross slopes of 1.5 to 2 %, and 4 to
8 % in bends (AASHTO, A Policy on Geometric Design, ch. 3 and 4). Gravity in measured drives differs
by 0.7 to 3 deg (1.2 to 5 %) between stops.
"""
SLOPE_LENGTH = 200.0
"""Correlation length of the slope [m]: vertical curves at 50 to 100 km/h are 60 to 400 m long
(AASHTO, sag and crest curves for 2 to 4 % of change).
"""

# The vehicle.

PITCHING_STD = 0.0014
"""Pitch error from squat and dive in the evidence from dv/dt [rad].

The gradients of squat and dive differ, as anti-dive and anti-squat geometry do. The difference is
some tenths of their size of 1 to 2 deg/g (0.002 to 0.004 rad/(m/s^2)), times 1 m/s^2 of usual
braking. The simulation draws the same difference.
"""

YAW_PER_CROWN = 0.06
"""Yaw error per unknown lean of the road (rad per rad).

A car that is held straight on a leaning road slips sideways by the rear axle's load over its
cornering stiffness, which is 12 to 20 times the load per rad (assumption; 110 kN/rad under 750 kg).
The value couples the errors of roll and yaw; it does not set the size of yaw's deviation.
"""

# Remaining errors; fitted to the errors of simulated drives.

SIDESLIP_STD = 0.0014
"""Error of sideslip and body roll in the yaw from turns [rad]: chosen on simulated drives by
`python -m benchmarks.mount_accuracy --only accuracy` (seeds of tuning, records/mount-accuracy.md).
Sideslip at 2 m/s^2 is of the order of 0.01 rad. Its even part, which averages out, is not included.
"""
YAW_FLOOR_STD = 0.0007
"""Error that remains in both kinds of yaw [rad]: chosen on simulated drives of 4 h, by `python -m
benchmarks.mount_accuracy --only long`.
"""
