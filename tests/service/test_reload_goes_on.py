"""After a reload the daemon knows of sensors, inputs and its own frames what it knew before."""

from __future__ import annotations

import io
import itertools
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

import shuttle
from imucald.can.dbc.decode import compile_decode
from imucald.can.logs.log_reader import LogReader
from imucald.runtime.output.output_frames import output_database
from imucald.service.journal import Journal
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service

GYROSCOPE, SPEED, CORRECTED_RATE, CORRECTED_FORCE = 0x201, 0x202, 0x641, 0x640
RATE = compile_decode(output_database().message("IMUCALD_AngularRate"), ["Quality"])
FORCE = compile_decode(output_database().message("IMUCALD_Acceleration"), ["Counter"])
FROZEN_S, RELOAD_S, END_S = 20.0, 30.0, 40.0


class Bench:
    """A drive through the daemon's engine, frame by frame, whose gyroscope freezes."""

    def __init__(self, folder: Path, freezes: bool = True) -> None:
        self.config = shuttle.write(folder, cycles=4)
        channel = f"go-on-{time.monotonic_ns()}"
        options = ServiceOptions(
            self.config, interface="virtual", channel=channel, state_folder=folder / "state"
        )
        self.service = Service(options, Journal(io.StringIO()))
        self.freezes = freezes
        self.frames = self._recorded(folder / "shuttle.log")
        self.sent: list[tuple[float, int, bytes]] = []

    def _recorded(self, log: Path) -> Iterator[tuple[float, int, bytes]]:
        frozen = None
        for chunk in LogReader([log]):
            for k in range(len(chunk.t)):
                t, data = float(chunk.t[k]), chunk.data[k, : chunk.length[k]].tobytes()
                if chunk.can_id[k] == GYROSCOPE and self.freezes and t - 1.6e9 >= FROZEN_S:
                    frozen = frozen or data
                    data = frozen
                yield t, int(chunk.can_id[k]), data

    def drive(self, until: float, last_id: int | None = None) -> None:
        """Go on until so many seconds of the log, and to the next frame of that id."""
        for t, can_id, data in self.frames:
            sent = self.service.engine.frame(t, can_id, data)
            self.sent += [(t - 1.6e9, out_id, out) for out_id, out in sent]
            if t - 1.6e9 >= until and last_id in (None, can_id):
                return

    def good_rates(self, begin: float) -> int:
        return sum(
            out_id == CORRECTED_RATE and t >= begin and RATE.decode(out)[0] in (2, 3)
            for t, out_id, out in self.sent
        )


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path)
    yield made
    made.service.close()


def test_a_faulty_sensor_stays_faulty(bench: Bench) -> None:
    bench.drive(RELOAD_S)
    assert bench.good_rates(0.0) > 100
    faults = dict(bench.service.engine.pipeline.health.faults)
    assert set(faults) == {"gyro"}
    before = bench.service.engine
    bench.service.reload()
    assert bench.service.engine is not before
    assert dict(bench.service.engine.pipeline.health.faults) == faults
    bench.drive(END_S)
    assert bench.good_rates(RELOAD_S) == 0


def test_a_sensor_that_is_read_in_another_way_is_judged_anew(bench: Bench) -> None:
    bench.drive(RELOAD_S)
    database = bench.config.with_name("shuttle.dbc")
    database.write_text(database.read_text().replace("SG_ GX : 0|16@1-", "SG_ GX : 0|16@1+"))
    bench.service.reload()
    assert dict(bench.service.engine.pipeline.health.faults) == {}


def test_inputs_that_came_are_not_missing(bench: Bench) -> None:
    bench.drive(RELOAD_S, SPEED)
    before = bench.service.engine.health()
    bench.service.reload()
    assert bench.service.engine.health() == before
    assert not before.speed_missing


def test_the_counters_of_what_is_sent_go_on(bench: Bench) -> None:
    bench.drive(RELOAD_S)
    bench.service.reload()
    bench.drive(END_S)
    forces = [out for _, out_id, out in bench.sent if out_id == CORRECTED_FORCE]
    counters = [int(FORCE.decode(out)[0] or 0) for out in forces]
    assert len(counters) > 2000
    assert {(b - a) % 16 for a, b in itertools.pairwise(counters)} == {1}
