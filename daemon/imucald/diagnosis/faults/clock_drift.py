"""Clock drift: a unit's cycle is off its nominal rate, or its stamps run off the vehicle's.

Two things are measured. The cycle: stamps over the count of frames. And the run-off: how the delay
between the unit's motion and the vehicle's own signals grows over the drive. A unit with a slow
clock whose frames are stamped by the logger has a long cycle and no run-off; stamps made by the
unit's clock show both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from imucald.core.samples import Samples
from imucald.diagnosis.faults.cycle import Cycle
from imucald.diagnosis.faults.fault import ACCEPT, PRIOR, Fault
from imucald.diagnosis.faults.runoff import RunOff, run_off
from imucald.diagnosis.result import Estimated
from imucald.model.model import VehicleModel

TOLERANCE_PPM = 50.0
"""What a crystal may be off."""
WIDE_PPM = 2500.0
STAMPS_TOLERANCE_PPM = 15.0
"""One logger stamps all frames, so run-off is rare; delays may creep a little for other reasons."""
STAMPS_WIDE_PPM = 400.0
UNKNOWN_PPM = 10_000.0
"""Further off, the model file states another rate; that is no fault."""
LEAST_STD_PPM = 0.2
"""A clock is not more constant than that over a drive: it warms up."""
UNIT = ("accel", "gyro")
"""Channels of the inertial unit."""
SAME_PPM = 2.0
"""Channels whose cycles agree to within this share one clock."""
STAMPS = "accel.stamps_ppm"


@dataclass(frozen=True)
class _Off:
    """A channel's cycle against its nominal rate, and what the model file says of it."""

    name: str
    ppm: float
    std: float
    stated: float


def find(samples: Samples, model: VehicleModel, cycles: dict[str, Cycle]) -> list[Fault]:
    """Return drifting clocks: the inertial unit's stamps, then cycles of all units."""
    off = [_off(name, model, cycle) for name, cycle in cycles.items()]
    off = [x for x in off if abs(x.ppm - x.stated) < UNKNOWN_PPM]
    leader = next((x for x in off if x.name in UNIT), None)
    measured = run_off(samples, model)
    stamps_score, cycle_score = _weighed(leader, measured)
    found: list[Fault] = []
    run_off_ppm = 0.0
    if measured is not None and stamps_score >= ACCEPT:
        found.append(_stamps_fault(measured, stamps_score))
        run_off_ppm = measured.ppm
    while off:
        x = off[0]
        same = [y for y in off if _one_clock(x, y)]
        off = [y for y in off if y not in same]
        unit = x.name in UNIT
        score = cycle_score if unit else _one_dimension(x)
        if score >= ACCEPT:
            found.append(_cycle_fault(x, same, run_off_ppm if unit else 0.0, score))
    return found


def _off(name: str, model: VehicleModel, cycle: Cycle) -> _Off:
    message = getattr(model, name)
    ppm = 1e6 * (cycle.period_s * message.rate_hz - 1.0)
    return _Off(name, ppm, max(1e6 * cycle.std, LEAST_STD_PPM), message.clock_drift_ppm)


def _one_clock(x: _Off, y: _Off) -> bool:
    alike = abs(x.ppm - y.ppm) < SAME_PPM + 3.0 * math.hypot(x.std, y.std)
    return alike and (x.name in UNIT) == (y.name in UNIT)


def _one_dimension(x: _Off) -> float:
    departure = x.ppm - x.stated
    wide, narrow = math.hypot(WIDE_PPM, x.std), math.hypot(TOLERANCE_PPM, x.std)
    return PRIOR + _normal(departure, wide) - _normal(departure, narrow)


def _weighed(leader: _Off | None, measured: RunOff | None) -> tuple[float, float]:
    """Log posterior odds that the unit's stamps run off, and that its cycle is off.

    The cycle shows the sum of both errors, the run-off only the stamps'.
    """
    if leader is None:
        if measured is None:
            return -math.inf, -math.inf
        wide = math.hypot(STAMPS_WIDE_PPM, measured.std_ppm)
        narrow = math.hypot(STAMPS_TOLERANCE_PPM, measured.std_ppm)
        score = PRIOR + _normal(measured.ppm, wide) - _normal(measured.ppm, narrow)
        return score, -math.inf
    if measured is None:
        return -math.inf, _one_dimension(leader)
    evidence = {
        (stamps, cycle): (stamps + cycle) * PRIOR
        + _together(leader, measured, bool(stamps), bool(cycle))
        for stamps in (0, 1)
        for cycle in (0, 1)
    }
    return (
        _log_sum(evidence[1, 0], evidence[1, 1]) - _log_sum(evidence[0, 0], evidence[0, 1]),
        _log_sum(evidence[0, 1], evidence[1, 1]) - _log_sum(evidence[0, 0], evidence[1, 0]),
    )


def _together(leader: _Off, measured: RunOff, stamps: bool, cycle: bool) -> float:
    """Log density of both measurements when the two errors are small or may be large."""
    of_stamps = (STAMPS_WIDE_PPM if stamps else STAMPS_TOLERANCE_PPM) ** 2
    of_cycle = (WIDE_PPM if cycle else TOLERANCE_PPM) ** 2
    x, d = leader.ppm - leader.stated, measured.ppm
    a, b = of_cycle + of_stamps + leader.std**2, of_stamps + measured.std_ppm**2
    determinant = a * b - of_stamps**2
    square = (b * x * x - 2.0 * of_stamps * x * d + a * d * d) / determinant
    return -0.5 * square - 0.5 * math.log(determinant)


def _cycle_fault(x: _Off, same: list[_Off], run_off_ppm: float, score: float) -> Fault:
    parameters = {
        f"{y.name}.clock_drift_ppm": Estimated(y.ppm - run_off_ppm, y.std, "ppm") for y in same
    }
    names = " and ".join(y.name for y in same)
    text = (
        f"The cycle of {names} is off its nominal rate by {x.ppm - run_off_ppm:+.0f} ppm "
        f"(+-{x.std:.2g}) over the whole drive; the model file says {x.stated:+.0f}."
    )
    return Fault("clock_drift", x.name, parameters, score, (), text)


def _stamps_fault(measured: RunOff, score: float) -> Fault:
    text = (
        f"The stamps of the inertial unit (accel, gyro) run off the vehicle's by "
        f"{measured.ppm:+.0f} ppm (+-{measured.std_ppm:.2g}): their delay against "
        f"{measured.against} goes from {1e3 * measured.first_s:.0f} ms to "
        f"{1e3 * measured.last_s:.0f} ms over the drive."
    )
    parameters = {STAMPS: Estimated(measured.ppm, measured.std_ppm, "ppm")}
    return Fault("clock_drift", "accel", parameters, score, (), text)


def _normal(x: float, std: float) -> float:
    return -0.5 * (x / std) ** 2 - math.log(std)


def _log_sum(a: float, b: float) -> float:
    return max(a, b) + math.log1p(math.exp(-abs(a - b)))
