"""The Cramer-Rao bound of yaw in a case where it can be computed.

All effects off but the accelerometer's white noise of known density; speed, yaw rate and delays
exact. Each accelerometer sample is f_s = R^T f + b + n with the true f known, so the Fisher
information of (e_x, e_y, e_z, b_x, b_y, b_z) is the sum over samples of D^T D / sigma^2 with
D = [-[e x f]', I], plus the prior of the bias (10 mg); the bound of yaw is the third diagonal
element of its inverse. The estimator is told nothing of this: it learns noise, gains and delays.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.mount_accuracy.drives import FULL, Drive, run
from imucald.motion.column_ticks import ticks_from_samples
from imucald.mount.estimator import JointEstimator
from imucald.simulation import random_model, simulate

NOISE_DENSITY = 0.2
"""[m/s^2/sqrt(Hz)]: large, so that this noise and nothing else decides."""
BIAS_STD = 0.0981
ZERO = [0.0, 0.0, 0.0]
OFF = {
    "suspension.squat_dive": False,
    "suspension.body_roll": False,
    "road.grade": False,
    "road.bank": False,
    "road.roughness": False,
    "mount.lever_arm": False,
    "chassis.single_track": False,
    "accel.noise_density": NOISE_DENSITY,
    "accel.bias": ZERO,
    "accel.bias_temperature": ZERO,
    "accel.bias_walk": 0.0,
    "accel.scale": ZERO,
    "accel.vibration": False,
    "accel.engine_mps2": 0.0,
    "accel.lowpass_hz": None,
    "accel.full_scale": None,
    "accel.lsb": 0.0,
    "accel.delay_s": 0.0,
    "gyro.delay_s": 0.0,
    "gyro.scale": ZERO,
    "gyro.g_sensitivity": ZERO,
    "gyro.bias_temperature": ZERO,
    "gyro.bias_walk": 0.0,
    "gyro.vibration": False,
    "gyro.lowpass_hz": None,
    "speed.delay_s": 0.0,
    "speed.scale": 0.0,
}


def error_and_bound(seed: int, minutes: float) -> tuple[float, float]:
    """Yaw error of the estimator and the bound's standard deviation, both [deg]."""
    made = simulate(random_model(seed).with_changes(OFF), seed, minutes)
    truth = made.truth
    x, y, z = truth.force.T
    D = np.zeros((len(x), 3, 6))
    D[:, 0, 1], D[:, 0, 2] = -z, y
    D[:, 1, 0], D[:, 1, 2] = z, -x
    D[:, 2, 0], D[:, 2, 1] = -y, x
    D[:, 0, 3] = D[:, 1, 4] = D[:, 2, 5] = 1.0
    sigma2 = NOISE_DENSITY**2 * made.model.accel.rate_hz / 2.0
    information = np.einsum("nki,nkj->ij", D, D) / sigma2
    information[3:, 3:] += np.eye(3) / BIAS_STD**2
    bound = math.degrees(math.sqrt(float(np.linalg.inv(information)[2, 2])))
    rows = ticks_from_samples(made.samples, 0, int(minutes * 600))
    R = truth.R_vehicle_from_sensor()
    said = run(JointEstimator(FULL), Drive(seed, rows, R, 0.0), [minutes]).said
    return float(said[minutes].error[2]), bound
