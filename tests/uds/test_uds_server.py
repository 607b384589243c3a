"""The diagnostic server, request by request: positive answers, and each refusal by its code.

Expected bytes are written out from ISO 14229-1, not made by the code.
"""

from __future__ import annotations

import math
import struct

import pytest

from imucald.mount.estimate import MountEstimate, MountState
from imucald.uds.host import Identity
from uds_bench import ANGLES_DEG, Bench, estimate_of, key_of


@pytest.fixture
def bench() -> Bench:
    return Bench()


# sessions ----------------------------------------------------------------------------------------


def test_sessions_are_entered_and_reported(bench):
    assert bench.ask("22 F1 86") == "62 F1 86 01"
    assert bench.ask("10 03") == "50 03 00 32 01 F4"
    assert bench.ask("22 F1 86") == "62 F1 86 03"
    assert bench.ask("10 01") == "50 01 00 32 01 F4"


def test_a_positive_answer_can_be_declined(bench):
    assert bench.ask("10 83") is None
    assert bench.ask("22 F1 86") == "62 F1 86 03"
    assert bench.ask("3E 80") is None
    assert bench.ask("3E 00") == "7E 00"
    assert bench.ask("3E 81") == "7F 3E 12", "a refusal is told all the same"


def test_a_session_ends_when_nothing_is_asked(bench):
    bench.ask("10 03")
    for _ in range(3):
        bench.clock.now += 4.9
        assert bench.ask("3E 80") is None
    assert bench.ask("22 F1 86") == "62 F1 86 03"
    bench.clock.now += 5.1
    assert bench.ask("22 F1 86") == "62 F1 86 01"
    assert bench.server.counters.ended_sessions == 1


def test_programming_is_not_to_be_had(bench):
    assert bench.ask("10 02") == "7F 10 12"


# refusals ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("11 01", "7F 11 11"),  # service not supported
        ("2E F1 90 00", "7F 2E 11"),
        ("01 0D", "7F 01 11"),  # a question of OBD-II
        ("10", "7F 10 13"),  # too short
        ("10 03 00", "7F 10 13"),  # too long
        ("3E", "7F 3E 13"),
        ("3E 00 00", "7F 3E 13"),
        ("22", "7F 22 13"),
        ("22 F1", "7F 22 13"),
        ("22 F1 86 F1", "7F 22 13"),
        ("22 12 34", "7F 22 31"),
        ("14 FF FF", "7F 14 13"),
        ("14 FF FF FF 00", "7F 14 13"),
        ("14 12 34 56", "7F 14 31"),
        ("19", "7F 19 13"),
        ("19 02", "7F 19 13"),
        ("19 02 FF 00", "7F 19 13"),
        ("19 03", "7F 19 12"),
        ("19 0A 00", "7F 19 13"),
        ("19 06 5A 10 54", "7F 19 13"),
        ("19 06 5A 10 55 FF", "7F 19 31"),
        ("19 06 5A 10 54 03", "7F 19 31"),
        ("27 01", "7F 27 7F"),  # not in the default session
        ("31 01 F0 10", "7F 31 7F"),
    ],
)
def test_what_is_refused_in_the_default_session(bench, request_, answer):
    assert bench.ask(request_) == answer
    assert bench.server.counters.refused == 1


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("27", "7F 27 13"),
        ("27 03", "7F 27 12"),
        ("27 01 00", "7F 27 13"),
        ("27 02", "7F 27 13"),
        ("27 02 11", "7F 27 24"),  # a key for no seed
        ("31 01", "7F 31 13"),
        ("31 04 F0 10", "7F 31 12"),
        ("31 01 F0 13", "7F 31 31"),
        ("31 01 F0 10", "7F 31 33"),  # locked
        ("31 02 F0 10", "7F 31 33"),
        ("31 01 F0 11", "7F 31 33"),
        ("31 81 F0 11", "7F 31 33"),
        ("31 03 F0 10", "7F 31 24"),  # no results of what was never started
    ],
)
def test_what_is_refused_in_the_extended_session(bench, request_, answer):
    bench.ask("10 03")
    assert bench.ask(request_) == answer
    assert bench.host.done == []


@pytest.mark.parametrize("request_", ["", "7F 22 31", "62 F1 86 01", "C1", "FF FF FF"])
def test_responses_of_others_are_not_answered(bench, request_):
    assert bench.ask(request_) is None
    assert bench.server.counters.requests == 0


def test_requests_to_all_are_answered_only_with_what_concerns_the_asker(bench):
    assert bench.ask("3E 00", to_all=True) == "7E 00"
    assert bench.ask("22 F1 86", to_all=True) == "62 F1 86 01"
    for request in ("01 0D", "10 02", "22 12 34", "27 01", "14 12 34 56"):
        assert bench.ask(request, to_all=True) is None
    assert bench.ask("22 F1", to_all=True) == "7F 22 13"
    assert bench.server.counters.refused == 6


# reading data ------------------------------------------------------------------------------------


def test_angles_and_deviations_in_their_units(bench):
    assert (
        bench.ask("22 FD 00")
        == "62 FD 00 " + struct.pack(">3h", *(round(100 * a) for a in ANGLES_DEG)).hex(" ").upper()
    )
    assert bench.ask("22 FD 01") == "62 FD 01 00 14 00 28 00 50"


def test_angles_are_not_reported_while_no_correction_is_in_force(bench):
    bench.host.quality = 0
    assert bench.ask("22 FD 00") == "62 FD 00 80 00 80 00 80 00"
    answer = bench.server.handle(bytes.fromhex("22 FD 02"))
    assert all(math.isnan(q) for q in struct.unpack(">4f", answer[3:]))
    assert bench.ask("22 FD 01") == "62 FD 01 00 14 00 28 00 50", "how far it is, is told"
    bench.host.known = MountEstimate(MountState.WAITING)
    assert bench.ask("22 FD 01") == "62 FD 01 FF FF FF FF FF FF"


def test_the_quaternion_turns_as_the_angles_do(bench):
    answer = bench.server.handle(bytes.fromhex("22 FD 02"))
    w, x, y, z = struct.unpack(">4f", answer[3:])
    yaw = math.degrees(math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    pitch = math.degrees(math.asin(2 * (w * y - z * x)))
    assert (yaw, pitch) == pytest.approx((ANGLES_DEG[2], ANGLES_DEG[1]), abs=1e-3)


def test_state_quality_and_what_is_waited_for(bench):
    assert bench.ask("22 FD 03") == "62 FD 03 03"
    assert bench.ask("22 FD 04") == "62 FD 04 03"
    assert bench.ask("22 FD 05") == "62 FD 05 00 00 00"
    bench.host.known = estimate_of(MountState.LEVELLED)
    assert bench.ask("22 FD 03") == "62 FD 03 01"
    assert bench.ask("22 FD 05") == "62 FD 05 00 00 03", "yaw waits for a left turn"


def test_who_it_is(bench):
    assert bench.ask("22 F1 95") == "62 F1 95 31 2E 32 2E 33"
    assert bench.ask("22 F1 8A") == "62 F1 8A " + b"imucald".hex(" ").upper()
    vin = b"WVWZZZ1JZXW000001".hex(" ").upper()
    assert bench.ask("22 F1 90") == f"62 F1 90 {vin}"
    assert bench.ask("22 FD 07") == f"62 FD 07 {vin}"
    assert bench.ask("22 FD 06") == "62 FD 06 " + bytes(range(32)).hex(" ").upper()
    bench.host.identity = Identity("1", "my car", bytes(32))
    assert bench.ask("22 F1 90") == "7F 22 31", "that is no VIN"
    assert bench.ask("22 FD 07") == "62 FD 07 " + b"my car".hex(" ").upper()


def test_counters(bench):
    assert (
        bench.ask("22 FD 08")
        == "62 FD 08 " + struct.pack(">6I", 10, 9, 7, 6, 5, 8).hex(" ").upper()
    )
    faults = struct.pack(">12I", 0, 3, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0).hex(" ").upper()
    assert bench.ask("22 FD 09") == f"62 FD 09 {faults}"
    assert bench.ask("22 FD 0A") == "62 FD 0A 00 00 00 0C"
    bench.host.uptime = 2.0**40
    assert bench.ask("22 FD 0A") == "62 FD 0A FF FF FF FF", "no more than fits"
    assert bench.ask("11 01") == "7F 11 11"
    assert bench.ask("22 FD 0B") == "62 FD 0B " + struct.pack(">4I", 6, 1, 0, 0).hex(" ").upper()


def test_several_identifiers_at_once(bench):
    assert bench.ask("22 FD 04 12 34 FD 03") == "62 FD 04 03 FD 03 03", "the unknown is left out"
    assert bench.ask("22" + " FD 04" * 17) == "7F 22 13"
    assert bench.ask("22" + " FD 07" * 16) is not None
    bench.host.identity = Identity("1", "x" * 64, bytes(32))
    assert bench.ask("22" + " FD 07" * 16) == "7F 22 14", "longer than a response may be"


# security ----------------------------------------------------------------------------------------


def test_the_right_key_unlocks_until_the_session_changes(bench):
    bench.unlock()
    assert bench.ask("31 01 F0 11") == "71 01 F0 11 02"
    seed = bench.ask("27 01")
    assert seed == "67 01" + " 00" * 16, "nothing to unlock"
    bench.ask("10 03")
    assert bench.ask("31 01 F0 11") == "7F 31 33"
    bench.unlock()
    bench.clock.now += 5.1
    assert bench.ask("10 03") is not None
    assert bench.ask("31 01 F0 11") == "7F 31 33"


def test_seeds_differ_and_serve_once(bench):
    bench.ask("10 03")
    first, second = (bench.server.handle(b"\x27\x01")[2:] for _ in range(2))
    assert first != second
    assert bench.server.handle(b"\x27\x02" + key_of(first)) == b"\x7f\x27\x35", "the newest counts"
    assert bench.server.handle(b"\x27\x02" + key_of(second)) == b"\x7f\x27\x24", "and once only"


def test_wrong_keys_cost_time_over_all_sessions(bench):
    def try_wrong() -> str | None:
        bench.ask("10 03")
        bench.ask("27 01")
        return bench.ask("27 02 00")

    assert [try_wrong() for _ in range(3)] == ["7F 27 35", "7F 27 35", "7F 27 36"]
    for _ in range(3):
        bench.clock.now += 3.0
        bench.ask("10 01")
        bench.ask("10 03")
        assert bench.ask("27 01") == "7F 27 37"
        assert bench.ask("27 02 00") == "7F 27 37"
    bench.clock.now += 1.1
    assert try_wrong() == "7F 27 36", "one attempt, then closed again"
    bench.clock.now += 10.1
    bench.unlock()
    assert bench.server.security.refused == 10


def test_the_right_key_forgives_the_wrong_ones_before_it(bench):
    for _ in range(2):
        bench.ask("10 03")
        for _ in range(2):
            bench.ask("27 01")
            assert bench.ask("27 02 00") == "7F 27 35"
        bench.unlock()


def test_the_time_between_attempts_bounds_a_search(bench):
    """An hour of trying as fast as it goes gives a few hundred keys to guess among 2^128."""
    tried = 0
    bench.ask("10 03")
    for _ in range(3600):
        bench.clock.now += 1.0
        if bench.ask("27 01")[:5] == "67 01":
            tried += 1
            bench.ask("27 02 00 01 02 03")
    assert 300 <= tried <= 400
    assert not bench.server.security.unlocked


def test_without_a_key_function_nobody_is_let_in():
    bench = Bench(key_function=None)
    bench.ask("10 03")
    assert bench.ask("27 01") == "7F 27 22"
    assert bench.ask("27 02 00") == "7F 27 24"
    assert bench.ask("31 01 F0 11") == "7F 31 33"


@pytest.mark.parametrize("broken", [lambda _: 1 / 0, lambda _: b"", lambda _: None, lambda _: 1])
def test_a_broken_key_function_lets_nobody_in(broken):
    bench = Bench(key_function=broken)
    bench.ask("10 03")
    bench.ask("27 01")
    assert bench.ask("27 02 00") == "7F 27 35"
    bench.ask("27 01")
    assert bench.ask("27 02" + " 00" * 65) == "7F 27 13"


# routines ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("standing", [False, None])
@pytest.mark.parametrize("routine", ["F0 10", "F0 11"])
def test_nothing_starts_while_the_vehicle_moves_or_may_move(bench, standing, routine):
    bench.unlock()
    bench.host.standing = standing
    assert bench.ask(f"31 01 {routine}") == "7F 31 22"
    assert bench.host.done == []


def test_a_calibration_from_start_to_result(bench):
    bench.unlock()
    assert bench.ask("31 01 F0 10") == "71 01 F0 10 01"
    assert bench.ask("31 01 F0 10") == "7F 31 24", "it runs already"
    bench.host.known = estimate_of(MountState.LEVELLED)
    nothing = "80 00 80 00 80 00"
    assert bench.ask("31 03 F0 10") == f"71 03 F0 10 01 01 00 00 00 03 {nothing} 00 14 00 28 00 50"
    bench.host.known, bench.host.quality = estimate_of(), 2
    angles = "00 96 F8 17 34 BC"
    assert bench.ask("31 03 F0 10") == f"71 03 F0 10 02 03 02 00 00 00 {angles} 00 14 00 28 00 50"
    assert bench.ask("31 02 F0 10") == "7F 31 24", "it is over"
    assert bench.host.done == ["begin", "accept"]


def test_a_calibration_that_is_stopped_gives_the_former_one_back(bench):
    bench.unlock()
    bench.ask("31 01 F0 10")
    bench.host.standing = False
    assert bench.ask("31 02 F0 10") == "7F 31 22"
    bench.host.standing, bench.host.former_fits = True, False
    assert bench.ask("31 02 F0 10") == "7F 31 22"
    bench.host.former_fits = True
    assert bench.ask("31 02 F0 10") == "71 02 F0 10 03"
    assert bench.ask("31 02 F0 10") == "7F 31 24"
    assert bench.host.done == ["begin", "return"]
    assert bench.ask("31 03 F0 10")[:14] == "71 03 F0 10 03"


def test_a_restored_mount_is_no_completed_calibration(bench):
    bench.unlock()
    bench.ask("31 01 F0 10")
    bench.host.quality = 1
    assert bench.ask("31 03 F0 10")[:14] == "71 03 F0 10 01"


def test_a_suspect_mount_is_no_completed_calibration(bench):
    """The drive contradicts what is stated: the former mount is not let go for it."""
    bench.unlock()
    bench.ask("31 01 F0 10")
    bench.host.known, bench.host.quality = estimate_of(MountState.SUSPECT), 4
    bench.server.poll()
    assert bench.host.done == ["begin"]
    assert bench.ask("31 03 F0 10")[:20] == "71 03 F0 10 01 04 04"
    assert bench.ask("31 02 F0 10") == "71 02 F0 10 03", "and can be taken back"
    assert bench.host.done == ["begin", "return"]


def test_a_reset_ends_a_calibration_and_keeps_nothing(bench):
    bench.unlock()
    bench.ask("31 01 F0 10")
    assert bench.ask("31 01 F0 11") == "71 01 F0 11 02"
    assert bench.ask("31 02 F0 11") == "7F 31 24"
    assert bench.ask("31 03 F0 10")[:14] == "71 03 F0 10 03"
    assert bench.ask("31 81 F0 11") is None, "done, and not told"
    assert bench.host.done == ["begin", "forget", "forget"]
    assert bench.ask("31 01 F0 11 00") == "7F 31 13"


def test_a_running_calibration_outlives_the_session(bench):
    bench.unlock()
    bench.ask("31 01 F0 10")
    bench.clock.now += 600.0
    bench.host.quality = 3
    bench.server.poll()
    assert bench.host.done == ["begin", "accept"]
    bench.ask("10 03")
    assert bench.ask("31 03 F0 10")[:14] == "71 03 F0 10 02", "results need no key"


def test_the_sensor_check_is_repeated_by_a_routine() -> None:
    bench = Bench()
    assert bench.ask("31 01 F0 12") == "7F 31 7F"  # not in the default session
    bench.ask("10 03")
    assert bench.ask("31 01 F0 12") == "7F 31 33"
    bench.unlock()
    bench.host.standing = False
    assert bench.ask("31 01 F0 12") == "7F 31 22"
    bench.host.standing = True
    assert bench.ask("31 01 F0 12") == "71 01 F0 12 01"
    assert bench.host.done == ["check"]
    assert bench.ask("31 01 F0 12") == "7F 31 24"  # it runs
    assert bench.ask("31 02 F0 12") == "7F 31 22"  # and cannot be taken back
    bench.host.sensors_checked = True
    answer = bench.ask("31 03 F0 12")
    assert answer is not None
    assert answer.startswith("71 03 F0 12 02")
    assert "begin" not in bench.host.done


def test_without_attitude_there_are_no_sensors_to_check() -> None:
    bench = Bench()
    bench.unlock()
    bench.host.has_check = False
    assert bench.ask("31 01 F0 12") == "7F 31 22"
    assert bench.ask("31 03 F0 12") == "7F 31 24"
