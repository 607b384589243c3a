"""Decide whether the accelerometer is mirrored or the other signals are, from the frequency of each
case.

If an accelerometer outputs minus the specific force, all signals that distinguish left from right
need the other sign: yaw rate, steering angle, lateral acceleration, the wheels. A gyroscope does
not need the other sign: with it, such a sensor looks like a correct one that sits upside down and
backwards. If the axes of the accelerometer are a left-handed set, the gyroscope needs the other
sign too. The other signals may also have the other sign themselves, each for its own reason, or all
together in a vehicle that counts to the right. The data are the same in all these cases, but some
cases are much more frequent.
"""

from __future__ import annotations

from collections.abc import Mapping

MINUS = 0.1
"""Fraction of the accelerometers that output minus the specific force: 6 of some 25 senders of
public logs, half of them telephones.
"""
LEFT_HANDED, LEFT_HANDED_BY_PLACES = 0.01, 0.05
"""Fraction of the sensors whose axes are a left-handed set: if names give the order, and if places
in the message give it.
"""
GYRO_TURNED = 0.05
"""Fraction of the gyroscopes that have all signs turned while the accelerometer is correct;
estimated.
"""
ONE_TURNED = {"yaw_rate": 0.07, "steering_wheel_angle": 0.33, "lateral_acceleration": 0.2}
"""Fraction of the signals that count to the right. opendbc's databases turn 1 of 27 yaw rates and
15 of 46 steering angles (of few makers) by a negative factor; the value of lateral acceleration is
an estimate.
"""
ALL_TURNED = 0.05
"""Fraction of the vehicles in which all of them count to the right (axes of SAE J670, z down); an
estimate.
"""
PLACED_WRONG = 0.02
"""Fraction of the databases that exchange the wheels of left and right; an estimate."""
DOUBTED = 1.0 / 3.0
"""Probability of a mirrored accelerometer from which its sign counts as uncertain."""

SIDED = ("yaw_rate", "steering_wheel_angle", "lateral_acceleration")
AT_REST = "at rest, the axis that points up must show +1 g"
REMEDY = (
    "if the accelerometer outputs minus the specific force, or its axes are left-handed, set "
    "'sign: -1' on all three accelerometer axes and remove it from the other signals; "
    f"{AT_REST}"
)


def probability(turned: Mapping[str, bool], by_places: bool = False) -> float:
    """Return the probability that the accelerometer is mirrored.

    turned: for each quantity ("gyroscope", SIDED, "wheel_speeds"), whether it needs the other sign
    with the accelerometer as it is. Quantities with a separate sign bit are left out, because the
    bit means left in one vehicle and right in the next. by_places: True if no names identify the
    axes.
    """
    gyro = turned.get("gyroscope")
    own = 1.0 if gyro is None else GYRO_TURNED if gyro else 1.0 - GYRO_TURNED
    left_handed = LEFT_HANDED_BY_PLACES if by_places else LEFT_HANDED
    sound = (1.0 - MINUS - left_handed) * own * _likelihood(turned)
    opposite = _likelihood({name: not is_turned for name, is_turned in turned.items()})
    mirrored = (MINUS * own + (left_handed if gyro in (None, True) else 0.0)) * opposite
    return mirrored / (mirrored + sound)


def _likelihood(turned: Mapping[str, bool]) -> float:
    """Return the probability of these signs while the accelerometer is correct."""
    placed = turned.get("wheel_speeds")
    wheels = 1.0 if placed is None else PLACED_WRONG if placed else 1.0 - PLACED_WRONG
    of_one = of_all = 1.0
    for name in SIDED:
        if name in turned:
            part = ONE_TURNED[name] if turned[name] else 1.0 - ONE_TURNED[name]
            of_one, of_all = of_one * part, of_all * (1.0 - part)
    return wheels * ((1.0 - ALL_TURNED) * of_one + ALL_TURNED * of_all)


def names_of(turned: Mapping[str, bool]) -> str:
    """Return the quantities that need the other sign, in words: "yaw_rate and
    lateral_acceleration".
    """
    names = [name for name, is_turned in turned.items() if is_turned]
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1] if names else "")))
