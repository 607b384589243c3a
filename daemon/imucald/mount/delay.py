"""Delay of a vehicle signal against the accelerometer, from the phase of their spectra.

If a signal x has the delay tau, its spectrum is X(w) exp(-i w tau). The response of the force to x
is real. The right tau therefore maximises the real parts of the cross-spectrum, summed along the
direction of response (generalised cross-correlation; Knapp and Carter, IEEE Trans. ASSP 24, 1976).
Each bin is weighted by the inverse of the force's power.

`LeverArm` computes the force at a sensor that is away from the point whose motion is computed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from imucald.config.base import MAX_SPEED_DELAY, MIN_SPEED_DELAY
from imucald.core.arrays import Array
from imucald.core.rotations import Matrix3
from imucald.motion.ticks import TICK_S
from imucald.mount.estimator_settings import DelayPrior
from imucald.mount.evidence_spectra import OMEGA, WINDOW
from imucald.mount.signal_blocks import BLOCK_TICKS, SignalBlock

STEP = 0.025
"""Grid of candidates [s]."""
MIN_POWER = 2e-2
"""Smallest power of a window that is used [(m/s^2)^2]."""
MIN_WINDOWS = 3
KNOWN_STD = 0.2
"""Deviation below which a delay counts as known [s]: dv/dt of a manoeuvre of some seconds then
correlates.
"""
SEARCHED_STD = 0.1
"""Deviation [s] up to which a prior counts as a stated delay: only four deviations are searched.
"""


class DelaySearch:
    """Sums of cross-spectra of one signal with the force, and the search for the delay in them.

    A solver that begins from another one continues the same search, because the delay belongs to
    the signal and not to the mount. Blocks that such a solver reads again are already in the sums.
    """

    def __init__(self, prior: DelayPrior) -> None:
        self._prior = prior
        reach = 4.0 * prior.std if prior.std <= SEARCHED_STD else math.inf
        low = max(MIN_SPEED_DELAY, prior.mean - reach)
        high = min(MAX_SPEED_DELAY, prior.mean + reach)
        self._taus = np.arange(low, high + 0.5 * STEP, STEP) if prior.std > 0 else np.zeros(1)
        self._phases = np.exp(1j * np.outer(self._taus, OMEGA))
        self._cross = np.zeros((len(OMEGA), 3), dtype=np.complex128)
        self._powers = np.zeros((2, len(OMEGA)))  # of the signal, and of the force
        self.windows = 0
        self._until = -math.inf  # end of the last window that was taken [s]
        self.value = prior.mean
        self.std = prior.std
        self._best = prior.mean

    @property
    def is_known(self) -> bool:
        """True if the delay is known well enough to compare the shifted signal with the force."""
        return self.std < KNOWN_STD and not self.is_beyond

    @property
    def is_beyond(self) -> bool:
        """True if the best delay is the largest searched delay: the true delay may be larger."""
        is_sought = self._prior.std > SEARCHED_STD and self.std < self._prior.std
        return is_sought and self._best >= float(self._taus[-1]) - STEP

    def add(self, signal: NDArray[np.complex128], force: NDArray[np.complex128], t: float) -> bool:
        """Take spectra of a window that ends at t [s]: signal (BINS,), force (BINS, 3).

        Returns whether it was new: each window is taken once.
        """
        if t <= self._until:
            return False
        self._until = t
        re, im = signal.real, signal.imag
        power = re * re + im * im
        if power.sum() < MIN_POWER:
            return True
        self.windows += 1
        x, y = force.real, force.imag
        self._cross.real += re[:, None] * x + im[:, None] * y
        self._cross.imag += re[:, None] * y - im[:, None] * x
        self._powers[0] += power
        self._powers[1] += (x * x + y * y).sum(axis=1)
        return True

    def search(self) -> float:
        """Return the delay [s]; `std` is its standard deviation."""
        p = self._prior
        if p.std <= 0.0 or self.windows < MIN_WINDOWS:
            return self.value
        power, of_force = self._powers
        weight = 1.0 / (of_force + 0.02 * of_force.max() + 1e-9)
        # force is x(t) and the signal x(t - tau): conj(signal) * force = P exp(+i w tau)
        gain = (np.conj(self._phases) @ (self._cross * weight[:, None])).real
        size = np.sqrt((gain * gain).sum(axis=1))
        best = int(np.argmax(size))
        tau = float(self._taus[best])
        if 0 < best < len(size) - 1:
            a, b, c = size[best - 1], size[best], size[best + 1]
            bend = a - 2.0 * b + c
            if bend < 0.0:
                tau += STEP * 0.5 * float((a - c) / bend)
        self._best = float(self._taus[best])
        d = gain[best] / max(float(size[best]), 1e-12)
        along = (self._cross @ d) * np.exp(-1j * OMEGA * tau)
        coherence2 = np.minimum((along.real**2) / np.maximum(power * of_force, 1e-12), 0.98)
        information = float((2.0 * OMEGA**2 * coherence2 / (1.0 - coherence2)).sum())
        information *= self.windows * (BLOCK_TICKS / WINDOW)
        prior = 1.0 / (p.std * p.std)
        self.value = (information * tau + prior * p.mean) / (information + prior)
        self.std = 1.0 / math.sqrt(information + prior)
        return self.value


class LeverArm:
    """arm: (3,) from that point to the sensor, vehicle axes [m]."""

    def __init__(self, arm: Array) -> None:
        self._arm = arm
        self._is_long = bool(self._arm.any())
        self._last_rate: Array | None = None

    def __bool__(self) -> bool:
        return self._is_long

    def restart(self) -> None:
        """Restart after a jump of time."""
        self._last_rate = None

    def force(self, p: SignalBlock, R: Matrix3) -> Array:
        """Return the additional specific force at the sensor, sensor axes (N, 3) [m/s^2].

        The force is dw/dt x l + w x (w x l). The derivative is a central difference, which has no
        delay.
        """
        rate = p.rate @ R.T
        before = rate[:1] if self._last_rate is None else self._last_rate
        self._last_rate = rate[-1:]
        change = np.gradient(np.concatenate([before, rate]), TICK_S, axis=0)[1:]
        carried = np.cross(change, self._arm) + np.cross(rate, np.cross(rate, self._arm))
        return np.asarray((carried * p.ok_rate[:, None]) @ R)
