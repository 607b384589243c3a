"""Measurements z of method C and their dependence on the nine states.

z is the difference between the attitude of the propagated matrix and the measured attitude: pitch
and roll from the accelerometer, heading from the heading input. The rate of the gyroscope at rest
is a further measurement, which is not in the publication.
"""

from __future__ import annotations

import math

import numpy as np

from imucald.attitude.interval import Interval
from imucald.attitude.kalman import STATES, Measurement
from imucald.attitude.right_forward_up import vehicle_angles, wrapped
from imucald.core.rotations import Rows, Vector, times, transposed_times
from imucald.core.samples import GRAVITY

MIN_UP = 0.3 * GRAVITY
"""Smallest force that counts as gravity [m/s^2]. A smaller force comes from a fall or a broken
sensor."""
REST_RATE_STD = math.radians(0.003)
"""Assumed rate of a standing vehicle while people get in [rad/s]."""


def tilt(
    interval: Interval, gravity: Vector, C: Rows, accel_error: Vector, lag: float
) -> list[Measurement]:
    """Return two measurements: pitch and roll of the propagated matrix minus pitch and roll from
    the accelerometer. The noise comes from `interval`.

    gravity: specific force without motion over the interval, rotated by the propagated matrix to
    east, north, up [m/s^2]. With a correct matrix, this vector points up. The differences are
    rotations about the level axes right and forward of the vehicle, which avoids a singularity. For
    small errors, these rotations equal the differences of the angles. C: present C_nav_from_body.
    accel_error: accelerometer error in body axes [m/s^2]. lag: age of the middle of the interval
    [s]; the gyroscope's error has rotated the matrix since then.
    """
    d = times(C, accel_error)
    east, north, up = gravity[0] - d[0], gravity[1] - d[1], gravity[2] - d[2]
    if math.sqrt(east * east + north * north + up * up) < MIN_UP:
        return []
    heading = vehicle_angles(C)[2]
    s, c = math.sin(heading), math.cos(heading)
    right, forward = (c, -s, 0.0), (s, c, 0.0)
    speed = 0.0 if math.isnan(interval.speed) else interval.speed
    h_pitch, h_roll = np.zeros(STATES), np.zeros(STATES)
    for h, axis, other, sign in ((h_pitch, right, forward, -1.0), (h_roll, forward, right, 1.0)):
        h[0:3] = [-a for a in axis]
        h[3:6] = [-lag * a for a in transposed_times(C, axis)]
        h[6:9] = [sign * a / GRAVITY for a in transposed_times(C, other)]
    # A wrong turn rate subtracts a centripetal acceleration that does not exist: v b to the right.
    h_roll[3:6] += [speed * a / GRAVITY for a in transposed_times(C, (0.0, 0.0, 1.0))]
    z_pitch = -math.atan2(forward[0] * east + forward[1] * north, up)
    z_roll = math.atan2(right[0] * east + right[1] * north, up)
    return [
        (h_pitch, z_pitch, (interval.sigma_forward / GRAVITY) ** 2, True),
        (h_roll, z_roll, (interval.sigma_lateral / GRAVITY) ** 2, True),
    ]


def rest_rates(
    interval: Interval, bias: Vector, noise: Vector, known: Vector, resolution: float = 0.0
) -> list[Measurement]:
    """Return the measurement at rest: a gyroscope at rest shows its own error.

    bias: known part of this error [rad/s]. noise: noise density. known: present variance of each
    axis's error [(rad/s)^2]. resolution: step size of the signal [rad/s]. The rounding error is the
    same in every rest, so further rests cannot reduce the error below the rounding error.
    """
    of_mean = sum(interval.rate_variance) / (3.0 * interval.n)
    rounded = rounding(interval.rate_variance, resolution)
    measurements: list[Measurement] = []
    for i in range(3):
        if known[i] <= rounded:
            continue
        h = np.zeros(STATES)
        h[3 + i] = 1.0
        variance = noise[i] * noise[i] / interval.duration + of_mean + REST_RATE_STD**2
        # With rounding alone, 1 / known + 1 / variance would be 1 / rounded.
        variance += rounded * known[i] / (known[i] - rounded)
        measurements.append((h, interval.rate[i] - bias[i], variance, True))
    return measurements


def rounding(spread: Vector, resolution: float) -> float:
    """Return the variance of the mean of rounded numbers about the mean of the true numbers.

    spread: variance of a rounded number, for each axis; the smallest is used. For a signal without
    noise, the variance is step^2 / 12. Vibration reduces the rounding error (dither). Noise of size
    s reduces the variance by the factor exp(-2 (pi s / step)^2). A tone of amplitude A, as from an
    idling engine, reduces the error by the factor J0(2 pi A / step), whose size is below sqrt(step
    / A) / pi (Widrow and Kollar, Quantization Noise, 2008: the first term of the sum). Whether
    noise or a tone is present is not known, so the larger result is used. The rounding itself adds
    step^2 / 12 to the spread (Sheppard).
    """
    if resolution == 0.0:
        return 0.0
    most = resolution**2 / 12.0
    noise = max(min(spread) - most, 0.0)
    amplitude = math.sqrt(2.0 * noise) / resolution
    left = most * math.exp(-4.0 * math.pi**2 * noise / resolution**2)
    if amplitude > 0.0:
        left = max(left, resolution**2 / (2.0 * math.pi**4 * amplitude))
    return min(left, most)


def heading_difference(heading: float, C: Rows, noise: float) -> Measurement:
    """Return the measurement of a heading input [rad] minus the heading of the propagated matrix.
    `HeadingSource` rejects wrong headings.

    The angle of the publication is counter-clockwise and a heading is clockwise, so the operands
    are exchanged.
    """
    h = np.zeros(STATES)
    h[2] = -1.0
    return h, wrapped(heading - vehicle_angles(C)[2]), noise * noise, False
