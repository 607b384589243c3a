"""The methods to the letter on the van's recording, in the sensor's axes (right, forward, up)."""

from __future__ import annotations

import math

import numpy as np

from publications import method_a, method_b, method_c
from publications.recordings import table

FORWARD = np.array([0.0039, 0.9998, 0.0155])
"""Of the van, in sensor axes, by its INS, +-0.3 deg."""
SPEED_LEADS = 0.2
"""The OBD-II speed is ahead of the accelerometer [s]."""
REST_S = 30.0
"""The van stands when the recording begins [s]."""
NAME = "kingston_2008"


def rates_of_forces(samples):
    """Times (N,), rates and forces (N, 3): the rate at each accelerometer sample."""
    t_gyro, gyro = samples["gyro"]
    t, accel = samples["accel"]
    return t, np.column_stack([np.interp(t, t_gyro, g) for g in gyro.T]), accel


def solved(samples, J, yaw_rate_limit, least):
    """Method A: R_vehicle_from_sensor by claims 1, 3, 4 (angular rate), 5, 6."""
    t, gyro, accel = rates_of_forces(samples)
    t_speed, speed = samples["speed"]
    middle = 0.5 * (t_speed[1:] + t_speed[:-1]) + SPEED_LEADS
    growing = np.interp(t, middle, np.diff(speed)) > 0.0
    rate = gyro @ (J / np.linalg.norm(J))
    straight = method_a.straight(yaw_rate=rate, yaw_rate_limit=yaw_rate_limit)
    return method_a.solve(accel, J, straight, growing, least)[0], growing, rate


def yaw_off(R):
    """From the INS' forward axis to the first row of R, about the sensor's up [deg]."""
    return math.degrees(math.atan2(R[0, 1], R[0, 0]) - math.atan2(FORWARD[1], FORWARD[0]))


def tilted(samples, with_filter):
    """Method B alone, or C (each sample a period) on B's corrected samples: t, pitch, roll."""
    t, rate, accel = rates_of_forces(samples)
    resting = t < t[0] + REST_S
    B = method_b.Correction(delay=-SPEED_LEADS, zero_error=rate[resting].mean(axis=0))
    p, r = method_c.angles_of_force(accel[resting].mean(axis=0))
    sigma = 1.2 / method_c.G
    C = method_c.Filter(
        method_c.attitude_matrix(p, r, 0.0), 0.001, 1e-6, 1e-5, sigma, start=(0.02, 1e-4, 0.01)
    )
    speeds = iter(zip(*(c.tolist() for c in samples["speed"]), strict=True))
    ahead, found = next(speeds), []
    for k in range(1, len(t)):
        while ahead is not None and ahead[0] <= t[k]:
            B.speed(*ahead)
            ahead = next(speeds, None)
        force, free, _, angles = B.take(t[k], accel[k], rate[k])
        if with_filter:
            C.step(free, force, t[k] - t[k - 1])
            angles = method_c.angles_of_matrix(C.C)[:2]
        found.append(angles)
    return t[1:], np.array(found)


def beginning(samples, seconds):
    """The samples of the recording's first seconds."""
    end = samples["accel"][0][0] + seconds
    return {name: (t[t < end], values[t < end]) for name, (t, values) in samples.items()}


def rms_off(t, pitch_roll):
    """rms of roll and pitch against the INS from one minute on [deg]."""
    ins = table(NAME, "ins_truth.csv.gz")
    use = (ins["time_s"] > ins["time_s"][0] + 60.0) & (ins["time_s"] <= t[-1])
    at = np.searchsorted(t, ins["time_s"][use], side="right") - 1
    angles = np.degrees(pitch_roll)[at]
    off = [angles[:, i] - ins[f"{name}_deg"][use] for i, name in ((1, "roll"), (0, "pitch"))]
    return tuple(float(np.sqrt(np.mean(one * one))) for one in off)
