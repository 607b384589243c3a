"""Detect a mirrored accelerometer. With a mirrored accelerometer, all signals with left and right
seem to have the wrong sign."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from imucald.discovery.heading import HeadingFit
from imucald.discovery.names import WHEELS
from imucald.discovery.proposal import Choice, Proposed
from imucald.discovery.sensors import BY_PLACES
from imucald.discovery.wheels import BY_TURNS, EXCHANGED, IN_ORDER
from imucald.mount.mirror import DOUBTED, REMEDY, SIDED, names_of, probability

WITH_IT = "its sign depends on the signs of the accelerometer, which are unsure"


def hold_against_usual_signs(choices: Sequence[Choice], heading: HeadingFit | None) -> None:
    """Add a doubt to an accelerometer that may be mirrored. Reverse the accelerometer if a mirrored
    accelerometer is more likely than wrong signs of all other signals.

    If a compass is on the bus, nothing is changed, because the compass has already decided.
    """
    by_name = {choice.quantity: choice for choice in choices}
    accelerometer = by_name.get("accelerometer")
    if accelerometer is None or len(accelerometer.sources) < 3 or accelerometer.doubt:
        return
    if heading is not None and heading.is_like_a_compass:
        return
    turned = _turned(by_name)
    by_places = BY_PLACES in accelerometer.evidence
    likely = probability(turned, by_places)
    if likely < DOUBTED:
        return
    names = names_of(turned)
    for name in SIDED:
        if name in turned:
            by_name[name].doubt = WITH_IT
    # if names do not show the axes, the database may not use the usual signs either
    if likely <= 0.5 or by_places or not any(turned.get(name) for name in SIDED):
        accelerometer.doubt = f"with the present signs, {names} would need 'sign: -1': {REMEDY}"
        return
    accelerometer.doubt = (
        f"'sign: -1' is set on all axes, since {names} would need 'sign: -1' otherwise: the sensor "
        "outputs minus the specific force, or its axes are left-handed (probability "
        f"{100 * likely:.0f} %). Check it at rest: if the axis that points up does not show "
        "+1 g, remove 'sign: -1' here"
    )
    accelerometer.sources = {k: _other(s) for k, s in accelerometer.sources.items()}
    for name in SIDED:
        if name in turned:
            choice = by_name[name]
            choice.sources = {k: _other(s) for k, s in choice.sources.items()}
            choice.evidence += "; its sign fits the accelerometer with 'sign: -1'"
    _exchange_wheels(by_name.get("wheel_speeds"))


def doubt_both_sensors(choices: Sequence[Choice], contradiction: str) -> None:
    """Add a doubt to an accelerometer and a gyroscope that contradict each other, and to all signs
    that follow from them."""
    for choice in choices:
        if choice.quantity == "gyroscope":
            choice.doubt = contradiction
        elif choice.quantity == "accelerometer":
            choice.doubt = choice.doubt or contradiction
        elif choice.quantity in SIDED or BY_TURNS in choice.evidence:
            choice.doubt = choice.doubt or WITH_IT


def _exchange_wheels(wheels: Choice | None) -> None:
    if wheels is not None and wheels.doubt == EXCHANGED:
        wheels.doubt = ""
    elif wheels is not None and BY_TURNS in wheels.evidence:
        fl, fr, rl, rr = (wheels.sources[wheel] for wheel in WHEELS)
        wheels.sources = dict(zip(WHEELS, (fr, fl, rr, rl), strict=True))


def _other(source: Proposed) -> Proposed:
    return replace(source, sign=-source.sign)


def _has_sign_bit(choice: Choice) -> bool:
    return any(source.sign_signal is not None for source in choice.sources.values())


def _turned(by_name: dict[str, Choice]) -> dict[str, bool]:
    """Return True or False for each signal with left and right whose sign is known: whether its
    sign must be inverted."""
    turned = {}
    for name in ("gyroscope", *SIDED):
        choice = by_name.get(name)
        if choice is not None and choice.is_sure and not _has_sign_bit(choice):
            turned[name] = all(source.sign < 0 for source in choice.sources.values())
    wheels = by_name.get("wheel_speeds")
    if wheels is not None and IN_ORDER in wheels.evidence:
        turned["wheel_speeds"] = False
    elif wheels is not None and wheels.doubt == EXCHANGED:
        turned["wheel_speeds"] = True
    return turned
