"""Hold, release or save the mount that an estimator reports."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace

from imucald.mount.estimate import MountEstimator, MountState
from imucald.mount.hysteresis import BAD, GOOD
from imucald.mount.joint.known import KnownSensor
from imucald.mount.mount_words import doubt_words
from imucald.mount.restored import KnowsSensor, Phase, RestoredEstimator, StoredMount


def mount_in_force(estimator: MountEstimator) -> StoredMount | None:
    """Return the mount that an estimator reports now, in a form from which another estimator can
    continue. None if there is no mount.
    """
    correction = estimator.correction
    if correction is None:
        return None
    is_doubted = estimator.state in BAD
    if isinstance(estimator, RestoredEstimator) and estimator.serves_stored:
        return replace(estimator.stored, doubted=is_doubted, doubt=doubt_of(estimator))
    known = estimator.estimate()
    C = known.covariance
    if C is None or not np.isfinite(C).all():
        return None
    state = estimator.state if estimator.state in GOOD else MountState.USABLE
    doubt = doubt_of(estimator)
    return StoredMount(
        correction.matrix(),
        0.5 * (C + C.T),
        state,
        is_doubted,
        doubt=doubt,
        applied=None if correction.is_rotation else correction,
        sent=known.deviations,
        sensor=known_sensor(estimator),
    )


def doubt_of(estimator: MountEstimator) -> str:
    """Return in words why the applied mount is suspect; "" if the mount is not suspect or the
    reason is unknown.
    """
    if estimator.state not in BAD:
        return ""
    found = doubt_words(estimator.estimate().waiting_for)
    if not found and isinstance(estimator, RestoredEstimator) and estimator.phase is Phase.DOUBTED:
        return estimator.stored.doubt
    return found


def known_sensor(estimator: MountEstimator) -> KnownSensor | None:
    """Return an estimator's knowledge about the sensor itself, if it has any."""
    if isinstance(estimator, RestoredEstimator | KnowsSensor):
        return estimator.known_sensor()
    return None


def held(estimator: MountEstimator) -> RestoredEstimator | None:
    """Return an estimator that holds the mount reported now; None if there is no mount.

    The given estimator continues inside, because it detects best whether the drive contradicts the
    mount.
    """
    stored = mount_in_force(estimator)
    if stored is None:
        return None
    is_open = estimator.state is MountState.RESTORED
    phase = Phase.RESTORED if is_open else Phase.CONFIRMED
    return RestoredEstimator(without_stored(estimator), stored, is_held=True, phase=phase)


def released(estimator: RestoredEstimator, inner: MountEstimator) -> RestoredEstimator:
    """Return the same mount without the hold. `inner` replaces the mount when its estimate is as
    certain.

    inner: a new estimator. The data received during the hold are not used.
    """
    is_doubted = estimator.phase is Phase.DOUBTED
    stored = replace(estimator.stored, doubted=is_doubted, doubt=doubt_of(estimator))
    phase = Phase.CONFIRMED if estimator.phase is Phase.CONFIRMED else Phase.RESTORED
    return RestoredEstimator(inner, stored, phase=phase)


def without_stored(estimator: MountEstimator) -> MountEstimator:
    """Return the estimator that searches the mount, without the stored mount around it."""
    return estimator.inner if isinstance(estimator, RestoredEstimator) else estimator
