"""Per angle, what an estimate still waits for: troubles first, then tests, then more driving."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from imucald.mount.acceptance import Acceptance
from imucald.mount.contradictions import WORDS, StandingFault
from imucald.mount.estimate import ANGLES, Missing, MountState
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.force_level import LevelChange
from imucald.mount.hysteresis import BAD, GOOD
from imucald.mount.states import MountKnowledge, waiting_for


def waiting_reasons(
    known: MountKnowledge,
    state: MountState,
    settings: EstimatorSettings,
    acceptance: Acceptance,
    troubles: Mapping[str, str],
) -> tuple[dict[str, str], dict[str, Missing]]:
    """Return one reason per angle in words, and as a code; no entry where nothing is missing.

    known, state: what the evidence comes to, and the state that is reported for it. troubles:
    what more driving does not mend, see `mount_troubles`; it goes before any other reason.
    """
    if state is MountState.FINE:
        return {}, {}
    reasons = waiting_for(known, settings)
    words = {name: text for name, (text, _) in reasons.items()}
    codes = {name: code for name, (_, code) in reasons.items()}
    for angle, text in troubles.items():
        words[angle], codes[angle] = text, Missing.OTHER
    is_withheld = state is MountState.LEVELLED or state in BAD
    if is_withheld and (held := acceptance.missing_to_be_good()) is not None:
        words = {angle: words.get(angle, held) for angle in ANGLES}
        codes = {angle: codes.get(angle, Missing.AGREEMENT) for angle in ANGLES}
    if state is MountState.USABLE and (acceptance.has_no_sides or not words):
        code = Missing.AGREEMENT if acceptance.has_no_sides else Missing.NOTHING
        words = dict.fromkeys(ANGLES, acceptance.missing_to_be_fine()) | words
        codes = dict.fromkeys(ANGLES, code) | codes
    return words, codes


def mount_troubles(
    state: MountState,
    faults: Sequence[StandingFault],
    creeping: Mapping[str, Mapping[str, float]],
    shifted: Sequence[float],
    level: LevelChange | None = None,
) -> dict[str, str]:
    """What more driving does not mend, per angle: contradictions, and a mount that moves.

    creeping: see `estimate_details.creep_details`. shifted: how far roll, pitch, yaw have moved
    [rad] where they were found to have shifted again, else 0. level: how the size of gravity has
    changed, where that is a fault.
    """
    if state is MountState.FINE:
        return {}
    if faults:
        texts = {fault: WORDS[fault] for fault in faults}
        if level is not None and StandingFault.ACCEL_LEVEL in texts:
            sizes = f" ({level.before:.2f} to {level.after:.2f} m/s^2)"
            texts[StandingFault.ACCEL_LEVEL] += sizes
        return dict.fromkeys(ANGLES, "; ".join(texts.values()))
    if state in GOOD:
        return {
            angle: f"the mount moves slowly: about {abs(found['deg_per_h']):.0f} deg/h"
            for angle, found in creeping.items()
        }
    moved = {angle: found["moved_deg"] for angle, found in creeping.items()}
    for angle, size in zip(ANGLES, shifted, strict=True):
        if size:
            moved[angle] = math.degrees(size)
    return {
        angle: f"the mount moves by {abs(degrees):.1f} deg within the drive"
        for angle, degrees in moved.items()
    }
