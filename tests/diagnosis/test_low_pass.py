"""A delay and a low-pass that is as late: told apart where their shape shows, else both named."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from hidden import Effect, hidden_drive
from imucald.diagnosis.cause_keys import age, low_pass, with_low_passes
from imucald.diagnosis.diagnose import diagnose
from imucald.diagnosis.result import Diagnosis
from imucald.diagnosis.search.low_pass import _more
from imucald.diagnosis.signals import STEP_S
from imucald.drive.single_track import frequencies
from imucald.model.model import VehicleModel, model_from_mapping
from imucald.model.sensors import BUTTERWORTH_S_HZ

BOTH = (("signal_delay", "sensor_lowpass"),)


@pytest.mark.parametrize(("order", "seconds"), [(1, 0.3), (2, 0.45)])
def test_what_a_filter_adds_is_what_that_filter_makes_of_a_signal(order, seconds):
    rng = np.random.default_rng(3)
    rate, n = 100, 60_000
    quick = lfilter(*butter(3, 0.3, fs=rate), rng.standard_normal(n))
    cut_off = 1.0 / (2.0 * np.pi * seconds) if order == 1 else BUTTERWORTH_S_HZ / seconds
    filtered = lfilter(*butter(order, cut_off, fs=rate), quick)
    t = np.arange(n) / rate
    on_grid = np.arange(20.0, n / rate - 20.0, STEP_S)
    true = np.interp(on_grid, t, quick)
    late = np.interp(on_grid + 0.35, t, filtered)
    added = _more(true, frequencies(len(true)), 0.35, seconds, order)
    assert added[100:-100] == pytest.approx((late - true)[100:-100], abs=0.02 * float(true.std()))


@pytest.mark.parametrize("key", ["accel.delay_s", "speed.delay_s", "steering.delay_s"])
def test_a_filter_in_place_of_a_delay_is_as_late(key):
    model = VehicleModel()
    name = key.partition(".")[0]
    late = model.with_changes({key: getattr(model, name).delay_s + 0.2})
    filtered = with_low_passes(late, model, {key: 0.2})
    assert age(filtered, name) == pytest.approx(age(late, name))
    assert getattr(filtered, name).delay_s == pytest.approx(getattr(model, name).delay_s)


def test_a_filter_cannot_be_early():
    assert low_pass(VehicleModel(), "speed.delay_s", -0.1) is None


@cache
def diagnosed(cause: str, size: str, signal: str) -> Diagnosis:
    made = hidden_drive(3_961_000, (Effect(cause, size, signal),), 15.0)
    return diagnose([made.samples], model_from_mapping(dict(made.model), "baseline"))


@pytest.mark.slow
def test_a_slow_low_pass_is_named_alone_and_written_as_one():
    d = diagnosed("sensor_lowpass", "large", "gyro")
    (cause,) = d.causes
    assert cause.name == "sensor_lowpass"
    assert not d.look_alikes
    p = cause.parameters["gyro.lowpass_hz"]
    assert p.value == pytest.approx(0.5, abs=0.05)
    assert d.model_after.gyro.lowpass_hz == pytest.approx(p.value)
    assert d.model_after.gyro.delay_s == pytest.approx(d.model_before.gyro.delay_s, abs=1e-3)


@pytest.mark.slow
def test_a_long_delay_is_no_low_pass():
    d = diagnosed("signal_delay", "large", "speed")
    assert "signal_delay" in {c.name for c in d.causes}
    assert not any("sensor_lowpass" in names for names in d.look_alikes)


@pytest.mark.slow
@pytest.mark.parametrize(("cause", "signal"), [
    ("signal_delay", "yaw_rate"), ("sensor_lowpass", "accel"),
])  # fmt: skip
def test_what_was_hidden_is_among_what_is_named(cause, signal):
    d = diagnosed(cause, "medium", signal)
    assert cause in {c.name for c in d.causes} | {n for names in d.look_alikes for n in names}
    if d.look_alikes:
        assert d.look_alikes == BOTH
        assert d.verdict == "ambiguous"
        assert "low-pass" in d.to_separate
