"""Decide whether the accelerometer is mirrored or the other signals are, from the frequency of each
case.

If an accelerometer outputs the negative specific force, all signals that distinguish left from
right seem to have the wrong sign: yaw rate, steering angle, lateral acceleration, wheel speeds. The
gyroscope does not seem to have the wrong sign: together with the gyroscope, such an accelerometer
looks like a correct sensor that is mounted upside down and backwards. If the axes of the
accelerometer are left-handed, the gyroscope also seems to have the wrong sign. The signals may also
really have the wrong sign, each for its own reason, or all together in a vehicle that counts
positive to the right. The data are the same in all these cases, but some cases are much more
frequent than others.
"""

from __future__ import annotations

from collections.abc import Mapping

MINUS = 0.1
"""Fraction of the accelerometers that output the negative specific force: 6 of about 25 senders in
public logs, half of them telephones.
"""
LEFT_HANDED, LEFT_HANDED_BY_PLACES = 0.01, 0.05
"""Fraction of the sensors whose axes are left-handed: the first value if names identify the axes,
the second if only the places in the message do.
"""
GYRO_TURNED = 0.05
"""Assumed fraction of the gyroscopes that have all signs inverted while the accelerometer is
correct.
"""
ONE_TURNED = {"yaw_rate": 0.07, "steering_wheel_angle": 0.33, "lateral_acceleration": 0.2}
"""Fraction of the signals that are positive to the right. In opendbc's databases, a negative factor
inverts 1 of 27 yaw rates and 15 of 46 steering angles (of few makers). The fraction of the lateral
accelerations is an assumption.
"""
ALL_TURNED = 0.05
"""Assumed fraction of the vehicles in which all these signals are positive to the right (axes of
SAE J670, z down).
"""
PLACED_WRONG = 0.02
"""Assumed fraction of the databases that exchange the left and right wheels."""
DOUBTED = 1.0 / 3.0
"""Probability of a mirrored accelerometer above which the accelerometer's sign counts as
uncertain."""

SIDED = ("yaw_rate", "steering_wheel_angle", "lateral_acceleration")
AT_REST = "at rest, the axis that points up must show +1 g"
REMEDY = (
    "if the accelerometer outputs minus the specific force, or its axes are left-handed, set "
    "'sign: -1' on all three accelerometer axes and remove it from the other signals; "
    f"{AT_REST}"
)


def probability(turned: Mapping[str, bool], by_places: bool = False) -> float:
    """Return the probability that the accelerometer is mirrored.

    turned: True for each quantity ("gyroscope", SIDED, "wheel_speeds") whose sign must be inverted
    to fit the accelerometer. Quantities with a separate sign bit are left out, because the bit
    means left in some vehicles and right in others. by_places: True if no names identify the axes.
    """
    gyro = turned.get("gyroscope")
    own = 1.0 if gyro is None else GYRO_TURNED if gyro else 1.0 - GYRO_TURNED
    left_handed = LEFT_HANDED_BY_PLACES if by_places else LEFT_HANDED
    sound = (1.0 - MINUS - left_handed) * own * _likelihood(turned)
    opposite = _likelihood({name: not is_turned for name, is_turned in turned.items()})
    mirrored = (MINUS * own + (left_handed if gyro in (None, True) else 0.0)) * opposite
    return mirrored / (mirrored + sound)


def _likelihood(turned: Mapping[str, bool]) -> float:
    """Return the probability of these signs if the accelerometer is correct."""
    placed = turned.get("wheel_speeds")
    wheels = 1.0 if placed is None else PLACED_WRONG if placed else 1.0 - PLACED_WRONG
    of_one = of_all = 1.0
    for name in SIDED:
        if name in turned:
            part = ONE_TURNED[name] if turned[name] else 1.0 - ONE_TURNED[name]
            of_one, of_all = of_one * part, of_all * (1.0 - part)
    return wheels * ((1.0 - ALL_TURNED) * of_one + ALL_TURNED * of_all)


def names_of(turned: Mapping[str, bool]) -> str:
    """Return the names of the quantities whose sign must be inverted: "yaw_rate and
    lateral_acceleration".
    """
    names = [name for name, is_turned in turned.items() if is_turned]
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1] if names else "")))
