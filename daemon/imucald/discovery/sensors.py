"""Find accelerometer, speed, gyroscope and magnetometer. All other signals are compared with these
sensors."""

from __future__ import annotations

from collections.abc import Sequence

from imucald.config_check.gyro_axes import (
    AS_IT_IS,
    RIGHT_HANDED,
    TILTS_DIFFERENTLY,
    GyroFit,
    Order,
    fit_gyroscope,
    signed,
    tilt_ratio,
)
from imucald.config_check.relation import BELIEVED_NATS, Relation
from imucald.core.samples import GRAVITY
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.evidence import (
    GAIN_TOLERANCE,
    SAME_MOTION,
    UnitChoice,
    choose_unit,
    in_counts,
    stated_unit,
)
from imucald.discovery.heading import (
    HeadingFit,
    doubt_what_is_turned,
    fit_heading,
    hold_against_heading,
)
from imucald.discovery.names import hint
from imucald.discovery.planar import find_planar
from imucald.discovery.proposal import MAX_ALTERNATIVES, Alternative, Choice, Proposed, source_of
from imucald.discovery.reference import (
    NEAR_WHEELS,
    KnownMotion,
    SpeedFit,
    apart_from,
    best_first,
    of_accelerometer,
    speed_against_accelerometer,
    speed_candidates,
    speed_doubt,
    wheel_mean,
)
from imucald.discovery.triads import (
    BY_PLACES,
    EARTH_FIELD,
    Triad,
    accelerometers,
    gyroscopes,
    in_raw_counts,
    magnetometers,
)
from imucald.discovery.wheels import wheel_sets
from imucald.inputs.units import is_unit

MAX_TRIADS = 6
"""Largest number of triads (three signals x, y, z) that are compared with every speed, if no unit
shows which triad is the accelerometer."""


class Sensors:
    """The sensor to calibrate, and the speed. reference: the vehicle's motion. taken: paths of used
    signals."""

    def __init__(
        self, candidates: Sequence[SeenSignal], with_signs: Sequence[SeenSignal] = ()
    ) -> None:
        """Find the sensors. with_signs: candidates and, in addition, magnitudes with a sign bit
        (yaw rates)."""
        self.candidates = candidates
        self.reference = KnownMotion()
        self.wheels = next(iter(wheel_sets(candidates)), None)
        self.taken: set[str] = {c.path for c in self.wheels or ()}
        self.other_axes: set[str] = set()
        """Axes of other accelerometers on the bus. The mounts of these accelerometers are not
        known."""
        self.heading: HeadingFit | None = None
        self.contradiction = ""
        """Text about an accelerometer and a gyroscope that contradict each other; else empty."""
        self.choices: list[Choice | None] = []
        """The choices, in the order of the configuration."""
        self._speeds: list[SpeedFit] = []
        triads = accelerometers(candidates)
        counts = [] if triads else in_raw_counts(candidates)
        counts = [t for t in counts if self._speed_for(t) or hint("accelerometer", t.members[0])]
        if triads or counts:
            self._set_accelerometer(triads or counts)
        else:
            planar = find_planar(with_signs or candidates, self.wheels, self.taken)
            if planar is not None:
                self.reference = planar.reference
                self.choices += planar.choices
                self.taken |= planar.taken
        if self.heading is None:
            self.heading = fit_heading(self.reference.motion, self._free())

    def _free(self) -> list[SeenSignal]:
        return [c for c in self.candidates if c.path not in self.taken]

    def _set_accelerometer(self, triads: list[Triad]) -> None:
        stated = [t for t in triads if t.unit.is_stated]
        tried = stated or triads[:MAX_TRIADS]
        best = self._best_of(tried) if len(tried) > 1 else tried[0]
        self._speed_for(best)
        rivals = [t for t in stated if t is not best]
        self.other_axes = {m.path for t in rivals for m in t.members}
        reference = self.reference = of_accelerometer(best)
        self.taken |= {m.path for m in best.members}
        accelerometer = _accelerometer_choice(best, [t for t in triads if t is not best])
        self.choices.append(accelerometer)
        speed = self._choose_speed()
        gyro = self._choose_gyroscope(reference)
        tilt = tilt_ratio(reference.motion)
        if tilt is not None and tilt < -BELIEVED_NATS:
            self.contradiction = f"the gyroscope {TILTS_DIFFERENTLY}"
        heading = fit_heading(reference.motion, self._free())
        self.heading = hold_against_heading(reference, accelerometer, heading)
        doubt_what_is_turned(accelerometer, gyro, self.heading)
        if rivals and not accelerometer.doubt:
            accelerometer.doubt = (
                f"{rivals[0].messages[0]} has an accelerometer too: the accelerometer and "
                "the gyroscope must be of the sensor to calibrate"
            )
        if best.unit.is_counts:
            one = GRAVITY / best.unit.factor
            accelerometer.doubt = (
                "the accelerometer is in raw counts, since the database states no scale; 1 g is "
                f"{one * best.size / GRAVITY:.0f} counts: 'unit: g/{one:.6g}'"
            )
        elif not best.unit.is_stated and not (reference.speed and reference.speed.is_believed):
            accelerometer.doubt = (
                "the three signals form a vector of 1 g, but no unit "
                "is stated and no motion confirms them"
            )
        self.choices += [gyro, self._magnetometer(), speed]

    def _best_of(self, triads: list[Triad]) -> Triad:
        """Return the accelerometer that fits a gyroscope of the bus best; without a gyroscope, the
        one that shows the changes of speed best."""
        explained = [self._speed_for(t) for t in triads]
        showing = [t for t, e in zip(triads, explained, strict=True) if e >= SAME_MOTION]
        gyros = gyroscopes(self.candidates)
        if not (showing and gyros):
            return triads[explained.index(max(explained))]

        def fit(triad: Triad) -> float:
            motion = of_accelerometer(triad).motion
            fits = [fit_gyroscope(g.ticks, motion, [AS_IT_IS]) for g in gyros]
            return max((f.nats[AS_IT_IS] for f in fits if f is not None), default=0.0)

        return max(showing, key=fit)

    def _speed_for(self, triad: Triad) -> float:
        """Return the quality of the best fit between a speed and a triad, and store all fits."""
        motion = of_accelerometer(triad).motion
        members = {m.path for m in triad.members}
        fits = [
            speed_against_accelerometer(c, motion)
            for c in speed_candidates(self.candidates)
            if c.path not in members
        ]
        self._speeds = [f for f in fits if f is not None]
        return max((f.relation.explained for f in self._speeds if f.is_believed), default=0.0)

    # speed -----------------------------------------------------------------------------------

    def _choose_speed(self) -> Choice | None:
        """Choose the speed whose changes appear best in the accelerometer. If there is no such
        speed, use the wheel speeds as the reference."""
        wheels = {c.path for c in self.wheels or ()}
        believed = [f for f in self._speeds if f.is_believed]
        rolling = best_first([f for f in believed if f.candidate.path in wheels], None)
        mean = wheel_mean(self.wheels)
        own = best_first([f for f in believed if f.candidate.path not in wheels], mean)
        if not own:
            if not rolling:
                return self._speed_by_unit(wheels)
            self.reference.set_speed(rolling[0])
            return None
        best = own[0]
        self.reference.set_speed(best)
        self.taken.add(best.candidate.path)
        others = [Alternative({"": _speed_source(f)}, _speed_words(f)) for f in own[1:]]
        words, doubt = _speed_words(best), speed_doubt(own, mean)
        apart = None if mean is None else apart_from(best, mean)
        if apart is not None and apart < NEAR_WHEELS:
            words += f"; it agrees with the wheel speeds within {100 * apart:.1f} %"
        chosen = {"": _speed_source(best)}
        return Choice("speed", chosen, words, doubt, others[:MAX_ALTERNATIVES])

    def _speed_by_unit(self, wheels: set[str]) -> Choice | None:
        """Choose a speed that the accelerometer does not confirm: by its unit, and among several
        speeds by its name."""
        usable = [
            c
            for c in self.candidates
            if c.states("speed") and c.path not in wheels and not c.is_constant
        ]
        usable.sort(key=lambda c: (hint("speed", c) is None, c.cycle))
        if not usable:
            return None
        best = usable[0]
        unit = stated_unit(best.unit, "speed")
        assert unit is not None, "its unit was just asked for"
        self.reference.set_speed(SpeedFit(best, unit, Relation()))
        self.taken.add(best.path)
        doubt = "chosen by its unit only: its changes do not show in the accelerometer"
        others = [Alternative({"": source_of(c)}, f"in {c.unit}") for c in usable[1:]]
        return Choice(
            "speed", {"": source_of(best)}, f"a speed in {best.unit}", doubt,
            others[:MAX_ALTERNATIVES],
        )  # fmt: skip

    # gyroscope -------------------------------------------------------------------------------

    def _choose_gyroscope(self, reference: KnownMotion) -> Choice | None:
        found = []
        for triad in gyroscopes(self.candidates):
            if {m.path for m in triad.members} & self.taken:
                continue
            named = [order for order in RIGHT_HANDED if order[0] == AS_IT_IS[0]]
            tried = named if triad.names_axes else RIGHT_HANDED
            fit = fit_gyroscope(triad.ticks, reference.motion, tried)
            if fit is not None and (triad.unit.is_stated or fit.is_believed):
                found.append((triad, fit))
        if not found:
            return None
        found.sort(key=lambda f: (not f[0].unit.is_stated, -f[1].nats[f[1].order]))
        triad, fit = found[0]
        choice, order, triad = gyroscope_choice(triad, fit, found[1:])
        self.taken |= {m.path for m in triad.members}
        reference.motion = reference.motion.with_channel("gyro", signed(triad.ticks, order))
        reference.shows_left = True  # if the gyroscope is right-handed
        return choice

    def _magnetometer(self) -> Choice | None:
        found = [
            t
            for t in magnetometers(self.candidates)
            if not {m.path for m in t.members} & self.taken
        ]
        if not found:
            return None
        best = found[0]
        self.taken |= {m.path for m in best.members}
        text = f"{1e6 * best.size:.0f} uT"
        doubt = "" if best.names_axes else "the axes are guessed from the order of the signals"
        if not EARTH_FIELD[0] / 2.0 < best.size < EARTH_FIELD[1] * 2.0:
            doubt = "the magnetic field of the earth has 22 to 67 uT"
        return Choice("magnetometer", axes_of(best, best.unit.name), text, doubt)


def _speed_source(fit: SpeedFit) -> Proposed:
    return source_of(fit.candidate, fit.unit.name)


def _speed_words(fit: SpeedFit) -> str:
    r = fit.relation
    gain = r.gain / fit.unit.factor
    late = (
        f", {0.1 * abs(fit.delay):.1f} s {'late' if fit.delay > 0 else 'early'}"
        if fit.delay
        else ""
    )
    return (
        f"its changes show in the accelerometer (correlation {r.correlation:.2f}, "
        f"gain {gain:.2f} in {fit.unit.name}{late})"
    )


def _accelerometer_choice(best: Triad, others: list[Triad]) -> Choice:
    text = f"their vector has {best.size:.2f} m/s2 +- {100 * best.spread:.1f} %, which is 1 g"
    if not best.unit.is_stated:
        stated = best.members[0].unit
        text += f" in {best.unit.name} (the database says {stated or 'no unit'})"
    text += "; the axes follow from the names" if best.names_axes else f"; {BY_PLACES}"
    doubt = "" if best.unit.is_sure else f"the unit {', '.join(best.unit.others)} would fit as well"
    alternatives = [
        Alternative(axes_of(t, t.unit.name), f"{t.size:.2f} m/s2 +- {100 * t.spread:.1f} %")
        for t in others
        if t.unit.is_stated
    ]
    return Choice(
        "accelerometer", axes_of(best, best.unit.name), text, doubt, alternatives[:MAX_ALTERNATIVES]
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
    places, sign = fit.order
    x, y, z = (triad.members[i] for i in places)
    ordered = Triad((x, y, z), unit, triad.names_axes)
    choice = Choice(
        "gyroscope",
        axes_of(ordered, unit.name, sign),
        _evidence(triad, fit),
        doubt or _open_question(triad, fit),
        [Alternative(axes_of(t, t.unit.name, f.order[1]), "another one") for t, f in others][
            :MAX_ALTERNATIVES
        ],
    )
    return choice, (AS_IT_IS[0], sign), ordered


def _unit(triad: Triad, fit: GyroFit) -> tuple[UnitChoice, str]:
    """Return the unit from turns or gravity, and the reason for a doubt about the unit; the reason
    is empty if there is none."""
    found = fit.turning if fit.turning.is_believed else fit.carried
    unit = triad.unit
    # In a vehicle, lateral forces tilt the body and add to gravity, so the gain of a weak relation
    # to gravity shows no unit. In a hand, the relation is strong.
    if found.is_believed and found.sign > 0 and found.explained >= SAME_MOTION:
        size = unit.factor  # the relation was taken in this unit
        low, high = size * found.low / GAIN_TOLERANCE, size * found.high * GAIN_TOLERANCE
        first = triad.members[0]
        fitting = choose_unit(first.unit, "angular_rate", low, high)
        if fitting is None and first.signal.scale == 1.0 and not is_unit(first.unit):
            counts = in_counts("angular_rate", low, high)
            others = f" (and {', '.join(counts.others)})" if counts.others else ""
            return counts, (
                "the signal is in raw counts, since the database states no scale; the recording "
                f"fits 'unit: {counts.name}'{others}"
            )
        return (
            (unit, "its values are too large or too small for every unit")
            if fitting is None
            else (fitting, "")
        )
    what = "sign" if unit.is_stated else "unit and sign"
    return unit, f"no speed confirms it in turns, so its {what} may be wrong"


def _open_question(triad: Triad, fit: GyroFit) -> str:
    """Return what the likelihoods do not decide (axes or signs); empty if they decide
    everything."""
    if not fit.is_believed:
        return "the recording has no turns or slopes that confirm it"
    if fit.order[1] < 0 and not fit.is_decided([o for o in RIGHT_HANDED if o[1] > 0]):
        return "the sign is not certain"
    if not triad.names_axes and not fit.is_decided(RIGHT_HANDED):
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
    if fit.order[1] < 0:
        words.append("its signs are opposite to the signs of the accelerometer axes")
    words.append(
        "the axes follow from the names"
        if triad.names_axes
        else "each axis was found from turns and gravity"
    )
    return "; ".join(words)
