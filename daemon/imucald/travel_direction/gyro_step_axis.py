"""The alternative to the published method: attitude by gyroscope, axis by power, sign by phase.

In a level frame, the forward acceleration of a step oscillates at the step frequency. The sideways
sway oscillates at half of this frequency. The acceleration at the step frequency therefore gives an
axis by its power, and a sign by its phase relative to the vertical acceleration. Axis and sign are
averaged over some steps in a frame that turns with the terminal. A person who turns keeps the
terminal in the same position on the body, and rarely changes this position.
"""

from __future__ import annotations

import cmath
import math

import numpy as np
from numpy.typing import NDArray

from imucald.config.attitude import AlternativeSettings
from imucald.core.rotations import Vector
from imucald.travel_direction.certainty import MAX_STD, axis_std
from imucald.travel_direction.step_cycles import POINTS, StepCycle

ComplexArray = NDArray[np.complex128]

SWING_POWER = 0.5
"""Mean square of the angular rate at which a terminal counts as swinging [(rad/s)^2]. The value of
a leg is 0.7."""


class GyroStepAxis:
    """Direction of travel from step cycles in the level frame.

    Angles are clockwise from the y axis of the level frame.
    """

    def __init__(self, settings: AlternativeSettings) -> None:
        self.settings = settings
        self.restart()

    def restart(self) -> None:
        """Forget how the terminal is carried."""
        self._axis = 0j  # doubled angle, weighed by power
        self._sign = 0j  # angle, by phase
        self._power = 0.0
        self._forward = 0.0  # amplitude along the axis, without its phase
        self._swing_power = 0.0
        self._weight = self._square_weight = 0.0
        self._turned = math.nan
        self._up: Vector | None = None
        self._before: tuple[float, ComplexArray] | None = None

    def take_cycle(self, cycle: StepCycle, turned: float, up_in_terminal: Vector) -> float | None:
        """Return the direction after this cycle [0, 2 pi); None if not known.

        turned: total turn about the vertical, clockwise [rad]. up_in_terminal: (3,) unit vector up
        in terminal axes.
        """
        self._carried(up_in_terminal)
        change = 0.0 if math.isnan(self._turned) else turned - self._turned
        self._turned = turned
        turn = cmath.exp(1j * change)
        keep = math.exp(-1.0 / self.settings.memory_steps)
        east, north, up = self._swing(cycle)
        vertical = abs(up)
        if vertical == 0.0:
            return None
        power = abs(east) ** 2 + abs(north) ** 2
        axis = complex(abs(north) ** 2 - abs(east) ** 2, 2.0 * (north * east.conjugate()).real)
        rate_power = float(np.mean(np.sum(cycle.turning**2, axis=1)))
        swung, swing_axis = self._pendulum(cycle)
        power += swung
        axis -= swing_axis  # legs and arms swing about an axis across the direction of travel
        # The signed part that leads the vertical by this phase.
        lead = up.conjugate() / vertical * cmath.exp(-1j * self.settings.lead)
        sign = complex((north * lead).real, (east * lead).real)
        self._axis = keep * self._axis * turn * turn + axis
        self._sign = keep * self._sign * turn + sign
        self._power = keep * self._power + power
        if self._axis == 0j or self._sign == 0j:
            return None
        angle = 0.5 * cmath.phase(self._axis)
        if math.cos(angle - cmath.phase(self._sign)) < 0.0:
            angle += math.pi
        along = abs(north * math.cos(angle) + east * math.sin(angle))
        self._forward = keep * self._forward + along
        self._swing_power = keep * self._swing_power + rate_power
        self._weight = keep * self._weight + 1.0
        self._square_weight = keep * keep * self._square_weight + 1.0
        return angle % math.tau

    def _swing(self, cycle: StepCycle) -> tuple[complex, complex, complex]:
        """Return the amplitudes at the step frequency, in x, y, up.

        The amplitudes are the mean of this step and the previous step. Sway at half of the
        frequency leaks into both steps with opposite signs, because one step is with the left foot
        and the other with the right foot. The mean removes the sway.
        """
        first = np.fft.fft(cycle.level, axis=0)[1] / POINTS
        before, self._before = self._before, (cycle.t1, first)
        if before is not None and abs(cycle.t0 - before[0]) < 0.1 * cycle.duration:
            first = 0.5 * (first + before[1])
        east, north, up = (complex(c) for c in first)
        return east, north, up

    @staticmethod
    def _pendulum(cycle: StepCycle) -> tuple[float, complex]:
        """Return the power of rotations about horizontal axes, and this power with the doubled
        angle of the rotation axis.

        Both results are large for a terminal that swings with a leg or an arm, and small for a
        terminal that is held still.
        """
        x, y = cycle.turning[:, 0], cycle.turning[:, 1]
        xx, yy, xy = (float(np.mean(c)) for c in (x * x, y * y, x * y))
        power = xx + yy
        part = power / (power + SWING_POWER)
        return part * power, part * complex(yy - xx, 2.0 * xy)

    @property
    def trust(self) -> float:
        """Agreement of the steps' axes, 0 to 1."""
        return min(abs(self._axis) / self._power, 1.0) if self._power > 0.0 else 0.0

    @property
    def std(self) -> float:
        """Deviation of the axis in the terminal's level frame [rad]."""
        if self._weight <= 0.0:
            return MAX_STD
        return axis_std(self.trust, self._weight * self._weight / self._square_weight)

    @property
    def phase_agreement(self) -> float:
        """Agreement of the steps' phases with the chosen sign, 0 to 1."""
        if self._forward <= 0.0:
            return 0.0
        off = cmath.phase(self._sign) - 0.5 * cmath.phase(self._axis)
        return min(abs(self._sign) * abs(math.cos(off)) / self._forward, 1.0)

    @property
    def swing(self) -> float:
        """Mean square of the angular rate about the level axes over the last steps [(rad/s)^2]."""
        return self._swing_power / self._weight if self._weight > 0.0 else 0.0

    def _carried(self, up: Vector) -> None:
        if self._up is not None:
            cosine = sum(a * b for a, b in zip(up, self._up, strict=True))
            if cosine < math.cos(self.settings.carry_change):
                self.restart()
                self._up = up
                return
            k = 1.0 / self.settings.memory_steps
            mixed = [b + k * (a - b) for a, b in zip(up, self._up, strict=True)]
            size = math.sqrt(sum(c * c for c in mixed)) or 1.0
            up = (mixed[0] / size, mixed[1] / size, mixed[2] / size)
        self._up = up
