"""What something else that was found may make is not named beside it."""

from __future__ import annotations

import numpy as np
import pytest

from hidden import Effect, hidden_drive
from imucald.core.samples import Samples, Series
from imucald.diagnosis.diagnose import diagnose
from imucald.diagnosis.result import Diagnosis
from imucald.model.model import model_from_mapping

SEED = 160_031
MINUTES = 12.0


def diagnosed(change=None, *effects: str) -> Diagnosis:
    made = hidden_drive(SEED, tuple(Effect(e, "large") for e in effects), MINUTES)
    samples: Samples = made.samples if change is None else change(dict(made.samples))
    return diagnose([samples], model_from_mapping(dict(made.model), "b"))


def clipped(samples: dict[str, Series]) -> dict[str, Series]:
    accel = samples["accel"]
    x = accel.values.copy()
    middle = np.median(x, axis=0)
    axis = int(np.argmin(np.abs(middle)))
    reach = float(np.quantile(np.abs(x[:, axis] - middle[axis]), 0.98))
    x[:, axis] = np.clip(x[:, axis], middle[axis] - reach, middle[axis] + reach)
    return {**samples, "accel": Series(accel.t, x)}


def names(d: Diagnosis) -> set[str]:
    return {c.name for c in d.causes}


@pytest.mark.slow
def test_a_gain_of_a_sensor_that_is_clipped_is_not_ruled_out():
    whole = diagnosed(None, "accel_scale")
    assert {"accel_scale", "accel_bias"} & (
        names(whole) | {n for s in whole.look_alikes for n in s}
    )
    d = diagnosed(clipped, "accel_scale")
    assert "saturation" in names(d)
    assert not {"accel_scale", "accel_bias"} & (names(d) | {c.name for c in d.likely})
    assert {c.outcome for c in d.candidates if c.name in ("accel_scale", "accel_bias")} >= {
        "not ruled out"
    }


@pytest.mark.slow
def test_stamps_that_run_off_are_no_delay_besides():
    def running(samples: dict[str, Series]) -> dict[str, Series]:
        made = dict(samples)
        for name in ("accel", "gyro"):
            t = samples[name].t
            made[name] = Series(t[0] + (t - t[0]) * (1.0 + 2e-3), samples[name].values)
        return made

    d = diagnosed(running)
    assert "clock_drift" in names(d)
    assert not {"signal_delay", "delay_rate"} & (names(d) | {c.name for c in d.likely})
