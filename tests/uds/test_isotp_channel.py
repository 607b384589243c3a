"""The transport against testers that are wrong, rude or hostile: bounded, counted, still there."""

from __future__ import annotations

import subprocess
import sys
import time
import tracemalloc

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imucald.uds.isotp_channel import FRAMES_AT_ONCE, MAX_REQUEST, IsoTpChannel
from uds_bench import Bench, Clock

REQUEST, RESPONSE, TO_ALL = 0x7B0, 0x7B8, 0x7DF
READ_SESSION = bytes.fromhex("0322F186")
SESSION = bytes.fromhex("0462F18601CCCCCC")
READ_LONG = bytes.fromhex("0322FD06")
"""Its response has 35 bytes: a first frame and five more."""
CONTINUE = bytes.fromhex("300000")
OVERFLOW = bytes.fromhex("320800CCCCCCCCCC")


class Wire:
    """A channel with a diagnostic server behind it."""

    def __init__(self) -> None:
        self.bench = Bench()
        self.clock = self.bench.clock
        self.channel = IsoTpChannel(REQUEST, RESPONSE, TO_ALL, self.bench.server.handle, self.clock)

    def send(self, *frames: bytes, to: int = REQUEST) -> list[bytes]:
        out = []
        for frame in frames:
            out += self.channel.frame(to, frame)
            self.clock.now += 0.002
        assert all(can_id == RESPONSE for can_id, _ in out)
        return [data for _, data in out]

    def rest(self, seconds: float = 0.2) -> list[bytes]:
        """What comes when it is polled for so long, in real time."""
        out, end = [], time.monotonic() + seconds
        while time.monotonic() < end:
            out += [data for _, data in self.channel.poll()]
            time.sleep(0.002)
        return out

    def counted(self, name: str) -> int:
        return self.channel.counters[name]

    def lives(self) -> None:
        """It answers a plain request."""
        self.clock.now += 1.0
        assert SESSION in [*self.send(READ_SESSION), *self.rest(0.1)]


@pytest.fixture
def wire() -> Wire:
    return Wire()


def first(length: int, data: bytes = b"\x22\xf1\x86\xf1\x86\xf1") -> bytes:
    return bytes([0x10 | length >> 8, length & 0xFF]) + data


def more(number: int, data: bytes = b"\x86" + bytes(6)) -> bytes:
    return bytes([0x20 | number & 0xF]) + data


def test_a_request_in_pieces_and_a_response_in_pieces(wire):
    (go_on,) = wire.send(first(7))
    assert go_on[0] == 0x30
    (head,) = wire.send(more(1))
    assert head == bytes.fromhex("100A62F18601F186")
    assert wire.send(CONTINUE) == [bytes.fromhex("2101F18601CCCCCC")]
    assert wire.channel.wait == float("inf")


def test_the_pause_a_receiver_asks_for_is_kept(wire):
    wire.send(READ_LONG)
    assert len(wire.send(bytes.fromhex("30000A"))) <= 1
    assert wire.channel.wait < 0.01, "the loop is asked to come back soon"
    began, count = time.monotonic(), 0
    while count < 4 and time.monotonic() < began + 3:
        count += len(wire.rest(0.005))
    assert time.monotonic() - began > 0.03


def test_a_wrong_sequence_number_ends_the_request(wire):
    wire.send(first(20))
    assert wire.send(more(2), more(3), more(1)) == []
    assert wire.counted("WrongSequenceNumberError") == 1
    assert wire.counted("UnexpectedConsecutiveFrameError") == 2
    assert wire.bench.server.counters.requests == 0
    wire.lives()


@pytest.mark.parametrize("length", [MAX_REQUEST + 1, 0xFFF])
def test_a_request_that_is_too_long_is_reported_so(wire, length):
    assert wire.send(first(length)) == [OVERFLOW]
    assert wire.send(*(more(i) for i in range(1, 40))) == []
    assert wire.counted("FrameTooLongError") == 1
    assert wire.bench.server.counters.requests == 0
    wire.lives()


def test_four_gigabytes_are_not_reserved(wire):
    tracemalloc.start()
    assert wire.send(bytes.fromhex("1000FFFFFFFF2222")) == [OVERFLOW]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200_000
    wire.lives()


@pytest.mark.slow
def test_begun_and_never_ended_requests_are_forgotten(wire):
    for _ in range(50):
        assert wire.send(first(100))[0][0] == 0x30
    assert wire.counted("ReceptionInterruptedWithFirstFrameError") == 49
    wire.send(READ_SESSION)
    assert wire.counted("ReceptionInterruptedWithSingleFrameError") == 1
    wire.send(first(100))
    wire.rest(1.2)
    assert wire.counted("ConsecutiveFrameTimeoutError") == 1
    wire.lives()


def test_a_flood_of_flow_control_does_nothing(wire):
    for status in range(16):
        for _ in range(40):
            assert wire.send(bytes([0x30 | status, 0, 0])) == []
        wire.clock.now += 1.0
    assert wire.counted("UnexpectedFlowControlError") == 40 * 2  # go on, wait
    assert wire.counted("InvalidCanDataError") == 40 * 13
    wire.lives()


def test_flow_control_does_not_multiply_a_response(wire):
    out = wire.send(READ_LONG)
    for _ in range(100):
        out += wire.send(CONTINUE, bytes.fromhex("300100"), bytes.fromhex("300000"))
        wire.clock.now += 1.0
    out += wire.rest(0.3)
    assert len(out) == 6
    assert [f[0] for f in out] == [0x10, 0x21, 0x22, 0x23, 0x24, 0x25]


@pytest.mark.slow
def test_a_receiver_that_says_wait_for_ever_is_given_up(wire):
    wire.send(READ_LONG)
    for _ in range(20):
        assert wire.send(bytes.fromhex("310000")) == []
    assert wire.channel.wait < 1.0
    wire.rest(1.3)
    assert wire.counted("FlowControlTimeoutError") == 1
    assert wire.channel.wait == float("inf")
    wire.lives()


def test_a_receiver_that_takes_frame_by_frame_has_ten_seconds(wire):
    wire.send(READ_LONG)
    assert len(wire.send(bytes.fromhex("300100"))) == 1
    wire.clock.now += 10.1
    wire.rest(0.01)
    assert wire.counted("response_given_up") == 1
    assert wire.send(CONTINUE) == []
    wire.lives()


def test_a_new_request_overtakes_a_response_that_waits(wire):
    wire.send(READ_LONG)
    assert wire.send(READ_SESSION) == [SESSION]
    assert wire.send(CONTINUE) == [], "the former is gone"
    assert wire.counted("response_given_up") == 1


def test_tester_present_to_all_disturbs_no_response(wire):
    wire.send(READ_LONG)
    assert wire.send(bytes.fromhex("023E80"), to=TO_ALL) == []
    assert wire.send(bytes.fromhex("023E00"), to=TO_ALL) == []
    assert wire.counted("functional_response_dropped") == 1
    assert len(wire.send(CONTINUE)) == 5


@pytest.mark.parametrize(
    "frame",
    ["", "00", "08", "0322F1", "1007", "10073E00", "2101", "30", "FFFFFFFFFFFFFFFF", "073E00"],
)
def test_requests_to_all_that_are_none_are_counted(wire, frame):
    assert wire.send(bytes.fromhex(frame), to=TO_ALL) == []
    assert wire.counted("not_a_functional_request") == 1


def test_a_flood_is_looked_at_in_part_and_costs_little(wire):
    """A second of a bus that is full of requests which are refused."""
    frames, out = 8000, []
    bad = bytes.fromhex("0227010000000000")
    began = time.process_time()
    for _ in range(frames):
        out += wire.channel.frame(REQUEST, bad)
        out += wire.channel.poll()
        wire.clock.now += 1 / frames
    cost = time.process_time() - began
    looked_at = wire.counted("frames")
    assert looked_at == pytest.approx(500 + FRAMES_AT_ONCE, abs=3)
    assert wire.counted("dropped") == frames - looked_at
    assert 16 <= len(out) <= looked_at
    assert {data for _, data in out} == {bytes.fromhex("037F277FCCCCCCCC")}
    assert cost < 0.5, "of one core, at the pace of a full bus"
    wire.lives()


@pytest.mark.slow
def test_hours_of_nonsense_leave_nothing_behind(wire):
    def nonsense() -> None:
        for i in range(1500):
            for frame in (first(100), more(1), more(3), CONTINUE, READ_LONG, b"", bytes([i & 255])):
                wire.channel.frame(REQUEST, frame)
            wire.channel.frame(TO_ALL, READ_LONG)
            wire.channel.poll()
            wire.clock.now += 0.02

    nonsense()
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    nonsense()
    grown = tracemalloc.get_traced_memory()[0] - before
    tracemalloc.stop()
    assert grown < 20_000
    assert len(wire.channel.counters) < 30
    wire.lives()


FRAMES = st.one_of(
    st.binary(max_size=8),
    st.binary(max_size=64),
    st.sampled_from([READ_LONG, READ_SESSION, CONTINUE, first(100), first(20), more(1), more(2)]),
)


@settings(max_examples=200, deadline=None)
@given(
    frames=st.lists(
        st.tuples(FRAMES, st.sampled_from([REQUEST, TO_ALL]), st.floats(0.0, 0.1)), max_size=60
    )
)
def test_any_frames_at_all(frames):
    wire = Wire()
    for frame, to, pause in frames:
        out = wire.channel.frame(to, frame) + wire.channel.poll()
        assert len(out) <= 16 + 1
        assert all(can_id == RESPONSE and len(data) == 8 for can_id, data in out)
        wire.clock.now += pause
    assert wire.counted("transport_failed") == 0, "the package took it all"
    assert wire.bench.host.done == []


def test_what_the_package_may_throw_does_not_end_us(wire, monkeypatch):
    def explode(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    wire.send(first(100))
    with monkeypatch.context() as broken:
        broken.setattr(wire.channel._stack, "_process_rx", explode)
        assert wire.send(more(1)) == []
        assert wire.counted("transport_failed") == 1
    wire.send(more(1))
    assert wire.counted("UnexpectedConsecutiveFrameError") == 1, "what was begun is forgotten"
    wire.lives()


def test_the_clock_of_a_channel_is_its_own():
    clock = Clock()
    channel = IsoTpChannel(0x18DA55F1, 0x18DAF155, None, lambda request, _: request, clock)
    assert channel.ids == {0x18DA55F1 | 0x8000_0000}
    assert channel.frame(0x18DA55F1 | 0x8000_0000, b"\x01\x3e") == [
        (0x18DAF155 | 0x8000_0000, b"\x01\x3e" + b"\xcc" * 6)
    ]


def test_python_can_is_not_loaded_for_it():
    code = (
        "import sys; from imucald.uds.isotp_channel import import_isotp; import_isotp();"
        "print(*(name in sys.modules for name in ('isotp', 'can')));"
        "from imucald.can.python_can import can;"
        "print(can.Message(arbitration_id=5).arbitration_id)"
    )
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert (process.stderr, process.stdout) == ("", "True False\n5\n")
