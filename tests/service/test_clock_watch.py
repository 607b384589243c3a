"""The system's clock is set while the service runs: counted, and said."""

from __future__ import annotations

import pytest

import shuttle
from imucald.service.live import ClockWatch
from imucald.service.parts import ServiceOptions
from imucald.service.service import Service


class Clocks:
    """A wall clock and a steady one; the reading of the wall clock takes a while."""

    def __init__(self) -> None:
        self.now, self.ahead, self.pause = 100.0, 1.6e9, 0.0

    def wall(self) -> float:
        self.now += self.pause
        return self.now + self.ahead

    def steady(self) -> float:
        self.now += self.pause
        return self.now


@pytest.fixture
def clocks() -> Clocks:
    return Clocks()


@pytest.mark.parametrize("step", [3600.0, -3600.0, 0.3, -0.3, 4e8])
def test_a_step_is_found_once_with_its_size(clocks, step):
    watch = ClockWatch(clocks.wall, clocks.steady)
    found = []
    for second in range(20):
        clocks.now += 1.0
        if second == 10:
            clocks.ahead += step
        found.append(watch.look())
    assert [f for f in found if f is not None] == [pytest.approx(step, abs=1e-6)]
    assert watch.count == 1


@pytest.mark.parametrize("rate", [0.08, -0.08])
def test_a_clock_that_is_led_to_the_right_time_was_not_set(clocks, rate):
    watch = ClockWatch(clocks.wall, clocks.steady)
    for _ in range(60):
        clocks.now += 1.0
        clocks.ahead += rate
        assert watch.look() is None


def test_a_process_that_is_held_up_does_not_take_that_for_a_step(clocks):
    watch = ClockWatch(clocks.wall, clocks.steady)
    for pause in (0.0, 0.8, 0.0, 30.0, 0.0):
        clocks.pause = pause
        assert watch.look() is None


def test_the_service_says_that_the_clock_was_set_and_counts_it(tmp_path, capfd, clocks):
    options = ServiceOptions(shuttle.write(tmp_path, cycles=1), interface="virtual", channel="set")
    now = [0.0]
    service = Service(options, clock=lambda: now[0])
    service.clock_watch = ClockWatch(clocks.wall, clocks.steady)

    def a_second(_: float) -> list[object]:
        now[0] += 1.0
        clocks.now += 1.0
        if now[0] == 3.0:
            clocks.ahead -= 7200.0
        return []

    service.link.receive = a_second  # type: ignore[assignment]
    service.run(6.0)
    status = service.status()
    service.close()
    assert status["process"]["clock_set"] == 1
    assert "the clock of the system was set by -7200.0 s" in capfd.readouterr().err
