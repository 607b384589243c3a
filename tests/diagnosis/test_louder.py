"""Whether more is left of an equation than the drives left that the model file was made of."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.core.errors import ConfigError
from imucald.core.samples import Series
from imucald.diagnosis.cause_keys import mount_of
from imucald.diagnosis.fit.beside_file import leaves_of
from imucald.diagnosis.fit.chance import beyond_chance
from imucald.diagnosis.left_over.louder import LEAVES
from imucald.diagnosis.left_over.remains import Remains, rms_by_band
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import STEP_S, drive_of
from imucald.model.model import VehicleModel, load_model, model_from_mapping
from imucald.simulation import random_model, simulate

SEGMENTS, SEGMENT_S, SPREAD = 40, 30.0, 0.5


def segments(seed: int, times: float = 1.0, count: int = SEGMENTS):
    """Speeds (B,) and rms (B, 6) of segments that differ as roads do."""
    rng = np.random.default_rng(seed)
    return rng.uniform(5.0, 30.0, count), times * 0.1 * np.exp(SPREAD * rng.normal(size=(count, 6)))


def found(seed: int, times: float, count: int = SEGMENTS, name: str = "accel_z"):
    file = leaves_of({name: segments(seed)}, SEGMENT_S)[name]
    return beyond_chance(LEAVES.of_entry(name, segments(1000 + seed, times, count)[1], file))


def test_a_sine_lies_in_its_band_with_its_size():
    t = STEP_S * (np.arange(300) + 0.5)
    rms = rms_by_band(np.cos(2.0 * np.pi * 0.3 * t)[None], np.ones((1, 300), dtype=bool))[0]
    assert rms[2] == pytest.approx(np.sqrt(0.5))
    assert np.delete(rms, 2) == pytest.approx(np.zeros(5), abs=1e-9)


def test_the_file_carries_the_middle_and_the_spread_of_segments():
    made = leaves_of({"accel_z": segments(1, count=4000)}, SEGMENT_S)["accel_z"]
    assert made.rms == pytest.approx([0.1] * 6, rel=0.05)
    assert made.spread == pytest.approx([SPREAD] * 6, rel=0.05)
    assert made.speeds_mps == pytest.approx((6.25, 28.75), abs=0.5)


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_another_road_is_nothing(times):
    assert [found(seed, times) for seed in range(20)] == [[]] * 20


def test_what_no_road_of_the_next_class_leaves_is_reported_with_its_size():
    (one,) = found(3, 10.0)
    assert one.signal == "accel_z"
    assert one.size == pytest.approx(5.0, rel=0.5)
    assert "times the residual that the model file states" in one.text


def test_what_the_road_does_not_shake_is_held_more_sharply():
    """Along the road nothing is twice as much by chance, and by a deviation more."""
    assert [s.signal for s in found(4, 3.0, name="accel_x")] == ["accel_x"]
    assert found(4, 3.0) == []
    assert [found(seed, 1.5, name="accel_x") for seed in range(20)] == [[]] * 20


@pytest.mark.parametrize(("band", "is_seen"), [(0, True), (1, True), (2, True), (3, False)])
def test_sideways_a_road_shakes_above_the_frequencies_at_which_the_body_lies_on_it(band, is_seen):
    """Of three times as much below 0.4 Hz no road is the reason."""
    file = leaves_of({"accel_y": segments(4)}, SEGMENT_S)["accel_y"]
    rms = segments(1004)[1]
    rms[:, band] *= 3.0
    assert bool(beyond_chance(LEAVES.of_entry("accel_y", rms, file))) == is_seen


@pytest.mark.parametrize("likeness", [0.0, 0.4])
def test_segments_that_last_over_neighbours_count_for_fewer(likeness):
    """Of 1,000 drives with nothing to see 1 % have a chance below 1 %, and no more."""
    rng, wrong = np.random.default_rng(5), 0
    for _ in range(1000):
        logs = np.empty((2, SEGMENTS, 6))
        logs[:, 0] = rng.normal(size=(2, 6))
        for k in range(1, SEGMENTS):
            new = rng.normal(size=(2, 6)) * np.sqrt(1.0 - likeness**2)
            logs[:, k] = likeness * logs[:, k - 1] + new
        own, other = np.exp(SPREAD * logs)
        v = np.linspace(5.0, 30.0, SEGMENTS)
        file = leaves_of({"accel_x": (v, other)}, SEGMENT_S)["accel_x"]
        wrong += next(LEAVES.of_entry("accel_x", own, file)).p < 0.01
    assert wrong <= 20


def test_few_segments_show_no_less_than_they_can():
    assert found(3, 3.0, count=10) == []
    assert leaves_of({"accel_z": segments(1, count=9)}, SEGMENT_S) == {}


def of(model: VehicleModel, seed: int, shake: float = 0.0):
    samples = dict(simulate(model, seed, 11.0).samples)
    accel = samples["accel"]
    push = shake * np.sin(2.0 * np.pi * 0.3 * accel.t)
    samples["accel"] = Series(accel.t, accel.values + push[:, None] * mount_of(model)[2])
    state = State([drive_of(samples)], model, model, {})
    return Remains(state.evaluated(), state).by_band


@pytest.mark.slow
def test_a_later_drive_is_held_against_what_the_file_carries():
    plain = random_model(516)
    assert list(LEAVES.answers(of(plain, 517, shake=1.0), plain)) == []
    model = LEAVES.written(plain, of(plain, 516))
    assert {"accel_x", "accel_y", "accel_z"} <= set(model.leaves)
    assert beyond_chance(LEAVES.answers(of(model, 517), model)) == []
    seen = beyond_chance(LEAVES.answers(of(model, 517, shake=1.0), model))
    assert "accel_z" in {s.signal for s in seen}


def test_it_is_written_and_read_again(tmp_path):
    leaves = leaves_of({"accel_z": segments(1)}, SEGMENT_S)
    model = VehicleModel(leaves=leaves)
    (tmp_path / "car.yaml").write_text(model.to_yaml())
    assert load_model(tmp_path / "car.yaml") == model


def test_another_number_of_bands_is_refused_with_its_place():
    stated = {"segments": 20, "segment_s": 30.0, "speeds_mps": [1.0, 2.0], "rms": [0.1] * 6}
    with pytest.raises(ConfigError, match=r"leaves\.accel_z\.spread"):
        model_from_mapping({"leaves": {"accel_z": {**stated, "spread": [0.1] * 5}}}, "car")
