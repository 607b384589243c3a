"""Method C (terminal attitude by a nine-state filter), formula by formula, in plain numpy.

Axes: x right, y forward, z up; navigation axes east, north, up. Pitch p about x, roll r about y,
azimuth y clockwise from north. The formulas are pictures in the source and missing: all of them are
*reconstructed* from the words around them, as plainly as they can be meant.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

G = 9.80665


def system_errors(rates, forces):
    """(1), (2): means at rest; of the accelerometer less gravity on the vertical axis."""
    return np.mean(rates, axis=0), np.mean(forces, axis=0) - [0.0, 0.0, G]


def attitude_matrix(p, r, azimuth):
    """(3): C from device to navigation axes, three turns."""

    def turn(axis, angle):
        c, s = math.cos(angle), math.sin(angle)
        R = np.eye(3)
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        R[i, i] = R[j, j] = c
        R[i, j], R[j, i] = -s, s
        return R

    return turn(2, -azimuth) @ turn(0, p) @ turn(1, r)


def angles_of_force(f):
    """(4), (15): pitch and roll from the accelerometer (system error taken off before)."""
    return math.atan2(f[1], math.hypot(f[0], f[2])), math.atan2(-f[0], f[2])


def angles_of_matrix(C):
    """(14): three angles from the elements r_ij."""
    return (
        math.asin(min(max(C[2, 1], -1.0), 1.0)),
        math.atan2(-C[2, 0], C[2, 2]),
        math.atan2(C[0, 1], C[1, 1]) % (2.0 * math.pi),
    )


def skew(w):
    """(6)."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def propagated(C, w, dt):
    """(5), (7): C' = C Omega over one period, the rate taken as constant in it."""
    return C @ expm(skew(w) * dt)


def transition(C, dt):
    """(10): the gyroscope's error equation; random errors stay as they are in one period."""
    F = np.eye(9)
    F[0:3, 3:6] = -C * dt
    return F


class Filter:
    """(8) to (20), every sampling period.

    sigma_gyro, sigma_accel: of one sample, per axis (one number or three); walk_gyro,
    walk_accel: of the random errors, per root second. Attitude errors are a rotation vector about
    east, north, up; C_true = exp(error) C.
    """

    def __init__(self, C, sigma_gyro, walk_gyro, walk_accel, sigma_tilt, sigma_heading=None,
                 start=(0.05, 0.01, 0.1)):  # fmt: skip
        self.C = C
        self.b = np.zeros(3)
        self.d = np.zeros(3)
        ones = np.ones(3)
        self.P = np.diag(np.concatenate([[start[0] ** 2] * 3, [start[1] ** 2] * 3,
                                         [start[2] ** 2] * 3]))  # fmt: skip
        self.noise = (sigma_gyro * ones, walk_gyro * ones, walk_accel * ones)
        self.sigma_tilt, self.sigma_heading = sigma_tilt, sigma_heading

    def step(self, raw_rate, force, dt, azimuth=None):
        """One period: compensated rate, matrix, time update, measurement update."""
        self.C = propagated(self.C, raw_rate - self.b, dt)
        gyro, walk_b, walk_d = self.noise
        F = transition(self.C, dt)
        Q = np.zeros((9, 9))
        Q[0:3, 0:3] = self.C @ np.diag((gyro * dt) ** 2) @ self.C.T
        Q[3:6, 3:6] = np.diag(walk_b**2 * dt)
        Q[6:9, 6:9] = np.diag(walk_d**2 * dt)
        self.P = F @ self.P @ F.T + Q  # (19)
        z, H, R = self.measurement(force - self.d, azimuth)
        S = H @ self.P @ H.T + R  # (20)
        K = self.P @ H.T @ np.linalg.inv(S)
        x = K @ z
        self.P = (np.eye(9) - K @ H) @ self.P
        self.C = expm(skew(x[0:3])) @ self.C
        self.b = self.b + x[3:6]
        self.d = self.d + x[6:9]

    def measurement(self, force, azimuth):
        """(13), (16) to (18): angles of the matrix less those of the sensors."""
        pg, rg, yg = angles_of_matrix(self.C)
        pam, ram = angles_of_force(force)
        z = [pg - pam, math.remainder(rg - ram, 2.0 * math.pi)]
        R = [self.sigma_tilt**2] * 2
        if azimuth is not None:
            z.append(math.remainder(yg - azimuth, 2.0 * math.pi))
            R.append(self.sigma_heading**2)
        return np.array(z), self.sensitivity(force, azimuth is not None), np.diag(R)

    def sensitivity(self, force, with_azimuth):
        """(18): by differences: what a small error of each state does to z."""
        n = 3 if with_azimuth else 2
        H = np.zeros((n, 9))
        h = 1e-6
        for i in range(3):
            e = np.zeros(3)
            e[i] = h
            # the matrix that is off by e: C = exp(-e) C_true
            for sign in (1.0, -1.0):
                C = expm(skew(-sign * e)) @ self.C
                found = angles_of_matrix(C)
                H[:, i] += sign * np.array(found[:n]) / (2.0 * h)
                f = force + sign * e
                H[:2, 6 + i] -= sign * np.array(angles_of_force(f)) / (2.0 * h)
        return H
