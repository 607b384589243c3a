"""Certainty of a direction of travel: deviation of the axis, and probability of the sign.

The deviation of the direction has three parts. The first part is the spread of the steps' axes
about their mean (doubled angles; circular statistics as in Mardia and Jupp, "Directional
Statistics", 2000). Four successive steps have the same disturbance. The second part is the
deviation of north. The third part is the angle between a person's way and the axis of the steps: 5
deg (Kunze and others, "Which way am I facing", ISWC 2009, trouser pockets).

The sign follows from a phase: the forward acceleration leads the vertical acceleration at the step
frequency. The lead is a quarter period at the trunk and 120 to 150 deg in a hand, so 120 +- 30 deg
is assumed. Phases about this lead have a von Mises distribution. The likelihood ratio of the two
signs is then exp(2 kappa c), with c the agreement between the phases of the steps and the lead. A
swinging arm is not pushed by the step, so a stronger swing makes the phase less informative. A
person who looks at a terminal mostly holds its upper edge ahead (the premise of the published
method, [0066]): in nine of ten cases. All these errors are systematic, so more steps do not reduce
them.
"""

from __future__ import annotations

import math

KAPPA = 1.0 / math.radians(30.0) ** 2
"""Concentration of the lead over persons and carrying positions, which spreads by 30 deg."""
ARM_SWING = 1.0
"""Mean square of the angular rate of a swinging arm [(rad/s)^2].

The value of a leg is 0.6. The value of a hand that holds the terminal before the eyes is below 0.1.
"""
LOOKED_AT_ODDS = 9.0
"""Odds that a person who looks at a terminal holds its upper edge ahead rather than behind."""
LOOKED_AT = 0.5
"""Smallest cosine of the screen's lean at which a person looks at the screen."""
AHEAD_KNOWN = 0.95
"""Probability of the sign below which a direction is ambiguous."""
SHARED_STEPS = 4.0
"""Number of successive steps with the same disturbance: two strides."""
WAY_STD = math.radians(5.0)
"""Deviation of a person's way from the axis of the steps [rad]."""
COMPASS_STD = math.radians(10.0)
"""Deviation of a heading signal [rad]. The value is the same as for a magnetometer in
`attitude.filter`."""
MAX_STD = math.pi / 2.0
MIN_HORIZONTAL = 0.1
"""Smallest horizontal part of the y axis at which the y axis has a heading.

With a smaller part, the axis is within 6 deg of the vertical. A lean of 1 deg then turns its
heading by 10 deg.
"""


def axis_std(agreement: float, steps: float) -> float:
    """Return the deviation of a mean axis [rad].

    agreement: resultant of the doubled angles, 0 to 1. steps: effective number of steps.
    """
    one = -0.5 * math.log(min(max(agreement, 1e-6), 1.0))  # of one step, squared
    return min(math.sqrt(one * min(SHARED_STEPS / steps, 1.0)), MAX_STD)


def sign_log_odds(agreement: float, swing: float) -> float:
    """Return the log odds of the sign that the phases favour.

    agreement: c, -1 to 1. swing: mean square of the angular rate about the level axes [(rad/s)^2].
    """
    return 2.0 * KAPPA * agreement / (1.0 + (swing / ARM_SWING) ** 2)


def edge_log_odds(along: float, screen_up: float, swing: float) -> float:
    """Return the log odds of a direction, from the upper edge of the terminal.

    along: cosine of the angle between direction and upper edge. screen_up: cosine of the screen's
    lean. swing: mean square of the angular rate about the level axes [(rad/s)^2].
    """
    if screen_up < LOOKED_AT:
        return 0.0
    return math.log(LOOKED_AT_ODDS) * along / (1.0 + swing / (0.1 * ARM_SWING))


def probability(log_odds: float) -> float:
    """Return the probability for these log odds."""
    return 1.0 / (1.0 + math.exp(-min(max(log_odds, -50.0), 50.0)))


def whole_std(axis: float, north: float) -> float:
    """Return the deviation of a direction [rad] from the deviations of the axis and of north."""
    return min(math.sqrt(axis * axis + north * north + WAY_STD**2), MAX_STD)
