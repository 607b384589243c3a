"""The road: slope and cross fall as sums of sinusoids of the distance, and its roughness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hidden.numerics import Array, fast_length, stream
from hidden.world import World

LINES = 220
"""Sinusoids in each of slope and cross fall."""
SHORTEST_M = 16.0
"""Shorter waves are roughness."""
CALM_MPS = 15.0
"""Roads for faster traffic have longer waves."""
PROFILE_STEP_M = 0.05
PATCH_M = 6000.0
"""Length of rough road that is made; it comes again after that."""


@dataclass(frozen=True)
class Road:
    """The road under the vehicle at each moment, (N,)."""

    slope: Array
    """Angle [rad], positive uphill."""
    fall: Array
    """Angle [rad], positive left side up."""
    wheels: Array
    """(N, 4) height of the unevenness under each wheel [m]: front left, right, rear left, right."""


def road_under(world: World, speed: Array, rate: float) -> Road:
    """Lay a road under a vehicle that drives at `speed` (N,), signed [m/s]."""
    calm = np.sqrt(1.0 + (speed / CALM_MPS) ** 2)
    # Distance, counted slower where the road is made for speed.
    passed = np.cumsum(speed / calm) / rate
    slope = world.grade_rms * _undulation(world.seed, "slope", passed, world.grade_length)
    fall = world.crown + world.bank_rms * _undulation(world.seed, "fall", passed, world.bank_length)
    return Road(np.arctan(slope), np.arctan(fall), _unevenness(world, speed, rate))


def _undulation(seed: int, name: str, at: Array, length: float) -> Array:
    """Unit-rms sum of sinusoids with the density 1 / (1 + (k L)^2)^2 of a twice-filtered walk."""
    rng = stream(seed, f"road:{name}")
    edges = np.geomspace(1.0 / (25.0 * length), 2.0 * np.pi / SHORTEST_M, LINES + 1)
    k = edges[:-1] + (edges[1:] - edges[:-1]) * rng.random(LINES)
    power = np.diff(edges) / (1.0 + (k * length) ** 2) ** 2
    amplitude = np.sqrt(2.0 * power / power.sum())
    phase = 2.0 * np.pi * rng.random(LINES)
    first, last = float(at.min()), float(at.max())
    nodes = np.arange(first - 2.0, last + 3.0)
    angle = np.outer(nodes, k) + phase
    value = np.sin(angle) @ amplitude
    gradient = np.cos(angle) @ (amplitude * k)
    # Cubic between nodes a metre apart, from value and gradient.
    i = (at - nodes[0]).astype(np.int64)
    u = at - nodes[i]
    rise = value[i + 1] - value[i]
    bent = gradient[i] + gradient[i + 1] - 2.0 * rise
    result: Array = value[i] + u * (gradient[i] + u * ((rise - gradient[i] - bent) + u * bent))
    return result


def _unevenness(world: World, speed: Array, rate: float) -> Array:
    """Heights under the wheels by ISO 8608: density G(n0) (n / n0)^-2, random phases."""
    rng = stream(world.seed, "road:roughness")
    size = fast_length(int(PATCH_M / PROFILE_STEP_M))
    n = np.fft.rfftfreq(size, PROFILE_STEP_M)

    def profile(longest: float) -> Array:
        density = world.roughness_n0 * (np.maximum(n, 1e-9) / 0.1) ** -2.0
        density *= 1.0 / (1.0 + (1.0 / np.maximum(n * longest, 1e-9)) ** 6)
        # Averaged over the tyre's contact.
        density *= np.exp(-((n * 0.25) ** 2) * 4.0)
        spectrum = np.sqrt(0.5 * density * size / PROFILE_STEP_M)
        spectrum = spectrum * np.exp(2j * np.pi * rng.random(len(n)))
        spectrum[0] = 0.0
        return np.asarray(np.fft.irfft(spectrum, size))

    # Long waves lift both tracks equally; short ones are each track's own.
    both, left, right = profile(60.0), profile(15.0), profile(15.0)
    distance = np.cumsum(speed) / rate
    ease = 1.0 / np.sqrt(1.0 + (speed / CALM_MPS) ** 2)
    length = size * PROFILE_STEP_M
    grid = np.arange(size + 1) * PROFILE_STEP_M

    def under(height: Array, ahead: float) -> Array:
        at = np.mod(distance + ahead, length)
        return np.asarray(np.interp(at, grid, np.append(height, height[0])))

    rear = world.to_front - world.wheelbase
    columns = []
    for ahead in (world.to_front, rear):
        common = under(both, ahead) / np.sqrt(2.0)
        columns += [ease * (common + under(own, ahead) / np.sqrt(2.0)) for own in (left, right)]
    return np.column_stack(columns)
