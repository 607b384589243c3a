"""The diagnostics of a running service, asked by udsoncan over a virtual bus."""

from __future__ import annotations

import json
import re
import time
from collections.abc import Iterator

import pytest
from udsoncan.client import Client
from udsoncan.exceptions import NegativeResponseException, TimeoutException

from imucald import __version__
from imucald.mount.estimate import MountState
from imucald.service.uds_host import configuration_identity
from uds_bus import IDENTIFIERS, RESPONSE, TO_ALL, UdsBench, asking, with_diagnostics

pytestmark = pytest.mark.slow

VIN = b"WVWZZZ1JZXW000001"
CALIBRATE, RESET = 0xF010, 0xF011
NOT_CORRECT, DENIED, SEQUENCE = 0x22, 0x33, 0x24
STANDING_S = 1.5
"""The drive begins with three seconds of standing."""
DRIVING_S = 5.0
DONE_S = 30.0


@pytest.fixture
def bench(tmp_path) -> Iterator[UdsBench]:
    with UdsBench(tmp_path, with_diagnostics(tmp_path)) as made:
        yield made


@pytest.fixture
def client(bench) -> Iterator[Client]:
    with asking(bench.tester_bus) as made:
        yield made


def refused(code: int):
    return pytest.raises(NegativeResponseException, match=f"0x{code:x}")


def read(client: Client, number: int):
    return client.read_data_by_identifier_first(number)


def unlocked(client: Client) -> Client:
    client.change_session(3)
    client.unlock_security_access(1)
    return client


def codes(client: Client, mask: int = 0x08) -> dict[int, int]:
    response = client.get_dtc_by_status_mask(mask)
    return {d.id: d.status.get_byte_as_int() for d in response.service_data.dtcs}


def test_a_tester_reads_what_the_daemon_knows(bench, client):
    bench.play(DONE_S)
    assert read(client, 0xF195) == __version__
    numbers = sorted(set(IDENTIFIERS) - {0xF195})
    values = client.read_data_by_identifier(numbers).service_data.values  # some forty frames
    engine = bench.service.engine
    assert values[0xF190] == (VIN,)
    assert values[0xFD06] == (configuration_identity(bench.service.loaded),)
    assert values[0xFD03] == (int(engine.pipeline.estimator.state),)
    assert values[0xFD04] == (engine.pipeline.quality,)
    assert engine.pipeline.quality in (2, 3)
    _, _, yaw = values[0xFD00]
    assert yaw / 100 == pytest.approx(25.0, abs=3.0), "as the drive was made"
    assert values[0xFD01][2] * 0.005 < 2.0
    received, used, rejected, lost, conflicts, sent = values[0xFD08]
    assert received >= used == engine.router.used > 5000
    assert (rejected, lost, conflicts) == (0, 0, 0)
    assert sent > 5000
    assert values[0xFD0C][2] >= 1, "requests"


def test_without_the_key_nothing_can_be_started(bench, client):
    bench.play(STANDING_S)
    with refused(0x7F):
        client.start_routine(RESET)
    client.change_session(3)
    before = bench.service.engine.pipeline.estimator
    for routine in (CALIBRATE, RESET):
        with refused(DENIED):
            client.start_routine(routine)
        with refused(DENIED):
            client.stop_routine(routine)
    assert bench.service.engine.pipeline.estimator is before


def test_wrong_keys_are_refused_and_the_right_one_has_to_wait(bench):
    with asking(bench.tester_bus, security_algo=lambda **_: b"guess") as client:
        client.change_session(3)
        for code in (0x35, 0x35, 0x36, 0x37):
            with refused(code):
                client.unlock_security_access(1)
        time.sleep(1.1)
    with asking(bench.tester_bus) as client:
        unlocked(client)
        assert read(client, 0xFD0B)[2] == 4
    assert "keys of testers were refused" in bench.log.getvalue()


def test_a_moving_vehicle_or_one_whose_speed_is_not_known_is_not_reset(bench, client):
    unlocked(client)
    with refused(NOT_CORRECT):
        client.start_routine(RESET)  # nothing was heard yet
    bench.play(STANDING_S)
    client.start_routine(RESET)
    bench.play(DRIVING_S)
    before = bench.service.engine.pipeline.estimator
    with refused(NOT_CORRECT):
        client.start_routine(RESET)
    with refused(NOT_CORRECT):
        client.start_routine(CALIBRATE)
    assert bench.service.engine.pipeline.estimator is before


def test_speed_that_is_long_ago_is_not_known(bench, client):
    bench.play(STANDING_S)
    host = bench.service.parts.diagnostics.uds.host
    assert host.standing
    unlocked(client)
    bench.wait_for(lambda: host.standing is None)  # the clock goes on without frames
    with refused(NOT_CORRECT):
        client.start_routine(RESET)


def test_a_calibration_is_begun_driven_and_reported(bench, client):
    bench.play(STANDING_S)
    unlocked(client)
    answer = client.start_routine(CALIBRATE).service_data.routine_status_record
    assert answer == b"\x01"
    with refused(SEQUENCE):
        client.start_routine(CALIBRATE)
    result = client.get_routine_result(CALIBRATE).service_data.routine_status_record
    assert result[:3] == bytes([1, MountState.WAITING, 0])
    bench.play(DONE_S)
    client.change_session(3)
    result = client.get_routine_result(CALIBRATE).service_data.routine_status_record
    assert result[0] == 2, "completed"
    assert result[2] in (2, 3)
    assert int.from_bytes(result[10:12], "big") / 100 == pytest.approx(25.0, abs=3.0)


def test_a_stopped_calibration_takes_the_former_back_byte_for_byte(bench, client):
    bench.play(27.0)  # standing between two launches
    bench.play(27.5)
    angles = read(client, 0xFD00)
    assert angles[2] != -0x8000
    bench.wait_for(lambda: bench.service.engine.pipeline.speed[1] == 0.0)
    unlocked(client)
    client.start_routine(CALIBRATE)
    assert read(client, 0xFD00) == (-0x8000,) * 3
    assert client.stop_routine(CALIBRATE).service_data.routine_status_record == b"\x03"
    assert read(client, 0xFD00) == angles


def test_a_reset_forgets_the_saved_state_too(bench, client):
    bench.play(27.5)
    store = bench.service.parts.calibration_store.store
    bench.wait_for(lambda: store.load().content is not None)
    unlocked(client)
    client.start_routine(RESET)
    assert read(client, 0xFD04) == (0,)
    assert store.load().content is None


def test_codes_follow_the_inputs_and_can_be_cleared(bench, client):
    memory = bench.service.parts.diagnostics.uds.server.dtcs
    inputs = {0x5A1287, 0x5A1387, 0x5A1487}

    def failing() -> set[int]:
        return {dtc.number for dtc, record in memory if record.status & 0x01}

    bench.wait_for(lambda: inputs <= failing())
    assert codes(client) == dict.fromkeys(inputs, 0x2F), "all is missing"
    bench.play(STANDING_S)
    bench.wait_for(lambda: not inputs & failing())
    assert codes(client) == dict.fromkeys(inputs, 0x2E), "no longer, but so it was"
    client.clear_dtc()
    bench.play(STANDING_S + 0.5)
    assert not codes(client)
    bench.wait_for(lambda: 0x5A1054 in failing())
    assert codes(client, 0x04)[0x5A1054] == 0x27, "not calibrated yet"


def test_a_session_that_is_kept_alive_stays_and_requests_to_all_are_heard(bench, client):
    client.change_session(3)
    with client.suppress_positive_response():
        client.tester_present()
    assert read(client, 0xF186) == (3,)
    bench.send(TO_ALL, bytes.fromhex("023E00CCCCCCCCCC"))
    found = [m for m in iter(lambda: bench.bus.recv(1.0), None) if m.arbitration_id == RESPONSE]
    assert found[-1].data == bytes.fromhex("027E00CCCCCCCCCC")


def test_however_often_it_is_asked_the_estimate_is_worked_out_once_a_tick(bench, client):
    bench.play(STANDING_S)
    pipeline = bench.service.engine.pipeline
    calls = []
    worked_out = pipeline.estimator.estimate
    pipeline.estimator.estimate = lambda: (calls.append(pipeline.k), worked_out())[1]
    for _ in range(20):
        client.read_data_by_identifier([0xFD00, 0xFD01, 0xFD03, 0xFD05])
    assert len(calls) <= 3 * len(set(calls)), "status frames and the log ask for it too"


def test_what_a_tester_did_is_in_the_log_and_the_status(bench, client):
    bench.play(STANDING_S)
    unlocked(client)
    client.start_routine(CALIBRATE)
    client.stop_routine(CALIBRATE)
    client.start_routine(RESET)
    journal = bench.log.getvalue()
    for text in (
        "the calibration is started again",
        "the former calibration is in use again",
        "the learnt mount is forgotten",
    ):
        assert re.search(rf"{text}.*\(by a tester on the bus\)", journal), text
    diagnostics = bench.service.status()["diagnostics"]
    assert (diagnostics["session"], diagnostics["unlocked"], diagnostics["refused"]) == (
        "extended",
        True,
        0,
    )
    assert diagnostics["requests"] == 6
    assert diagnostics["transport"]["frames"] > 6
    assert diagnostics["trouble_codes"]["C1A10-54"] == "27"
    json.dumps(diagnostics)


def test_off_it_is_not_there(tmp_path):
    config = with_diagnostics(tmp_path)
    config.write_text(config.read_text().replace("enabled: true", "enabled: false"))
    with UdsBench(tmp_path, config) as bench, asking(bench.tester_bus, request_timeout=0.5) as ask:
        assert bench.service.parts.diagnostics.uds is None
        assert bench.service.status()["diagnostics"] is None
        with pytest.raises(TimeoutException):
            ask.tester_present()


def test_29_bit_identifiers(tmp_path):
    config = with_diagnostics(tmp_path)
    text = config.read_text().replace("0x7b0", "0x18DA55F1").replace("0x7b8", "0x18DAF155")
    config.write_text(text)
    with UdsBench(tmp_path, config) as bench, asking(bench.tester_bus, extended_ids=True) as ask:
        assert read(ask, 0xF190) == (VIN,)


def test_a_reload_changes_the_identifiers_and_keeps_the_rest(tmp_path):
    config = with_diagnostics(tmp_path)
    with UdsBench(tmp_path, config) as bench:
        text = config.read_text().replace("0x7b0", "0x18DA55F1").replace("0x7b8", "0x18DAF155")
        config.write_text(text)
        bench.service.ask_reload()
        bench.wait_for(lambda: "was read again" in bench.log.getvalue())
        with asking(bench.tester_bus, extended_ids=True) as ask:
            assert read(ask, 0xF190) == (VIN,)
        config.write_text(text.replace("enabled: true", "enabled: false"))
        bench.service.ask_reload()
        bench.wait_for(lambda: bench.service.parts.diagnostics.uds is None)


@pytest.mark.parametrize(
    ("old", "new", "fits"),
    [
        ("status_rate: 10", "status_rate: 5", True),
        ("accelerometer_bias: 0.02", "accelerometer_bias: 0.03", False),
    ],
)
def test_after_a_reload_the_former_is_taken_back_only_where_it_still_fits(
    bench, client, old, new, fits
):
    bench.play(STANDING_S)
    unlocked(client)
    former = bench.service.engine.pipeline.estimator
    client.start_routine(CALIBRATE)
    config = bench.service.options.config
    config.write_text(config.read_text().replace(old, new))
    bench.service.ask_reload()
    bench.wait_for(lambda: "was read again" in bench.log.getvalue())
    bench.play(2 * STANDING_S)
    if fits:
        client.stop_routine(CALIBRATE)
    else:
        with refused(NOT_CORRECT):
            client.stop_routine(CALIBRATE)
    assert (bench.service.engine.pipeline.estimator is former) == fits
