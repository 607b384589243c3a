"""Method B over an interval between two average speeds, in the form that the filter uses.

The gyroscope's matrix C transforms all vectors into the frame P. Consider the mean over [t0, t1] of
the specific force minus a_fwd and omega x v. This mean equals the mean force minus the change of
the velocity *vector*:
    mean(C (f - a_fwd y - omega x v y)) = mean(C f) - (C_1 y v_1 - C_0 y v_0) / (t1 - t0),
The reason is d(C y v)/dt = C (y dv/dt + omega x y v), with y the direction of motion. The speed is
the only signal that is differentiated. A slow or late speed is combined with the force at the same
time. A lever arm l adds C (omega x l) to the velocity. The remaining force is gravity in P, plus
error.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from imucald.attitude.propagation import IntegralSnapshot
from imucald.config.attitude import MotionCompensationSettings
from imucald.core.rotations import Vector

SLOW_ERROR_S = 1.0
"""Duration of an error of a mean specific force [s]."""
MIN_LEVEL = 0.5
"""Cosine of the steepest slope for which a horizontal speed is converted to a speed along the
body."""


class Interval(NamedTuple):
    """Gravity in P over an interval, and the quantities that determine its uncertainty.

    up: mean specific force minus motion, frame P [m/s^2]. t0, t1: begin and end [s]. speed: mean
    speed [m/s] or NaN. forward_acceleration: acceleration of the vehicle [m/s^2]. force_variance:
    variance of one force sample about the mean [(m/s^2)^2], all axes together. n: number of force
    samples. rate: mean of the raw gyroscope [rad/s]. rate_variance: variance of one rate sample
    about each axis [(rad/s)^2]. angle: turned angle [rad]. sigma_forward, sigma_lateral: standard
    deviation of `up` along the body's axes [m/s^2].
    """

    up: Vector
    t0: float
    t1: float
    speed: float
    forward_acceleration: float
    force_variance: float
    n: float
    rate: Vector
    rate_variance: Vector
    angle: float
    sigma_forward: float
    sigma_lateral: float

    @property
    def duration(self) -> float:
        """Duration of the interval [s]."""
        return self.t1 - self.t0


class Endpoint(NamedTuple):
    """An end of an interval: the running integrals and the speed at this time [m/s]; NaN if not
    known.

    age: age of the speed at this time [s]; 0 if the speed is not extrapolated.
    """

    snapshot: IntegralSnapshot
    speed: float
    age: float = 0.0


def along_body(endpoint: Endpoint, up: Vector) -> Endpoint:
    """Return an endpoint with its horizontal speed converted to the speed along the body."""
    rise = sum(a * b for a, b in zip(endpoint.snapshot.forward, up, strict=True))
    level = math.sqrt(max(1.0 - rise * rise, MIN_LEVEL**2))
    return endpoint._replace(speed=endpoint.speed / level)


def interval(
    first: Endpoint,
    last: Endpoint,
    settings: MotionCompensationSettings,
    noise: Vector,
    unknown: float,
    scatter_since: IntegralSnapshot | None = None,
) -> Interval:
    """Make the interval between two endpoints of one segment.

    noise: deviation of a mean specific force over a second or more, along forward, left, up
    [m/s^2]. unknown: deviation of an acceleration without speed [m/s^2]. scatter_since: snapshot
    from which the scatter of the samples is computed, because few samples do not show their
    scatter. The default is the beginning of the interval.
    """
    a, b = first.snapshot, last.snapshot
    T = b.t - a.t
    mean = tuple((y - x) / T for x, y in zip(a.force, b.force, strict=True))
    v0, v1 = first.speed, last.speed
    known = not math.isnan(v0) and not math.isnan(v1)
    if known:
        velocity = zip(a.forward, a.arm, b.forward, b.arm, strict=True)
        change = tuple(((q * v1 + s) - (p * v0 + r)) / T for p, r, q, s in velocity)
    else:
        change = (0.0, 0.0, 0.0)
    up = (mean[0] - change[0], mean[1] - change[1], mean[2] - change[2])
    n = max(b.n - a.n, 1.0)
    w = scatter_since or a
    force_variance = _spread(b.n - w.n, w.body, b.body, b.square - w.square)
    k = 1.0 / max(b.turns - a.turns, 1.0)
    rx, ry, rz = ((y - x) * k for x, y in zip(a.rate, b.rate, strict=True))
    xx, yy, zz = ((y - x) * k for x, y in zip(a.rate_square, b.rate_square, strict=True))
    rate_variance = (max(xx - rx * rx, 0.0), max(yy - ry * ry, 0.0), max(zz - rz * rz, 0.0))
    lateral = sum(c * 0.5 * (p + q) for c, p, q in zip(change, a.right, b.right, strict=True))
    forward = (v1 - v0) / T if known else 0.0
    of_mean = force_variance / n
    # An error that lasts for a second is the same in all shorter intervals within it.
    share = max(SLOW_ERROR_S / T, 1.0)
    nx, ny = noise[0] * noise[0] * share, noise[1] * noise[1] * share
    sigmas = (unknown, unknown)
    if known:
        sigmas = _known_sigma(first, last, settings, forward, lateral, unknown)
    return Interval(
        up,
        a.t,
        b.t,
        0.5 * (v0 + v1),
        forward,
        force_variance,
        n,
        (rx, ry, rz),
        rate_variance,
        b.angle - a.angle,
        math.sqrt(sigmas[0] ** 2 + (nx + of_mean)),
        math.sqrt(sigmas[1] ** 2 + (ny + of_mean)),
    )


def shared(found: Interval) -> Interval:
    """Return the same interval if its samples are used twice: in pieces, and in the interval from
    one speed to the next.

    Along the direction of motion, pieces give almost no information.
    """
    return found._replace(sigma_lateral=math.sqrt(2.0) * found.sigma_lateral)


def _known_sigma(
    first: Endpoint,
    last: Endpoint,
    settings: MotionCompensationSettings,
    forward: float,
    lateral: float,
    unknown: float,
) -> tuple[float, float]:
    """Return the deviation of the motion correction, along and across the direction of motion
    [m/s^2].

    The deviation along the motion contains noise and scale error of the speed, and the centripetal
    acceleration of an unknown lever arm. The noise is larger while the vehicle creeps, because its
    speed signal may still be zero. The deviation across the motion contains the scale error, and
    the change of the side-slip, which acts like an unknown lever arm.

    If the speed is old, an acceleration of size `unknown` since this speed is assumed. All
    intervals that use this speed have the same error, so each interval gets its share of the age.
    """
    T = last.snapshot.t - first.snapshot.t
    age = max(first.age, last.age)
    if first.speed == 0.0 and last.speed == 0.0 and not age:
        return 0.0, 0.0
    noise = settings.speed_noise * math.sqrt(2.0)
    if min(abs(first.speed), abs(last.speed)) < settings.creep_speed:
        noise += 0.3 * settings.creep_speed
    r0, r1 = first.snapshot.up_rate, last.snapshot.up_rate
    arm = settings.lever_uncertainty
    # If one speed is used at both ends, its noise is no acceleration; the change since then is.
    of_speed = unknown * unknown * max(age / T, 1.0) if age else (noise / T) ** 2
    along = of_speed + (settings.speed_scale * forward) ** 2
    along += (arm * 0.5 * (r0 * r0 + r1 * r1)) ** 2 + (settings.speed_scale * lateral) ** 2
    across = (settings.speed_scale * lateral) ** 2 + (arm * (r1 - r0) / T) ** 2
    across += (settings.speed_scale * forward) ** 2
    across += (unknown * age * 0.5 * (r0 + r1)) ** 2
    return math.sqrt(along), math.sqrt(across)


def _spread(n: float, low: Vector, high: Vector, square: float) -> float:
    """Return the variance of one sample, from count and differences of running sums."""
    n = max(n, 1.0)
    mean_square = sum((y - x) * (y - x) for x, y in zip(low, high, strict=True)) / n
    return max((square - mean_square) / n, 0.0)
