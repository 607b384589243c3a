"""Any bytes to the server: a well-formed response or silence, never a crash, never a key."""

from __future__ import annotations

from hypothesis import given, settings
from hypothesis import strategies as st

from imucald.uds.codes import Nrc, Sid
from imucald.uds.host import FrameCounts, Symptoms
from imucald.uds.identifiers import MAX_RESPONSE
from uds_bench import Bench

LIKELY = st.one_of(
    st.binary(max_size=140),
    st.builds(
        lambda sid, rest: bytes([sid]) + rest,
        st.sampled_from([int(s) for s in Sid]),
        st.binary(max_size=8),
    ),
    st.sampled_from(
        [bytes.fromhex(t) for t in ("1003", "1001", "2701", "2702AA", "3101F010", "3103F010")]
    ),
)


@settings(max_examples=400, deadline=None)
@given(
    requests=st.lists(st.tuples(LIKELY, st.booleans(), st.floats(0.0, 3.0)), max_size=30),
    standing=st.sampled_from([True, False, None]),
)
def test_any_requests_are_answered_or_not_but_never_obeyed_without_the_key(requests, standing):
    bench = Bench()
    bench.host.standing = standing
    for request, to_all, pause in requests:
        bench.clock.now += pause
        response = bench.server.handle(request, to_all)
        if response is None:
            continue
        assert len(response) <= MAX_RESPONSE
        if response[0] == 0x7F:
            assert response[1] == request[0]
            assert response[2] in set(Nrc)
            assert len(response) == 3
        else:
            assert response[0] == request[0] + 0x40
        facts = {"usable": True, "moved": False, "missing": {}, "counts": FrameCounts()}
        bench.server.dtcs.update(bench.clock.now, Symptoms(**facts))
    assert bench.host.done == [], "nothing was begun, stopped or forgotten"
    assert not bench.server.security.unlocked


@settings(max_examples=150, deadline=None)
@given(requests=st.lists(LIKELY, max_size=20))
def test_even_unlocked_the_calibration_is_touched_only_by_the_two_routines(requests):
    bench = Bench()
    bench.unlock()
    begun = 0
    for request in requests:
        bench.server.handle(request)
        known = len(request) == 4 and request[0] == 0x31 and request[1] & 0x7F in (1, 2)
        begun += known and request[2:] in (b"\xf0\x10", b"\xf0\x11")
    assert len(bench.host.done) <= begun
