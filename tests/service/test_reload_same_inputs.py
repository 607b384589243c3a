"""A reload keeps what is known of inputs that stay: faults, counters, which of them come."""

from __future__ import annotations

import itertools
import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from imucald.can.dbc.decode import compile_decode
from imucald.can.logs.log_reader import LogReader
from imucald.mount.estimator import JointEstimator
from imucald.mount.mount_in_force import without_stored
from imucald.runtime.output.output_frames import output_database
from imucald.service.journal import Journal
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service
from service_bench import Bench

Frame = tuple[float, int, bytes]
GYRO = 0x201
FAULT, RELOAD = 21.0, 24.0
"""Seconds of the drive: the published estimator's mount is usable from 15 s on."""
DIAGNOSTICS = "diagnostics: {enabled: true, request_id: 0x7B0, response_id: 0x7B8}\n"


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def frames_of(bench: Bench) -> list[Frame]:
    """The drive's frames, its time from 0 on."""
    found = []
    for chunk in LogReader([bench.folder / "shuttle.log"]):
        rows = (chunk.t.tolist(), chunk.can_id.tolist(), chunk.length.tolist(), chunk.data)
        found += [(t, i, b[:n].tobytes()) for t, i, n, b in zip(*rows, strict=True)]
    return [(t - found[0][0], i, data) for t, i, data in found]


def standing(begin: float, seconds: float) -> list[Frame]:
    """A vehicle that stands, with the noise of its sensors."""
    rng = np.random.default_rng(3)
    frames: list[Frame] = []
    for i in range(round(100 * seconds)):
        t = begin + 0.01 * i
        f, w = rng.normal(0, 3, 3).astype(int), rng.normal(0, 3, 3).astype(int)
        frames.append((t, 0x200, struct.pack("<3hxx", f[0], f[1], 4903 + f[2])))
        frames.append((t + 0.0005, GYRO, struct.pack("<3hxx", *w)))
        if i % 5 == 0:
            frames.append((t + 0.001, 0x202, bytes(2)))
    return frames


def with_fault(frames: Sequence[Frame], since: float, kind: str) -> list[Frame]:
    """The gyroscope keeps its value, or says deg/s where rad/s is meant."""
    out, kept = [], None
    for t, can_id, data in frames:
        if can_id == GYRO and t >= since:
            kept = kept or data
            if kind == "frozen":
                data = kept  # noqa: PLW2901
            else:
                large = [max(-24000, min(24000, 57 * x)) for x in struct.unpack("<3h", data[:6])]
                data = struct.pack("<3hxx", *large)  # noqa: PLW2901
        out.append((t, can_id, data))
    return out


def run(
    service: Service, frames: Sequence[Frame], at: float, do: Callable[[], None]
) -> list[tuple[float, int, bytes]]:
    """What is sent, with the time of the frame that it answers; `do` is done once, at a time."""
    out, is_done = [], False
    for t, can_id, data in frames:
        if t >= at and not is_done:
            is_done = True
            do()
        out += [(t, *sent) for sent in service.engine.frame(1.6e9 + t, can_id, data)]
    return out


def qualities(sent: Sequence[tuple[float, int, bytes]], can_id: int, since: float) -> set[int]:
    return {data[6] & 0xF for t, i, data in sent if i == can_id and t >= since}


def test_a_reload_of_the_same_file_changes_no_frame(bench):
    bench.edit("status_rate: 10", "status_rate: 10\n  checksum: xor\nattitude: {enabled: true}")
    frames = with_fault(frames_of(bench), FAULT, "frozen")
    quiet = bench.service()
    expected = run(quiet, frames, RELOAD, lambda: None)
    quiet.close()
    bench.folder.joinpath("state").rename(bench.folder / "other")
    reloaded = bench.service()
    before = reloaded.engine
    assert run(reloaded, frames, RELOAD, reloaded.reload) == expected
    assert reloaded.engine is not before
    assert reloaded.engine.sent == len(expected)
    reloaded.close()


@pytest.mark.parametrize("kind", ["frozen", "unit"])
@pytest.mark.parametrize(
    "edit",
    [
        ("", ""),
        ("status_rate: 10", "status_rate: 1\n  ids: {acceleration: 0x650}"),
        ("accelerometer_bias: 0.02", "accelerometer_bias: 0.03"),
        ("speed: SPEED.V", "speed: {signal: SPEED.V, range: [0, 200]}"),
        ("database:", "vehicle: {id: another}\ndatabase:"),
    ],
    ids=["same", "outputs", "estimation", "limits", "vehicle"],
)
def test_a_faulty_sensor_stays_faulty_over_a_reload(kind, edit, bench):
    service = bench.service()

    def reload() -> None:
        assert service.engine.pipeline.health.faults
        bench.edit(*edit)
        service.reload()
        assert set(service.engine.pipeline.health.faults) == {"gyro"}

    sent = run(service, with_fault(frames_of(bench), FAULT, kind), RELOAD, reload)
    assert qualities(sent, 0x641, FAULT - 1.0) - {0}, "it was good before"
    assert qualities(sent, 0x641, FAULT + 2.5) == {0}
    (event,) = [e for e in service.status()["signal_health"]["events"] if not e["until_s"]][:1]
    assert event["since_s"] < RELOAD
    service.close()


def parked(bench: Bench, fault: float, reload: float) -> tuple[list, float]:
    """What is sent of a drive, a minute of standing after it, and the time at which it begins [s].

    fault, reload: seconds of standing until the gyroscope freezes, until the file is read again.
    """
    drive = frames_of(bench)
    begin = drive[-1][0] + 0.01
    frames = drive + with_fault(standing(begin, 60.0), begin + fault, "frozen")
    service = bench.service()
    sent = run(service, frames, begin + reload, service.reload)
    service.close()
    return sent, begin


def test_a_sensor_that_is_frozen_while_the_vehicle_stands_stays_so_over_a_reload(bench):
    sent, begin = parked(bench, fault=20.0, reload=25.0)
    assert qualities(sent, 0x641, begin + 10.0) > {0}
    assert qualities(sent, 0x641, begin + 22.5) == {0}


def test_a_sensor_that_freezes_after_a_reload_is_found_as_soon_as_without(bench):
    """What is usual for a sensor is known from before."""
    sent, begin = parked(bench, fault=20.5, reload=20.0)
    assert qualities(sent, 0x641, begin + 22.5) == {0}


def test_of_another_bus_nothing_is_good_at_once_and_no_sensor_is_known(tmp_path):
    bench = Bench(tmp_path)
    bench.config.write_text(bench.config.read_text() + "bus: {interface: virtual, channel: a}\n")
    options = ServiceOptions(config=bench.config, state_folder=tmp_path / "state")
    service = Service(options, Journal(bench.log))

    def reload() -> None:
        assert service.engine.pipeline.quality > 1
        bench.edit("channel: a", "channel: b")
        service.reload()
        assert service.engine.pipeline.quality == 1
        assert not service.engine.pipeline.health.faults

    frames = with_fault(frames_of(bench), FAULT, "frozen")
    sent = run(service, [f for f in frames if f[0] < RELOAD + 2.0], RELOAD - 5.0, reload)
    assert qualities(sent, 0x640, RELOAD - 4.5) == {1}
    service.close()


def test_a_limit_of_one_signal_leaves_what_was_learnt_as_it_is(bench):
    service = bench.service()

    def reload() -> None:
        before = service.engine.pipeline.estimator
        bench.edit("speed: SPEED.V", "speed: {signal: SPEED.V, range: [0, 200]}")
        service.reload()
        assert service.engine.pipeline.estimator is before

    run(service, frames_of(bench), RELOAD, reload)
    service.close()


def other_axes(bench: Bench) -> None:
    bench.edit("z: IMU_G.GZ", "z: {signal: IMU_G.GZ, sign: -1}")


def other_factor(bench: Bench) -> None:
    database = bench.folder / "shuttle.dbc"
    text = database.read_text()
    assert "GZ : 32|16@1- (0.01" in text
    database.write_text(text.replace("GZ : 32|16@1- (0.01", "GZ : 32|16@1- (0.02"))


@pytest.mark.parametrize("change", [other_axes, other_factor])
def test_of_another_gyroscope_no_fault_is_known_and_nothing_is_good_at_once(change, bench):
    service = bench.service()

    def reload() -> None:
        assert service.engine.pipeline.quality > 1
        change(bench)
        service.reload()
        assert not service.engine.pipeline.health.faults
        assert service.engine.pipeline.quality == 1

    frames = with_fault(frames_of(bench), FAULT, "frozen")
    sent = run(service, [f for f in frames if f[0] < RELOAD + 2.0], RELOAD, reload)
    assert qualities(sent, 0x640, RELOAD + 0.1) == {1}
    (event,) = [e for e in service.status()["signal_health"]["events"] if e["sensor"] == "gyro"][:1]
    assert event["until_s"] == pytest.approx(RELOAD, abs=0.2)
    service.close()


def test_a_reload_of_the_estimation_keeps_what_is_usual_for_the_vehicles_signals(bench):
    bench.edit("estimator: published\n  ", "")
    service = bench.service()
    bench.drive(service)

    def usual_speed() -> object:
        made = without_stored(service.engine.pipeline.estimator)
        assert isinstance(made, JointEstimator)
        return made._signals.health._signals["speed"]._usual

    before, estimator = usual_speed(), service.engine.pipeline.estimator
    bench.edit("accelerometer_bias: 0.02", "accelerometer_bias: 0.03")
    service.reload()
    assert service.engine.pipeline.estimator is not estimator
    assert usual_speed() is before
    bench.edit("speed: SPEED.V", "speed: {signal: SPEED.V, offset: 0.1}")
    service.reload()
    assert usual_speed() is not before
    service.close()


def test_a_reload_reports_no_input_as_missing(bench):
    bench.config.write_text(bench.config.read_text() + DIAGNOSTICS)
    service = bench.service()
    now = 0.0
    service._clock = lambda: now
    frames = [f for f in frames_of(bench) if f[0] < RELOAD]

    def reload() -> None:
        nonlocal now
        service.reload()
        health = service.engine.health()
        assert not health.accelerometer_missing
        assert not health.gyroscope_missing
        assert not health.speed_missing
        now = RELOAD
        service._every_second(now)

    run(service, frames, RELOAD - 0.5, reload)
    assert "no accelerometer" not in bench.log.getvalue()
    assert "no speed" not in bench.log.getvalue()
    service.close()


def test_counters_of_frames_and_counts_of_the_status_go_on(bench):
    service = bench.service()
    plan = compile_decode(output_database().message("IMUCALD_Acceleration"), ["Counter"])
    status: dict[str, object] = {}

    def reload() -> None:
        status.update(service.status())
        bench.edit("status_rate: 10", "status_rate: 5")
        service.reload()
        now = service.status()
        for key in ("frames_given_out", "signals"):
            assert now[key] == status[key]
        assert now["frames"]["used"] == status["frames"]["used"] > 0

    sent = run(service, frames_of(bench), RELOAD, reload)
    counts = [int(plan.decode(data)[0] or 0) for _, i, data in sent if i == 0x640]
    assert len(counts) > 2000
    assert all((b - a) % 16 == 1 for a, b in itertools.pairwise(counts))
    service.close()
