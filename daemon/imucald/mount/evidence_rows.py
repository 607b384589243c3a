"""The regressions that the response evidence is made of; see `evidence_response`."""

from __future__ import annotations

from msgspec import Struct

from imucald.mount.evidence_spectra import BANDS, Term

X_ROW, Y_ROW, PITCH_ROW, ROLL_ROW, P_ROW, Q_ROW = range(6)


class Row(Struct, frozen=True):
    """One regression: which row answers to what; the first regressor carries the angle.

    share, few: the variance is taken that much larger, and by `few` over the number of road
    segments, as few of them hide their own spread. Both were chosen on simulated drives, so that
    errors are as large as stated from the second minute to the fortieth (`python -m
    benchmarks.mount_accuracy --only accuracy`; seeds of tuning: records/mount-accuracy.md).
    """

    name: str
    axis: int  # of e
    regressors: tuple[int, ...]
    prior_std: tuple[float, ...]  # of the nuisance coefficients
    share: float
    few: float
    bands: int = BANDS  # only so many: above, the suspension's resonance answers
    first: int = 0  # not the bands below: there the tracked vertical takes part of f_z


_T = Term
ROWS = (
    Row("yaw_turn", 2, (_T.LATERAL_REMAINING, _T.YAW_2, _T.LATERAL_2), (1.0, 0.006), 1.0, 1.0),
    Row("yaw_dvdt", 2, (_T.DVDT_REMAINING, _T.YAW_2, _T.DVDT_LATERAL), (0.5, 0.008), 1.0, 1.0),
    Row(
        "pitch_dvdt",
        1,
        (_T.DVDT_REMAINING, _T.DVDT, _T.DVDT_2, _T.DVDT_ABS),
        (0.005, 0.005, 0.0008),
        share=0.3,
        few=1.0,
        bands=8,
        first=1,
    ),
    Row(
        "roll_turn",
        0,
        (_T.LATERAL_REMAINING, _T.LATERAL, _T.LATERAL_2),
        (0.005, 0.01),
        share=1.6,
        few=12.0,
        bands=8,
        first=1,
    ),
    Row("pitch_axis", 1, (_T.YAW_RATE, _T.DVDT_YAW, _T.LATERAL), (0.015, 0.0015), 2.2, 8.0, 7),
    Row("roll_axis", 0, (_T.YAW_RATE, _T.LATERAL_YAW), (0.01,), 1.6, 12.0, 7),
)
"""In the order of X_ROW .. Q_ROW."""
SAME_NOISE = ("roll_turn", "roll_axis")
"""Both see the pitch rate of the road, such as its lean in bends makes: only the better speaks."""
WITHOUT_SPEED = (Y_ROW, P_ROW, Q_ROW)
"""What can be found without speed: the principal axis, and the axis of rotation."""
TARGETS = (Term.FORCE_X, Term.FORCE_Y, Term.FORCE_Z, Term.FORCE_Z, Term.ROLL_RATE, Term.PITCH_RATE)
GX, GY, GQ, GX_QUARTER, GY_QUARTER, GP_QUARTER, GQ_QUARTER = range(7)
GAINS = (
    (X_ROW, Term.FORCE_X, Term.DVDT, 1.0, 0.02, 1.6),
    (Y_ROW, Term.FORCE_Y, Term.LATERAL, 1.0, 0.02, 1.6),
    (PITCH_ROW, Term.FORCE_Z, Term.SPEED_PITCH, 0.0, -1.3, 0.3),
    (X_ROW, Term.FORCE_X, Term.DVDT_QUARTER, 0.0, -0.7, 0.7),
    (Y_ROW, Term.FORCE_Y, Term.LATERAL_QUARTER, 0.0, -0.7, 0.7),
    (P_ROW, Term.ROLL_RATE, Term.LATERAL_QUARTER, 0.0, -0.2, 0.2),
    (Q_ROW, Term.PITCH_RATE, Term.DVDT_QUARTER, 0.0, -0.2, 0.2),
)
"""Gains per band: row, target, signal, expected, least, most."""
MAX_REGRESSORS = 4
