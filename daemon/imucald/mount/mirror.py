"""Whether the accelerometer is mirrored, or the other signals are, by what is usual.

With an accelerometer that shows minus the specific force everything that says where left is needs
the other sign: yaw rate, steering angle, lateral acceleration, the wheels. A gyroscope does not: it
fits such a sensor as one that sits upside down and backwards. With one whose axes are a left-
handed set the gyroscope does too. But those signals may have the other sign themselves, each for a
reason of its own, or all of a vehicle that counts to the right. The drive is the same; how often
each of these happens is not.
"""

from __future__ import annotations

from collections.abc import Mapping

MINUS = 0.1
"""Part of the accelerometers that show minus the specific force: 6 of some 25 senders of public
logs, half of them telephones."""
LEFT_HANDED, LEFT_HANDED_BY_PLACES = 0.01, 0.05
"""Part of the sensors whose axes are a left-handed set: in the order of names, and of places."""
GYRO_TURNED = 0.05
"""Part of the gyroscopes that have all signs turned while the accelerometer is sound; estimated."""
ONE_TURNED = {"yaw_rate": 0.07, "steering_wheel_angle": 0.33, "lateral_acceleration": 0.2}
"""Part of the signals that count to the right: opendbc's databases turn 1 of 27 yaw rates and 15 of
46 steering angles (of few makers) by a negative factor; of lateral acceleration an estimate."""
ALL_TURNED = 0.05
"""Part of the vehicles in which all of them do (axes of SAE J670, z down); an estimate."""
PLACED_WRONG = 0.02
"""Part of the databases that exchange the wheels of left and right; an estimate."""
DOUBTED = 1.0 / 3.0
"""Probability from which the accelerometer is unsure."""

SIDED = ("yaw_rate", "steering_wheel_angle", "lateral_acceleration")
AT_REST = "at rest, the axis that points up must show +1 g"
REMEDY = (
    "if the accelerometer shows minus the specific force, or its axes are left-handed, set "
    "'sign: -1' on all three accelerometer axes and remove it from the other signals; "
    f"{AT_REST}"
)


def probability(turned: Mapping[str, bool], by_places: bool = False) -> float:
    """Probability that the accelerometer is mirrored.

    turned: by quantity ("gyroscope", SIDED, "wheel_speeds") whether it needs the other sign with
    the accelerometer as it is; without those whose sign is a bit of its own, which means left in
    one vehicle and right in the next. by_places: whether no names say which axis is which.
    """
    gyro = turned.get("gyroscope")
    own = 1.0 if gyro is None else GYRO_TURNED if gyro else 1.0 - GYRO_TURNED
    left_handed = LEFT_HANDED_BY_PLACES if by_places else LEFT_HANDED
    sound = (1.0 - MINUS - left_handed) * own * _likelihood(turned)
    opposite = _likelihood({name: not is_turned for name, is_turned in turned.items()})
    mirrored = (MINUS * own + (left_handed if gyro in (None, True) else 0.0)) * opposite
    return mirrored / (mirrored + sound)


def _likelihood(turned: Mapping[str, bool]) -> float:
    """Probability that these signals have these signs while the accelerometer is sound."""
    placed = turned.get("wheel_speeds")
    wheels = 1.0 if placed is None else PLACED_WRONG if placed else 1.0 - PLACED_WRONG
    of_one = of_all = 1.0
    for name in SIDED:
        if name in turned:
            part = ONE_TURNED[name] if turned[name] else 1.0 - ONE_TURNED[name]
            of_one, of_all = of_one * part, of_all * (1.0 - part)
    return wheels * ((1.0 - ALL_TURNED) * of_one + ALL_TURNED * of_all)


def names_of(turned: Mapping[str, bool]) -> str:
    """The quantities that need the other sign, in words: "yaw_rate and lateral_acceleration"."""
    names = [name for name, is_turned in turned.items() if is_turned]
    return " and ".join(filter(None, (", ".join(names[:-1]), names[-1] if names else "")))
