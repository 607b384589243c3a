"""The proposal for a gyroscope: unit, sign, order of axes, and doubts."""

from __future__ import annotations

from imucald.config_check.gyro_axes import GyroFit, Order, is_decided, right_handed_orders
from imucald.discovery.evidence import GAIN_TOLERANCE, UnitChoice, choose_unit, in_counts
from imucald.discovery.proposal import Alternative, Choice, Proposed, source_of
from imucald.discovery.scalars import SAME_MOTION
from imucald.discovery.triads import Triad
from imucald.inputs.units import is_unit

MAX_ALTERNATIVES = 3
RAW_COUNTS = (
    "the signal is in raw counts, since the database states no scale; the recording fits 'unit: {}'"
)


def axes_of(triad: Triad, unit: str, sign: int = 1) -> dict[str, Proposed]:
    """Return the sources of a triad (three signals x, y, z) by axis."""
    return {
        axis: source_of(member, unit, sign)
        for axis, member in zip("xyz", triad.members, strict=True)
    }


def gyroscope_choice(
    triad: Triad, fit: GyroFit, others: list[tuple[Triad, GyroFit]]
) -> tuple[Choice, Order, Triad]:
    """Return three results: the choice, the order and signs to apply, and the triad (three signals
    x, y, z) in its unit and order."""
    unit, doubt = _unit(triad, fit)
    places, signs = fit.order
    x, y, z = (triad.members[i] for i in places)
    ordered = Triad((x, y, z), unit, triad.names_axes)
    choice = Choice(
        "gyroscope",
        axes_of(ordered, unit.name, signs[0]),
        _evidence(triad, fit),
        _contradiction(fit) or doubt or _open_question(triad, fit),
        [Alternative(axes_of(t, t.unit.name, f.order[1][0]), "another one") for t, f in others][
            :MAX_ALTERNATIVES
        ],
    )
    return choice, ((0, 1, 2), signs), ordered


def _unit(triad: Triad, fit: GyroFit) -> tuple[UnitChoice, str]:
    """Return the unit from turns or gravity, and the reason for a doubt about the unit; the reason
    is empty if there is none."""
    found = fit.turning if fit.turning.is_believed else fit.carried
    unit = triad.unit
    # In a vehicle, lateral forces tilt the body and add to gravity, so the gain of a weak relation
    # to gravity shows no unit. In a hand, the relation is strong.
    if found.is_believed and found.low > 0.0 and found.explained >= SAME_MOTION:
        size = unit.factor  # the relation was taken in this unit
        low, high = size * found.low / GAIN_TOLERANCE, size * found.high * GAIN_TOLERANCE
        first = triad.members[0]
        fitting = choose_unit(first.unit, "angular_rate", low, high)
        if fitting is None and first.signal.scale == 1.0 and not is_unit(first.unit):
            counts = in_counts("angular_rate", low, high)
            others = f" (and {', '.join(counts.others)})" if counts.others else ""
            return counts, RAW_COUNTS.format(counts.name) + others
        return (
            (unit, "its values are too large or too small for every unit")
            if fitting is None
            else (fitting, "")
        )
    what = "sign" if unit.is_stated else "unit and sign"
    return unit, f"no speed confirms it in turns, so its {what} may be wrong"


def _contradiction(fit: GyroFit) -> str:
    if fit.is_contradicted:
        return "turns and slopes give different signs or axes"
    return ""


def _open_question(triad: Triad, fit: GyroFit) -> str:
    """Return a text about what the likelihoods do not decide (axes or signs); empty if they decide
    everything.
    """
    orders, signs = right_handed_orders(), fit.order[1]
    if not fit.is_believed:
        return "the recording has no turns or slopes that confirm it"
    if signs[0] < 0 and not is_decided(fit, [o for o in orders if o[1] != signs]):
        return "the sign is not certain"
    if not triad.names_axes and not is_decided(fit, orders):
        return "the axis of each signal is not certain"
    return ""


def _evidence(triad: Triad, fit: GyroFit) -> str:
    words = []
    if fit.turning.is_believed:
        words.append(
            "in turns, speed times its upward rate follows the acceleration to the left "
            f"(correlation {fit.turning.correlation:.2f})"
        )
    if fit.carried.is_believed:
        words.append(
            "its rates explain how gravity turns in the accelerometer (correlation "
            f"{fit.carried.correlation:.2f})"
        )
    if fit.order[1][0] < 0:
        words.append("its signs are opposite to the signs of the accelerometer axes")
    words.append(
        "the axes follow from the names"
        if triad.names_axes
        else "each axis was found from turns and gravity"
    )
    return "; ".join(words)
