"""Which causes stand beside structure that no cause explains.

What pushes the vehicle sideways moves all signals of a turn at once, and a forward model that does
not know it takes this for a mount, a scale or a steering that is not there. Where structure is
left, the signals and frequencies in which it lives are therefore taken out, and each cause must
show in what remains.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imucald.diagnosis.cause import Variant
from imucald.diagnosis.evidence import Evidence
from imucald.diagnosis.grid import Array
from imucald.diagnosis.result import Structure
from imucald.diagnosis.search import Search
from imucald.diagnosis.spectra import BLOCK_S, Blocks, bands, normal_equations
from imucald.diagnosis.trial import Found

STANDS = 12.0
"""Log posterior odds that a cause must keep without the structure's signals and frequencies."""
SIDEWAYS = ("accel_y", "gyro_x", "gyro_z", "yaw_rate", "lateral_accel")
"""Signals of a turn: what disturbs one of them disturbs all."""
SIDEWAYS_FROM_HZ = 0.05
"""A push that comes and goes reaches down to here."""
SLOW_TO_HZ = 0.5
"""Dependences on inputs live below."""
MUTE = 1e3
"""Factor by which the noise is raised."""


def standing(search: Search, found: Found, structure: Sequence[Structure]) -> list[Variant]:
    """Return the active causes that are as clear without what the structure disturbs.

    The weakest is taken away until the rest stands. Without structure all are returned.
    """
    active = list(found.active)
    if not structure or not active:
        return active
    point = found.point
    noise = point.noise.louder(_mute(search.forwards[0].names, structure, point.residual.shape[1]))
    blocks = Blocks(point.columns, point.present, np.zeros(0))
    normal = normal_equations(blocks, point.residual, noise)
    evidence = Evidence(search.parameters, normal, point.evidence.shift)
    while active:
        losses = [_loss(search, found, evidence, active, variant) for variant in active]
        weakest = int(np.argmin(losses))
        if losses[weakest] >= STANDS:
            break
        active.pop(weakest)
    return active


def _loss(
    search: Search, found: Found, evidence: Evidence, active: Sequence[Variant], variant: Variant
) -> float:
    """Log posterior odds that would be lost without one of the active causes."""
    rest = [key for v in active if v is not variant for key in v.keys]
    temper = search.temper(found, variant.keys)
    full = evidence.fit([*rest, *variant.keys], temper=temper).log_evidence
    return full - evidence.fit(rest, temper=temper).log_evidence + search.prior(variant)


def _mute(names: Sequence[str], structure: Sequence[Structure], frequencies: int) -> Array:
    """Factor on the noise, (1, bands, C)."""
    edges = bands(frequencies)
    factor = np.ones((1, len(edges), len(names)))
    low = np.array([band.start for band in edges]) / BLOCK_S
    for left in structure:
        slow = left.kind.startswith("depends")
        # The other axes of a triad share what disturbs one of them.
        triad = tuple(n for n in names if n[:-2] == left.signal[:-2])
        touched = SIDEWAYS if not slow and left.signal in SIDEWAYS else triad
        where = low <= SLOW_TO_HZ if slow else low >= SIDEWAYS_FROM_HZ
        for name in {left.signal, *touched} & set(names):
            factor[0, where, names.index(name)] = MUTE
    return factor
