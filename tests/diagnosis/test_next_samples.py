"""How samples follow each other, against the drives that a model file was made of."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import median_filter
from table_rows import odd

from imucald.core.samples import GRAVITY, Series
from imucald.diagnosis.cause_keys import mount_of
from imucald.diagnosis.direct.levels import with_levels
from imucald.diagnosis.direct.successive import follows, traits_of
from imucald.diagnosis.fit.chance import beyond_chance
from imucald.diagnosis.result import Kind
from imucald.diagnosis.signals import drive_of
from imucald.model.model import VehicleModel, load_model

RATE_HZ, LENGTH_S, LSB, KMH = 50.0, 400.0, 0.01, 1.0 / 3.6
TURNED = VehicleModel().with_changes({"mount.yaw_deg": 20.0, "mount.roll_deg": 10.0})


def samples(seed: int, road: float = 1.0, jerk: float = 1.0) -> dict[str, Series]:
    """A drive on roads that differ from one half minute to the next; whole km/h twice a second."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, LENGTH_S, 1.0 / RATE_HZ)
    slow = t[::25]
    pull = np.cumsum(rng.standard_normal(len(slow))) * 0.3 * jerk
    v = 15.0 + 5.0 * np.sin(slow / 20.0) + pull - np.convolve(pull, np.ones(41) / 41.0, "same")
    made = {"speed": Series(slow, KMH * np.round(np.maximum(v, 1.0) / KMH))}
    classes = road * np.exp(0.4 * rng.standard_normal(int(LENGTH_S / 30.0) + 1))
    for name, size, mean in (("accel", 0.06, GRAVITY), ("gyro", 0.03, 0.0)):
        white = rng.standard_normal((len(t), 3))
        shaken = (white + np.roll(white, 1, axis=0)) * classes[(t / 30.0).astype(int)][:, None]
        x = size * shaken + [0.0, 0.0, mean]
        made[name] = Series(t, LSB * np.round(x / LSB))
    return made


@pytest.fixture(scope="module")
def file() -> VehicleModel:
    parts = [drive_of(samples(1))]
    model = with_levels(VehicleModel(), parts)
    return follows(parts, model).written(model, traits_of(parts))


def asked_of(drives, file: VehicleModel):
    return odd(Kind.FOLLOWS_OTHERWISE, *drives, file)


def found(file: VehicleModel, made: dict[str, Series]):
    return beyond_chance(asked_of([drive_of(made)], file))


def changed(made: dict[str, Series], name: str, change) -> dict[str, Series]:
    series = made[name]
    values = np.apply_along_axis(change, 0, series.values)
    return made | {name: Series(series.t, LSB * np.round(values / LSB))}


def in_gaps(x):
    """Half a second in two is a straight line."""
    at = np.arange(len(x))
    kept = at % 100 >= 25
    return np.interp(at, at[kept], x[kept])


def by_lines(x):
    """One sample in four was sent, and straight lines lie between."""
    at = np.arange(len(x))
    return np.interp(at, at[::4], x[::4])


def test_other_roads_and_other_drivers_are_nothing(file):
    for seed in range(2, 10):
        assert found(file, samples(seed)) == []
        assert found(file, samples(seed, road=2.0)) == []
        assert found(file, samples(seed, road=0.5, jerk=3.0)) == []


@pytest.mark.parametrize(("change", "words"), [
    (in_gaps, "repeats the previous sample more often"),
    (lambda x: np.repeat(x[::2], 2)[: len(x)], "repeats the previous sample more often"),
    (by_lines, "reverses a smaller part of each change"),
    (lambda x: median_filter(x, 5), "has more very large changes"),
])  # fmt: skip
def test_what_comes_between_sensor_and_log_is_seen_on_all_axes_alike(file, change, words):
    """No equation shows it, and no axis differs from the others."""
    left = found(file, changed(samples(2), "gyro", change))
    assert {s.kind for s in left} == {Kind.FOLLOWS_OTHERWISE}
    assert {s.signal for s in left} == {"gyro_x", "gyro_y", "gyro_z"}
    asked = asked_of([drive_of(changed(samples(2), "gyro", change))], file)
    assert any(words in q.structure.text and q.is_large and q.p < 1e-6 for q in asked)


def test_wrong_single_values_make_heavy_tails(file):
    rng = np.random.default_rng(3)
    left = found(
        file, changed(samples(2), "accel", lambda x: x + 2.0 * (rng.random(len(x)) < 0.02))
    )
    assert {s.signal for s in left} == {"accel_x", "accel_y", "accel_z"}


def test_a_speed_that_is_held_repeats_itself(file):
    made = samples(2)
    held = np.repeat(made["speed"].values[::4], 4)[: len(made["speed"].t)]
    left = found(file, made | {"speed": Series(made["speed"].t, held)})
    assert [s.signal for s in left] == ["speed"]
    assert "repeats the previous sample more often" in left[0].text


def test_a_sensor_that_was_turned_has_other_levels_and_is_not_asked_for_repeats(file):
    """Readings that were turned after they were rounded repeat where all three axes do."""
    made = samples(2)
    for name in ("accel", "gyro"):
        made[name] = Series(made[name].t, made[name].values @ mount_of(TURNED))
    assert found(file, made) == []


def test_lost_frames_change_nothing(file):
    made, rng = samples(2), np.random.default_rng(4)
    for name in ("accel", "gyro"):
        kept = rng.random(len(made[name].t)) > 0.1
        made[name] = Series(made[name].t[kept], made[name].values[kept])
    assert found(file, made) == []


def test_a_file_that_does_not_say_it_asks_nothing():
    assert asked_of([drive_of(samples(2))], VehicleModel()) == []


def test_what_is_written_is_read_back(file, tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text(file.to_yaml(), encoding="utf-8")
    assert load_model(path).leaves == file.leaves
    assert "samples of gyro_y at 50 Hz" in file.leaves
