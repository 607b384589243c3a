"""How signals change from one sample to the next: against the file's drives, and by themselves."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from table_rows import left, odd

from imucald.core.samples import GRAVITY, Series
from imucald.diagnosis.cause_keys import mount_of
from imucald.diagnosis.direct.faults import find_faults
from imucald.diagnosis.direct.successive import (
    CHANGES,
    SEGMENT_S,
    changes_of,
)
from imucald.diagnosis.fit.chance import beyond_chance
from imucald.diagnosis.result import Kind
from imucald.diagnosis.signals import drive_of
from imucald.model.model import VehicleModel, load_model

RATE_HZ, LENGTH_S, LSB = 50.0, 600.0, 0.001
PLAIN = VehicleModel()
TURNED = PLAIN.with_changes({"mount.yaw_deg": 70.0, "mount.roll_deg": 80.0})


def samples(seed: int, shaken=(1.0, 1.0, 1.0), model=PLAIN, **changes):
    """A drive on roads that differ by a half from one half minute to the next, about vehicle axes
    that are shaken so much; in the sensor's axes."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, LENGTH_S, 1.0 / RATE_HZ)
    road = np.exp(0.4 * rng.standard_normal(int(LENGTH_S / 30.0) + 1))[(t / 30.0).astype(int)]
    R = mount_of(model)
    made = {"speed": Series(t[::10], 15.0 + np.sin(t[::10] / 20.0))}
    for name, size, mean in (("accel", 0.3, GRAVITY), ("gyro", 0.02, 0.0)):
        x = size * road[:, None] * rng.standard_normal((len(t), 3)) * shaken + [0.0, 0.0, mean]
        made[name] = Series(t, LSB * np.round(x @ R / LSB))
    return made | changes


def file_of(model=PLAIN, **how):
    return CHANGES.written(model, changes_of([drive_of(samples(1, model=model, **how))], model))


def found(file, made, model=PLAIN):
    state = SimpleNamespace(drives=[drive_of(made)], model=model, stated=file)
    return beyond_chance(left(Kind.CHANGES_OTHERWISE, SimpleNamespace(state=state)))


def test_the_ratio_to_the_other_axes_is_carried_by_rate():
    file = file_of(shaken=(1.0, 1.0, 3.0))
    ratios = file.leaves["changes of accel_z at 50 Hz"]
    assert ratios.rms == pytest.approx([3.0] * 6, rel=0.1)
    assert ratios.segments == 59


def test_another_road_and_a_rougher_one_are_nothing():
    file = file_of()
    assert [found(file, samples(seed)) for seed in range(2, 12)] == [[]] * 10
    assert found(file, samples(2, shaken=(3.0, 3.0, 3.0))) == []


@pytest.mark.parametrize(("times", "words"), [(3.0, " 3 times"), (0.33, "0.33 times")])
def test_an_axis_that_is_shaken_otherwise_is_reported_with_its_ratio(times, words):
    shown = found(file_of(), samples(2, shaken=(1.0, times, 1.0)))
    assert {(s.signal, s.kind) for s in shown} >= {("accel_y", Kind.CHANGES_OTHERWISE)}
    one = next(s for s in shown if s.signal == "accel_y")
    assert one.size == pytest.approx(max(times, 1 / times) / 2**0.5, rel=0.15)
    assert "in the drives of the model file" in one.text


def test_a_sensor_that_is_turned_is_held_against_the_vehicles_axes():
    shaken = (1.0, 1.0, 3.0)
    file = file_of(shaken=shaken)
    assert found(file, samples(2, shaken, TURNED), TURNED) == []
    # Beside the wrong mount it is another one.
    assert found(file, samples(2, shaken, TURNED), PLAIN) != []


def test_another_rate_is_not_compared():
    made = samples(2, shaken=(1.0, 5.0, 1.0))
    half = {k: Series(s.t[::2], s.values[::2]) for k, s in made.items() if k != "speed"}
    file = file_of()
    assert list(CHANGES.answers(changes_of([drive_of(made | half)], PLAIN), file)) == []


def test_an_extended_file_is_read_as_it_was_written(tmp_path):
    file = file_of()
    path = tmp_path / "model.yaml"
    path.write_text(file.to_yaml())
    assert load_model(path).leaves == file.leaves


# sent on change ----------------------------------------------------------------------------------


def on_change(x: np.ndarray, by: float) -> np.ndarray:
    """What is sent of a signal where each number stays until it is off by so much."""
    out, held = np.empty_like(x), x[0].copy()
    for k, now in enumerate(x):
        send = np.abs(now - held) >= by
        held[send] = now[send]
        out[k] = held
    return out


def test_sound_signals_change_by_little_oftener_than_by_much():
    for seed in range(10):
        assert beyond_chance(odd(Kind.CHANGES_MISSING, drive_of(samples(seed)))) == []


def test_a_pure_vibration_is_no_signal_that_stays():
    """Of all motions it has the fewest small changes."""
    made = samples(2)
    t = made["gyro"].t
    x = 0.3 * np.sin(2.0 * np.pi * 11.3 * t)[:, None] * [1.0, 0.7, 0.4]
    made["gyro"] = Series(t, LSB * np.round(x / LSB))
    assert beyond_chance(odd(Kind.CHANGES_MISSING, drive_of(made))) == []


def test_what_is_sent_on_change_is_reported_and_not_called_stuck():
    made = samples(2)
    slow = np.sin(made["gyro"].t / 9.0)[:, None] * [0.2, 0.1, 0.1]
    x = LSB * np.round((slow + 0.1 * made["gyro"].values) / LSB)
    made["gyro"] = Series(made["gyro"].t, on_change(x, 0.04))
    shown = beyond_chance(odd(Kind.CHANGES_MISSING, drive_of(made)))
    assert {(s.signal, s.kind) for s in shown} == {
        (f"gyro_{axis}", Kind.CHANGES_MISSING) for axis in "xyz"
    }
    assert not [f for f in find_faults(made, PLAIN) if f.cause == "stuck_signal"]


def test_a_stuck_sensor_is_still_called_so():
    made = samples(2)
    values = made["gyro"].values.copy()
    values[10_000:11_000] = values[10_000]
    made["gyro"] = Series(made["gyro"].t, values)
    assert [f.cause for f in find_faults(made, PLAIN)] == ["stuck_signal"]


def test_nothing_is_asked_of_few_changes():
    made = {k: Series(s.t[s.t < 60.0], s.values[s.t < 60.0]) for k, s in samples(2).items()}
    made["gyro"] = Series(made["gyro"].t, np.zeros_like(made["gyro"].values))
    drive = drive_of(made)
    assert not [a for a in odd(Kind.CHANGES_MISSING, drive) if a.signal.startswith("gyro")]
    names = {f"changes of {n}_{a} at 50 Hz" for n in ("accel", "gyro") for a in "xyz"}
    assert set(changes_of([drive], PLAIN)[SEGMENT_S]) <= names


# jumps -------------------------------------------------------------------------------------------


def jumping(made):
    """Signals that are reported."""
    shown = beyond_chance(odd(Kind.JUMPS_ALONE, drive_of(made)))
    assert {s.kind for s in shown} <= {Kind.JUMPS_ALONE}
    return {s.signal for s in shown}


def test_wrong_values_of_a_short_signal_without_levels_jump():
    """136 samples on no grid: neither its step nor its noise is known, and 5 are 130 km/h."""
    t, rng = np.arange(136.0), np.random.default_rng(5)
    x = 12.0 + 4.0 * np.sin(t / 9.0) + 0.1 * rng.standard_normal(len(t))
    made = samples(2) | {"speed": Series(t, x)}
    assert "speed" not in jumping(made)
    x = np.where(np.arange(len(t)) % 25 == 9, 130.0 / 3.6, x)
    assert "speed" in jumping(made | {"speed": Series(t, x)})


def wrong_now_and_then(x, share, rng):
    """A share of the readings is anywhere within 5 of the true value."""
    hit = rng.random(len(x)) < share
    return x + hit * rng.uniform(-5.0, 5.0, len(x))


def test_wrong_values_now_and_then_are_reported_where_they_are():
    made = samples(2)
    x = made["accel"].values.copy()
    x[:, 1] = wrong_now_and_then(x[:, 1], 0.006, np.random.default_rng(1))
    made["accel"] = Series(made["accel"].t, LSB * np.round(x / LSB))
    assert jumping(made) == {"accel_y"}


def test_axes_that_change_places_now_and_then_are_reported():
    made = samples(2)
    x = made["accel"].values.copy()
    hit = np.random.default_rng(1).random(len(x)) < 0.01
    x[hit] = x[hit][:, [2, 1, 0]]
    made["accel"] = Series(made["accel"].t, x)
    assert jumping(made) == {"accel_x", "accel_z"}


def test_a_wrong_value_or_two_are_no_fault_of_the_sensor():
    made = samples(2)
    x = made["accel"].values.copy()
    x[::5000, 1] += 5.0
    made["accel"] = Series(made["accel"].t, x)
    assert jumping(made) == set()


def test_what_is_normal_jumps_nowhere_on_any_road():
    for seed in range(10):
        assert jumping(samples(seed)) == set()


def test_blows_of_the_road_shake_on():
    """A wheel that hops at 12 Hz, a tenth of critical, once in two seconds."""
    made = samples(2)
    t, rng = made["accel"].t, np.random.default_rng(1)
    x = 0.2 * made["accel"].values
    after = np.arange(0.0, 1.0, 1.0 / RATE_HZ)
    ringing = np.exp(-7.5 * after) * np.sin(75.0 * after)
    for at in rng.integers(0, len(t) - len(after), 300):
        x[at : at + len(after), 2] += rng.uniform(2.0, 8.0) * ringing
    made["accel"] = Series(t, LSB * np.round(x / LSB))
    assert jumping(made) == set()


def test_a_sensor_that_is_read_faster_than_it_measures_does_not_jump():
    made = samples(2)
    fresh = np.arange(len(made["gyro"].t)) // 12 * 12
    made["gyro"] = Series(made["gyro"].t, made["gyro"].values[fresh])
    assert jumping(made) == set()


def test_a_speed_that_leaves_zero_by_a_jump_is_sound():
    made = samples(2)
    t = made["speed"].t
    v = np.maximum(2.0 * np.sin(t / 2.0), 0.0)
    made["speed"] = Series(t, np.where(v < 0.25, 0.0, 0.01 * np.round(v / 0.01)))
    assert jumping(made) == set()


@pytest.mark.parametrize("freedom", [3.0, 5.0])
def test_of_noise_with_long_tails_chances_are_no_smaller_than_they_say(freedom):
    """Student's law, down to what has a variance and not much more."""
    rng, below = np.random.default_rng(4), 0
    first = {name: Series(s.t[s.t < 60.0], s.values[s.t < 60.0]) for name, s in samples(0).items()}
    t = first["gyro"].t
    for _ in range(150):
        x = rng.standard_t(freedom, (len(t), 3))
        asked = odd(
            Kind.JUMPS_ALONE, drive_of(first | {"gyro": Series(t, LSB * np.round(x / LSB))})
        )
        below += sum(q.p < 0.01 for q in asked if q.signal.startswith("gyro"))
    assert below <= 10  # of 450
