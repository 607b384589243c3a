"""States of method A with their hysteresis, and the missing evidence of each angle."""

from __future__ import annotations

from dataclasses import dataclass

from imucald.mount.estimate import Missing, MountState
from imucald.mount.hysteresis import Level, best_level
from imucald.mount.method_a.levelling import Tilt
from imucald.mount.method_a.settings import PublishedSettings
from imucald.mount.method_a.target_angle import CombinedAngle


@dataclass(frozen=True)
class TiltAndAngle:
    """Present estimate: tilt, target angle, sign of the target angle known or not, number of stops,
    number of manoeuvres.
    """

    tilt: Tilt | None = None
    angle: CombinedAngle | None = None
    sign_known: bool = False
    stops: int = 0
    manoeuvres: int = 0


def judged(known: TiltAndAngle, before: MountState, s: PublishedSettings) -> MountState:
    """Return the state.

    A state is left only if its limit times the hysteresis is exceeded.

    A calibration that is no longer usable becomes suspect and is still applied.
    """
    state = _good(known, before, s)
    if state is not None:
        return state
    if before >= MountState.USABLE:
        return MountState.SUSPECT
    return MountState.WAITING if known.tilt is None else MountState.LEVELLED


def _good(known: TiltAndAngle, before: MountState, s: PublishedSettings) -> MountState | None:
    tilt, angle = known.tilt, known.angle
    if tilt is None or angle is None or not known.sign_known:
        return None
    n, limits = angle.manoeuvres, s.limits
    usable = n >= s.usable_manoeuvres
    fine = n >= s.fine_manoeuvres and usable
    levels = (
        Level(MountState.FINE, limits.fine_yaw, limits.fine_tilt, fine, s.hysteresis),
        Level(MountState.USABLE, limits.usable_yaw, limits.usable_tilt, usable, s.hysteresis),
    )
    return best_level(levels, before, angle.std, tilt.std)


def waiting_for(known: TiltAndAngle, s: PublishedSettings) -> dict[str, tuple[str, Missing]]:
    """Return one reason per angle, in words and as a code. An angle without missing evidence has no
    entry."""
    reasons: dict[str, tuple[str, Missing]] = {}
    if known.tilt is None:
        reason = (
            f"a standstill of {s.calibration.static.duration:g} s",
            Missing.STANDSTILL,
        )
        reasons["roll"] = reasons["pitch"] = reason
    elif known.tilt.std > s.limits.fine_tilt and not s.is_level:
        text = f"stops in other places, so that slopes average out ({known.stops} seen)"
        reasons["roll"] = reasons["pitch"] = text, Missing.STANDSTILL
    yaw = _waiting_for_yaw(known, s)
    if yaw is not None:
        reasons["yaw"] = yaw
    return reasons


def _waiting_for_yaw(known: TiltAndAngle, s: PublishedSettings) -> tuple[str, Missing] | None:
    angle = known.angle
    count = known.manoeuvres if angle is None else angle.manoeuvres
    what = f"straight acceleration above {s.calibration.straight.manoeuvre_peak:g} m/s2"
    seen = f"{what} ({count} of {s.usable_manoeuvres} seen)"
    if known.tilt is None:
        return f"levelling, then {seen}", Missing.STANDSTILL
    if angle is None or count < s.usable_manoeuvres:
        return seen, Missing.ACCELERATION
    if not known.sign_known:
        text = "a turn, a start from rest or the brake switch: these separate forward from backward"
        return text, Missing.DIRECTION_OF_TRAVEL
    if angle.std > s.limits.usable_yaw:
        return (
            f"manoeuvres that agree better in yaw: the {count} seen scatter too much",
            Missing.AGREEMENT,
        )
    if count < s.fine_manoeuvres or angle.std > s.limits.fine_yaw:
        return f"more {what} ({count} seen)", Missing.ACCELERATION
    return None
