"""Whether something acts in some segments and not in the others."""

from __future__ import annotations

import numpy as np
import pytest
from table_rows import remains

from imucald.diagnosis.fit.beside_file import leaves_of
from imucald.diagnosis.fit.blocks import Table
from imucald.diagnosis.fit.chance import Answer, beyond_chance, reported
from imucald.diagnosis.fit.score import Hypothesis, Problem
from imucald.diagnosis.left_over.louder import _of_equation
from imucald.diagnosis.left_over.table import LEFT
from imucald.diagnosis.result import Kind, Structure
from imucald.diagnosis.search.state import State
from imucald.diagnosis.signals import drive_of
from imucald.simulation import random_model, simulate

SEGMENTS, ROWS, TOLERANCE = 45, 60, 0.06


def of_segments(
    seed: int,
    extra=0.0,
    zero=0.0,
    segments: int = SEGMENTS,
    known_to: float = TOLERANCE,
    gyro: bool = True,
) -> Problem:
    """Forward force with noise, a zero and a gain. extra: (segments,) noise that some have more;
    zero: (segments,) of each. known_to: tolerance of the zero."""
    rng = np.random.default_rng(seed)
    X = np.stack([np.full((segments, ROWS), 1.0), rng.standard_normal((segments, ROWS))], axis=2)
    loud = np.reshape(np.hypot(0.1, extra), (-1, 1))
    y = loud * rng.standard_normal((segments, ROWS)) + np.reshape(zero, (-1, 1))
    A = np.concatenate([y[:, :, None], X], axis=2)
    gram = np.swapaxes(A, 1, 2) @ A
    plain = np.stack([gram, np.zeros_like(gram)], axis=1) / ROWS
    tolerance = np.array([known_to, known_to / 6.0])
    table = Table(
        ("accel.bias.x", "accel.scale.0"), 100.0 * gram, {"accel_x": 100.0 * gram},
        30.0 * np.arange(segments), np.zeros(segments, dtype=int),
        np.ones(segments), tolerance, np.zeros(2), np.array([[-1.0, 1.0], [-0.1, 0.1]]),
        {"accel_x": 1.0}, 30.0, {"accel_x": plain} | ({"gyro_x": plain} if gyro else {}),
        np.zeros((segments, 2)), np.arange(segments),
    )  # fmt: skip
    return Problem(table, -tolerance, tolerance)


def uneven(problem: Problem, drift: Hypothesis | None = None) -> list[Structure]:
    rows = [row for row in LEFT if row.kind == Kind.UNEVEN]
    return reported(rows, remains(problem, drift=drift), lambda _: None)


@pytest.mark.parametrize("seed", range(10))
def test_segments_of_one_noise_are_even(seed):
    assert uneven(of_segments(seed)) == []


def test_what_acts_in_some_segments_is_reported_with_its_size_and_one_segment_does_not_decide():
    some = np.where(np.arange(SEGMENTS) % 6 == 0, 0.3, 0.0)
    found = uneven(of_segments(3, some))
    assert [s.kind for s in found] == ["some segments leave more"]
    # Of a power 0.1^2 + 0.3^2 what chance makes of 0.1^2 is taken off; the tolerance is 0.061.
    assert found[0].size == pytest.approx(np.sqrt(0.1 - 0.015) / 0.061, rel=0.2)
    one = np.where(np.arange(SEGMENTS) == 7, 3.0, 0.0)
    assert uneven(of_segments(4, one)) == []


@pytest.mark.parametrize("segments", [4, 6, 9])
def test_few_segments_of_one_noise_are_even_whatever_the_file_is_known_to(segments):
    """Each is loud by itself in 1 %, beside a median that is not known well, and two must be."""
    drives = [of_segments(seed, 0.0, 0.0, segments, 1e-6) for seed in range(400)]
    assert np.mean([uneven(p) != [] for p in drives]) < 0.015


def test_what_acts_in_some_of_few_segments_is_reported_and_one_does_not_decide():
    some = np.where(np.arange(8) % 4 == 1, 0.3, 0.0)
    assert [s.kind for s in uneven(of_segments(3, some, 0.0, 8))] != []
    one = np.where(np.arange(8) == 1, 3.0, 0.0)
    assert uneven(of_segments(4, one, 0.0, 8)) == []


def test_without_a_gyroscope_slopes_stand_in_the_segments_and_nothing_is_said():
    some = np.where(np.arange(SEGMENTS) % 6 == 0, 0.3, 0.0)
    assert uneven(of_segments(3, some, gyro=False)) == []


def test_what_a_correct_file_makes_of_some_segments_is_even():
    some = np.where(np.arange(SEGMENTS) % 6 == 0, 0.5 * TOLERANCE, 0.0)
    assert uneven(of_segments(5, 0.0, some)) == []


def test_what_a_drift_makes_is_taken_off():
    ramp = np.linspace(0.0, 1.0, SEGMENTS)
    p = of_segments(6, 0.0, 0.6 * ramp)
    assert uneven(p) != []
    drift = Hypothesis("accel_bias_drift", ("accel.bias.x",), pattern=ramp)
    assert uneven(p, drift=drift) == []


@pytest.mark.parametrize("seed", [516, 519])
def test_a_speed_that_is_zero_below_its_dead_band_leaves_nothing_at_stops(seed):
    """A jump by 0.3 m/s at each stop is the speed sensor's, and none of the vehicle's."""
    model = random_model(seed)
    state = State([drive_of(simulate(model, seed, 10.0).samples)], model, model, {})
    assert uneven(state.evaluated()) == []


STATED, BAND = 40, 1


def leaving(seed: int, count: int, lasts: float = 0.0):
    """rms (count, 6) of segments that differ as roads do; lasts: correlation of neighbours."""
    rng = np.random.default_rng(seed)
    own = rng.normal(size=(count, 6))
    for b in range(1, count):
        own[b] = lasts * own[b - 1] + np.sqrt(1.0 - lasts**2) * own[b]
    return 0.1 * np.exp(0.5 * own)


def beside_stated(rms, seed: int = 0, lasts: float = 0.0, name: str = "accel_y") -> Answer:
    """rms of a later drive beside a file that other segments of the same kind gave."""
    speeds = np.full(STATED, 10.0)
    file = leaves_of({name: (speeds, leaving(900 + seed, STATED, lasts))}, 30.0)[name]
    return _of_equation(name, rms, file)


@pytest.mark.parametrize("name", ["accel_x", "accel_y"])
@pytest.mark.parametrize("lasts", [0.0, 0.3])
@pytest.mark.parametrize("count", [4, 8, 40])
def test_later_segments_that_differ_as_the_files_do_are_within_chance(count, lasts, name):
    asked = [beside_stated(leaving(s, count, lasts), s, lasts, name) for s in range(200)]
    assert np.mean([q.p < 0.05 for q in asked]) <= 0.05
    assert beyond_chance(asked) == []


@pytest.mark.parametrize(
    ("each", "least", "own"), [(10, -1.03, 1.29), (3, -0.53, 0.69), (1, 0.0, 0.0)]
)
def test_what_acts_in_any_share_of_the_segments_is_seen_beside_the_file_with_its_size(
    each, least, own
):
    """least: expected deviation of the quietest of those that count (4 of 4, 10 of 14, half); own:
    of as many of all segments. A class of road is 2."""
    rms = leaving(1, STATED)
    rms[::each, BAND] *= 40.0
    (found,) = beyond_chance([beside_stated(rms)])
    assert found.signal == "accel_y"
    assert "between 0.1 and 0.2 Hz" in found.text
    assert found.size == pytest.approx(40.0 * np.exp(0.5 * (least - own)) / 2.0, rel=0.5)


def test_one_segment_does_not_decide_beside_the_file():
    rms = leaving(1, STATED)
    rms[7, BAND] *= 1000.0
    assert beyond_chance([beside_stated(rms)]) == []


def test_six_segments_are_enough_where_half_of_them_leave_far_more():
    rms = leaving(1, 6)
    rms[::2, BAND] *= 100.0
    assert beyond_chance([beside_stated(rms)]) != []


def test_a_rougher_road_is_rougher_in_every_band_and_nothing_is_said():
    rms = leaving(1, STATED)
    rms[::4] *= 20.0
    assert beyond_chance([beside_stated(rms)]) == []
    assert beyond_chance([beside_stated(rms, name="accel_x")]) != []  # no road pushes forward


def test_less_than_a_class_of_road_is_not_said_however_sure_it_is():
    spread = leaving(2, 4000) ** 0.02
    rms = spread * np.where(np.arange(6) == BAND, 1.8, 1.0)
    file = leaves_of({"accel_x": (np.full(4000, 10.0), leaving(3, 4000) ** 0.02)}, 30.0)["accel_x"]
    asked = _of_equation("accel_x", rms, file)
    assert asked.p < 1e-6
    assert not asked.is_large
