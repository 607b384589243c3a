"""Assumptions of the joint estimator before any data: values for sensors, roads and vehicles.

The intervals of the estimate depend on every value, so each value has its source. No value may come
from the simulation alone, because the simulation is also used to test the estimator. The simulation
(`simulation`) draws from the same sources. The reasons for values that a user can set
(accelerometer bias, crown, cross-axis error) are in `config`.
"""

from __future__ import annotations

# The sensor. Data sheets are named where a figure was read in one; the other figures are called
# assumptions. MPU-6050: PS-MPU-6000A-00 rev. 3.4, 6.2. A "typical" value of a maker is used as one
# standard deviation (Bosch Sensortec's forum says so of its own).

CROSS_AXIS = ((0.001, 0.12), (0.005, 0.18), (0.01, 0.2), (0.02, 0.22), (0.04, 0.18), (0.08, 0.1))
"""Cross-axis error if none is configured: sizes (ratio, rms), each with its probability.

Only the order of magnitude is known, so sizes from 0.5 % to 4 % are about equally probable. Data
sheets of bare parts state 2 % (MPU-6050, 6.2; ICM-20948, DS-000189, 3.2) and 3 % (ADXL350, table
1). The data sheets do not say whether this is a typical or a largest value. One unit in eight was
calibrated by its maker to 0.1 %. Soldering, gluing and bending enlarge the error of the other units
several times. The largest size is twice the largest usual size, so that 4 % is well within the
assumed range. The evidence of a drive then shows which size is true.
"""
BIAS_DRIFT_STD = 0.04
"""Change of the accelerometer's zero error while the sensor warms up [m/s^2], 4 mg.

The value is an assumption: 0.1 mg/K times 40 K from a cold start. The data sheet of an older part
states 35 mg over 0 to 70 degC (MPU-6050).
"""

# The road.

SLOPE_STD = 0.02
"""Slope along the road, and slope across the road about its mean (tangent), rms.

Roads in rolling terrain are designed with grades up to 3 to 5 %, normal cross slopes of 1.5 to 2 %,
and 4 to 8 % in bends (AASHTO, A Policy on Geometric Design, ch. 3 and 4). In measured drives, the
direction of gravity differs by 0.7 to 3 deg (1.2 to 5 %) between stops.
"""
SLOPE_LENGTH = 200.0
"""Correlation length of the slope [m]: vertical curves at 50 to 100 km/h are 60 to 400 m long
(AASHTO, sag and crest curves for 2 to 4 % of change).
"""
