"""Stream time: steady whatever the stamps do, and the same for one stamp and for columns."""

import itertools
import time

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imucald.runtime.timebase import TimeBase

STEPS = st.lists(
    st.one_of(
        st.floats(0.0, 0.2),
        st.floats(-0.9, 0.0),
        st.sampled_from([-3600.0, 3600.0, -1.5, 11.0, 0.0]),
    ),
    min_size=1,
    max_size=60,
)


@given(STEPS, st.integers(1, 20))
def test_columns_and_single_stamps_give_the_same_bits(steps, chunk):
    stamps = 1.6e9 + np.cumsum(steps)
    single = TimeBase()
    one = [single.stream_time(float(s)) for s in stamps]
    whole = TimeBase()
    t, gaps = [], []
    for i in range(0, len(stamps), chunk):
        for segment in whole.segments(stamps[i : i + chunk]):
            t += segment.t.tolist()
            gaps += [segment.gap] + [False] * (len(segment.t) - 1)
    assert t == [x for x, _ in one]
    assert gaps == [g for _, g in one]


@pytest.mark.parametrize("share", [0.0, 0.002, 0.2])
def test_long_columns_and_single_stamps_give_the_same_bits(share):
    rng = np.random.default_rng(5)
    steps = np.where(rng.random(20_000) < share, rng.choice([-30.0, -0.5, 5.0, 60.0], 20_000), 0.01)
    stamps = 1.6e9 + np.cumsum(steps + 0.002 * rng.normal(size=20_000))
    single, whole = TimeBase(), TimeBase()
    one = [single.stream_time(float(s)) for s in stamps]
    found = [segment for part in np.split(stamps, 4) for segment in whole.segments(part)]
    assert np.concatenate([segment.t for segment in found]).tolist() == [t for t, _ in one]
    assert sum(segment.gap for segment in found) == sum(gap for _, gap in one)
    assert vars(whole) == vars(single)


@given(STEPS)
def test_stream_time_never_goes_backwards(steps):
    base = TimeBase()
    t = [base.stream_time(float(s))[0] for s in 1.6e9 + np.cumsum(steps)]
    assert all(b >= a for a, b in itertools.pairwise(t))


def test_an_hour_back_is_a_new_segment_that_goes_on_within_a_tick():
    base = TimeBase()
    base.stream_time(1000.0)
    base.stream_time(1005.03)
    t, gap = base.stream_time(1005.03 - 3600)
    assert gap
    assert 5.03 < t <= 5.03 + 0.1
    t2, gap = base.stream_time(1005.04 - 3600)
    assert not gap
    assert abs(t2 - t - 0.01) < 1e-9
    assert base.steps == 1


def test_a_long_hole_is_shortened_whether_or_not_somebody_watched_it():
    asleep, awake = TimeBase(), TimeBase()
    for base in (asleep, awake):
        base.stream_time(0.0)
        base.stream_time(1.23)
    for elapsed in np.arange(0.0, 498.0, 0.5):
        awake.idle(elapsed)
    assert asleep.stream_time(500.0) == awake.stream_time(500.0)
    assert asleep.now <= 1.23 + 10.1 + 1e-9


def test_a_short_silence_keeps_its_length():
    base = TimeBase()
    base.stream_time(0.0)
    base.idle(3.0)
    t, gap = base.stream_time(4.0)
    assert (t, gap) == (4.0, False)


@pytest.mark.parametrize("set_back", [2.0, 5.0, 8.5, 8.9, 60.0])
@pytest.mark.parametrize("by_columns", [False, True])
def test_a_clock_set_back_in_a_silence_does_not_hold_up_stream_time(set_back, by_columns):
    base = TimeBase()
    base.stream_time(1000.0)
    base.stream_time(1001.0)
    silent = base.idle(7.5)
    stamps = 1009.0 - set_back + 0.01 * np.arange(100)
    if by_columns:
        (segment,) = base.segments(stamps)
        t, gap = segment.t, segment.gap
    else:
        found = [base.stream_time(float(stamp)) for stamp in stamps]
        t, gap = np.array([one for one, _ in found]), found[0][1]
    assert gap
    assert silent < t[0] <= silent + 0.1 + 1e-9, "in the tick after the silence"
    assert np.diff(t) == pytest.approx(np.full(99, 0.01))


def live(base: TimeBase | None = None) -> TimeBase:
    base = base or TimeBase()
    base.is_live = True
    return base


@pytest.mark.parametrize("set_back", [0.04, 0.09, 0.15, 0.3, 0.9, 1.0])
def test_a_clock_set_back_a_little_holds_up_a_live_stream_for_a_tick_at_most(set_back):
    true = 0.005 * np.arange(1000)
    stamps = 1.6e9 + true - np.where(true > 2.0, set_back, 0.0)
    base = live()
    found = [base.stream_time(float(stamp)) for stamp in stamps]
    t = np.array([one for one, _ in found])
    assert not any(gap for _, gap in found), "the samples have gone on: nothing begins anew"
    assert np.abs(t - true).max() < 0.1 + 1e-6
    if set_back > 0.1:
        assert base.steps == 1
        assert t[-1] == pytest.approx(true[-1], abs=0.006), "less than a sample is lost"


def test_set_backs_one_after_the_other_do_not_hold_up_a_live_stream():
    true = 0.01 * np.arange(2000)
    base = live()
    t = [base.stream_time(float(stamp)) for stamp in 1.6e9 + true - 0.7 * np.floor(true / 0.8)]
    assert t[-1][0] == pytest.approx(true[-1], abs=0.4)


def test_a_small_set_back_in_a_silence_does_not_hold_up_a_live_stream():
    base = live()
    base.stream_time(1000.0)
    silent = base.idle(7.5)
    t = np.array([base.stream_time(1007.0 + 0.01 * i)[0] for i in range(100)])
    assert t[0] == silent
    assert t[-1] == pytest.approx(silent + 0.99)


def test_a_live_stamp_that_is_late_by_itself_moves_nothing():
    base = live()
    stamps = np.round(1.6e9 + 0.01 * np.arange(500), 6)
    stamps[100::7] -= 0.5
    t = np.array([base.stream_time(float(stamp))[0] for stamp in stamps])
    assert base.steps == 0
    sound = np.ones(500, bool)
    sound[100::7] = False
    assert t[sound] == pytest.approx(stamps[sound] - 1.6e9)


def test_a_clock_that_goes_back_and_returns_leaves_no_hole():
    base = TimeBase()
    for stamp in (1000.0, 1005.0, 400.0, 401.0):
        base.stream_time(stamp)
    t, gap = base.stream_time(1006.0)
    assert gap
    assert 6.0 < t <= 6.3, "a tick for each step"
    t, gap = base.stream_time(1030.0)
    assert gap
    assert 16.0 < t <= 16.4, "where no stamp has been: a hole"


def test_thirty_thousand_shuffled_stamps_take_a_tick_each_and_no_square_of_time():
    stamps = 1.6e9 + np.arange(30_000) * 0.005
    np.random.default_rng(1).shuffle(stamps)
    base = TimeBase()
    began = time.process_time()
    segments = list(base.segments(stamps))
    assert time.process_time() - began < 3.0
    assert sum(len(segment.t) for segment in segments) == len(stamps)
    new_maxima = np.count_nonzero(np.diff(np.maximum.accumulate(stamps)) > 10.0)
    assert base.now < 0.11 * base.steps + 10.0 * (new_maxima + 1) + 150.0


def test_stamps_that_leap_ahead_at_each_frame_take_a_tick_each():
    stamps = np.cumsum(np.full(30_000, 1.6e9))
    base = TimeBase()
    t = np.concatenate([segment.t for segment in base.segments(stamps)])
    assert base.steps == len(stamps) - 1
    assert base.now <= 0.1 * len(stamps) + 11.0
    assert (np.diff(t) > 0.0).all()


def test_a_second_of_frames_is_followed_by_a_whole_hole():
    base = TimeBase()
    for stamp in (0.0, 0.5, 1.0):
        base.stream_time(stamp)
    assert base.stream_time(500.0)[0] > 11.0
