"""The levels in which signals come: against the file's own drives, and holes in them."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from table_rows import odd

from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import GRAVITY, Series
from imucald.diagnosis.direct.levels import levels_of, step_of, with_levels
from imucald.diagnosis.fit.chance import beyond_chance
from imucald.diagnosis.result import Kind
from imucald.diagnosis.signals import drive_of
from imucald.model.model import VehicleModel, load_model

RATE_HZ, LENGTH_S = 20.0, 600.0


def speed_of(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and a speed [m/s] that stands fifteen times, and moves by up to 1.5 m/s^2."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, LENGTH_S, 0.2)
    wave = np.sin(2.0 * np.pi * t / 40.0) + 0.1 * np.sin(2.0 * np.pi * t / rng.uniform(5.0, 8.0))
    return t, np.maximum(0.0, 8.0 * wave + 3.0)


def samples(seed: int, speed_step: float = 0.01, accel_step: float = 0.01, from_mps: float = 0.0):
    """A drive; steps in which its signals come, and the speed below which it says 0."""
    rng = np.random.default_rng(seed)
    t, v = speed_of(seed)
    fast = np.arange(0.0, LENGTH_S, 1.0 / RATE_HZ)
    force = rng.normal(0.0, 0.3, (len(fast), 3))
    force[:, 2] += GRAVITY
    return {
        "accel": Series(fast, accel_step * np.round(force / accel_step)),
        "speed": Series(t, speed_step * np.round(np.where(v < from_mps, 0.0, v) / speed_step)),
    }


def file_of(**how):
    return with_levels(VehicleModel(), [drive_of(samples(1, **how))])


def found(file, made):
    return beyond_chance(
        a for k in (Kind.COARSER, Kind.VALUES_MISSING) for a in odd(k, drive_of(made), file)
    )


def test_a_grid_is_known_by_its_step_and_what_has_none_by_none():
    rng = np.random.default_rng(1)
    x = rng.normal(size=3000)
    assert step_of(levels_of(0.05 * np.round(x / 0.05))) == pytest.approx(0.05)
    assert step_of(levels_of(x)) == 0.0
    # Whole km/h in a field of 0.01 m/s.
    kmh = np.round(np.round(10.0 * np.abs(x)) / 3.6, 2)
    assert step_of(levels_of(kmh)) == pytest.approx(1.0 / 3.6, abs=0.01)


def test_the_file_says_in_which_steps_its_drives_came():
    file = file_of(accel_step=0.02)
    assert file.leaves["levels of accel"].rms[0] == pytest.approx(0.02)
    assert file.leaves["levels of speed"].rms[0] == pytest.approx(0.01)
    assert file.leaves["levels of speed"].speeds_mps[1] == pytest.approx(11.7, abs=0.3)
    assert file.with_changes({"leaves": {}}) == VehicleModel(), "no parameter changes"


def test_an_extended_file_is_read_as_it_was_written(tmp_path):
    file, path = file_of(), tmp_path / "model.yaml"
    path.write_text(file.to_yaml())
    assert load_model(path) == file


def test_a_file_without_levels_is_held_against_nothing():
    assert odd(Kind.COARSER, drive_of(samples(2, 1.0 / 3.6))) == []


def test_a_file_with_a_step_of_nothing_is_held_against_nothing():
    """As a person may write it."""
    file = file_of()
    leaves = {name: {**msgspec.to_builtins(x), "rms": [0.0] * 6} for name, x in file.leaves.items()}
    assert found(file.with_changes({"leaves": leaves}), samples(2, 1.0 / 3.6)) == []


def test_a_file_whose_drives_never_stopped_says_nothing_of_standing():
    moving = samples(1)
    moving["speed"] = Series(moving["speed"].t, moving["speed"].values + 5.0)
    file = with_levels(VehicleModel(), [drive_of(moving)])
    assert found(file, samples(2, from_mps=1.0)) == []


def test_another_drive_of_the_same_sensors_is_nothing():
    file = file_of()
    assert [found(file, samples(seed)) for seed in range(2, 12)] == [[]] * 10


def test_whole_kmh_are_reported_with_their_step_and_that_of_the_file():
    (one,) = [s for s in found(file_of(), samples(2, 1.0 / 3.6)) if s.kind == Kind.COARSER]
    assert one.signal == "speed"
    assert one.size == pytest.approx(27.8, abs=0.1)
    assert "0.278 m/s" in one.text
    assert "(0.01)" in one.text


@pytest.mark.parametrize("channel", ["accel", "speed"])
@pytest.mark.parametrize("gain", [0.8, 0.88, 1.12, 1.2])
def test_a_gain_moves_the_levels_and_is_no_other_resolution(channel, gain):
    made = samples(2)
    made[channel] = Series(made[channel].t, made[channel].values * gain)
    assert found(file_of(), made) == []


def test_a_finer_drive_is_nothing():
    assert found(file_of(accel_step=0.1), samples(2, accel_step=0.01)) == []


def test_each_number_of_a_sensor_is_asked():
    made = samples(2)
    values = made["accel"].values.copy()
    values[:, 1] = 0.04 * np.round(values[:, 1] / 0.04)
    made["accel"] = Series(made["accel"].t, values)
    assert [(s.signal, s.kind) for s in found(file_of(), made)] == [("accel_y", Kind.COARSER)]


def test_a_speed_that_says_0_up_to_walking_pace_is_reported():
    (one,) = found(file_of(), samples(2, from_mps=1.0))
    assert (one.signal, one.kind) == ("speed", Kind.VALUES_MISSING)
    assert "shows 0 up to 1" in one.text


def test_so_is_none_whose_file_says_the_same():
    assert found(file_of(from_mps=1.0), samples(2, from_mps=1.0)) == []


def test_a_bit_that_is_always_0_leaves_holes():
    made = samples(2)
    values = made["accel"].values.copy()
    codes = np.round(values[:, 1] / 0.01).astype(int)
    values[:, 1] = 0.01 * (codes & ~32)
    made["accel"] = Series(made["accel"].t, values)
    (one,) = beyond_chance(odd(Kind.VALUES_MISSING, drive_of(made)))
    assert (one.signal, one.kind) == ("accel_y", Kind.VALUES_MISSING)
    assert one.size > 30.0


def test_sound_signals_have_no_holes():
    for seed in range(10):
        assert beyond_chance(odd(Kind.VALUES_MISSING, drive_of(samples(seed)))) == []


def test_two_places_with_nothing_between_are_no_hole_where_it_goes_over_once():
    """A sensor that is turned in mid-drive."""
    made = samples(2)
    values = 0.1 * made["accel"].values
    values[len(values) // 2 :] += 5.0
    made["accel"] = Series(made["accel"].t, 0.01 * np.round(values / 0.01))
    assert beyond_chance(odd(Kind.VALUES_MISSING, drive_of(made))) == []


def test_who_rounds_twice_leaves_no_holes():
    """An LSB of 0.0098 in a field of 0.002: codes are left out all over."""
    made = samples(2)
    x = 0.0098 * np.round(made["accel"].values / 0.0098)
    made["accel"] = Series(made["accel"].t, 0.002 * np.round(x / 0.002))
    assert beyond_chance(odd(Kind.VALUES_MISSING, drive_of(made))) == []


@pytest.mark.parametrize("degrees", [2.0, 10.0, 30.0])
def test_readings_that_were_turned_after_they_were_rounded_leave_no_holes(degrees):
    """They lie in heaps, one coarse step apart."""
    made = samples(2, accel_step=0.125)
    R = rotation_from_vector(np.radians(degrees) * np.array([0.1, 0.3, 0.95]))
    turned = made["accel"].values @ R.T
    half = np.arange(len(turned))[:, None] < 0.4 * len(turned)
    for values in (turned, np.where(half, made["accel"].values, turned)):
        made["accel"] = Series(made["accel"].t, values)
        assert beyond_chance(odd(Kind.VALUES_MISSING, drive_of(made))) == []
