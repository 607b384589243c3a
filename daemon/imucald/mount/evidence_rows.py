"""The regressions that the response evidence is made of; see `evidence_response`."""

from __future__ import annotations

from dataclasses import dataclass

from imucald.mount import evidence_spectra as sp
from imucald.mount.evidence_spectra import BANDS

X_ROW, Y_ROW, PITCH_ROW, ROLL_ROW, P_ROW, Q_ROW = range(6)


@dataclass(frozen=True)
class Row:
    """One regression: which row answers to what; the first regressor carries the angle.

    share, few: the variance is taken that much larger, and by `few` over the number of pieces of
    road, as few of them hide their own spread. Both were chosen on simulated drives, so that errors
    are as large as stated from the second minute to the fortieth.
    """

    name: str
    axis: int  # of e
    regressors: tuple[int, ...]
    prior_std: tuple[float, ...]  # of the nuisance coefficients
    share: float
    few: float
    bands: int = BANDS  # only so many: above, the suspension's resonance answers
    first: int = 0  # not the bands below: there the tracked vertical takes part of f_z


ROWS = (
    Row("yaw_turn", 2, (sp.FVH, sp.FR2, sp.FV2), (1.0, 0.006), 1.0, 1.0),
    Row("yaw_dvdt", 2, (sp.FAH, sp.FR2, sp.FAV), (0.5, 0.008), 1.0, 1.0),
    Row("pitch_dvdt", 1, (sp.FAH, sp.FA, sp.FA2, sp.FAA), (0.005, 0.005, 0.0008), 0.3, 1.0, 8, 1),
    Row("roll_turn", 0, (sp.FVH, sp.FV, sp.FV2), (0.005, 0.01), 1.6, 12.0, 8, 1),
    Row("pitch_axis", 1, (sp.R, sp.FAR, sp.FV), (0.015, 0.0015), 2.2, 8.0, 7),
    Row("roll_axis", 0, (sp.R, sp.FVR), (0.01,), 1.6, 12.0, 7),
)
"""In the order of X_ROW .. Q_ROW."""
WITHOUT_SPEED = (Y_ROW, P_ROW, Q_ROW)
"""What can be said without speed: the principal axis, and the axis of rotation."""
TARGETS = (sp.FX, sp.FY, sp.FZ, sp.FZ, sp.P, sp.Q)
GX, GY, GQ, GX_QUARTER, GY_QUARTER, GP_QUARTER, GQ_QUARTER = range(7)
GAINS = (
    (X_ROW, sp.FX, sp.FA, 1.0, 0.02, 1.6),
    (Y_ROW, sp.FY, sp.FV, 1.0, 0.02, 1.6),
    (PITCH_ROW, sp.FZ, sp.FQ, 0.0, -1.3, 0.3),
    (X_ROW, sp.FX, sp.FAI, 0.0, -0.7, 0.7),
    (Y_ROW, sp.FY, sp.FVI, 0.0, -0.7, 0.7),
    (P_ROW, sp.P, sp.FVI, 0.0, -0.2, 0.2),
    (Q_ROW, sp.Q, sp.FAI, 0.0, -0.2, 0.2),
)
"""Gains per band: row, target, signal, expected, least, most."""
MAX_REGRESSORS = 4
