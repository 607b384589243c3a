"""Stream time: steady whatever the stamps do, and the same for one stamp and for columns."""

import itertools

import numpy as np
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
