"""What the configuration says of the bus and the output reaches the link and the engine."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
from msgspec.structs import replace

from engine_bus import DBC, Sender, columns_of, load
from imucald.can.columns import IdMatch
from imucald.can.dbc.database import Database, load_database
from imucald.can.link.link import LinkCounters
from imucald.inputs import wiring
from imucald.inputs.wiring import compile_router
from imucald.runtime.output.output_frames import OutputFrames
from imucald.runtime.session import make_engine
from imucald.service import live

HEAD = "database: bus.dbc\nsignals:\n  accelerometer: {x: ACC.AX, y: ACC.AY, z: ACC.AZ}\n"
MOUNT = 0x643


def test_the_bus_is_opened_as_configured_and_named_on_the_command_line(tmp_path, monkeypatch):
    opened: list[tuple[tuple[Any, ...], dict[str, Any]]] = []
    monkeypatch.setattr(live, "Link", lambda *args, **more: opened.append((args, more)))
    bus = "{interface: slcan, channel: /dev/tty9, bitrate: 250000, fd: true, options: {rtscts: 1}}"
    loaded = load(f"{HEAD}bus: {bus}\n", tmp_path)
    wanted = [IdMatch(0x100, 0x7FF, "can3")]
    live.open_link(loaded, wanted, frozenset({0x640}))
    live.open_link(loaded, wanted, frozenset({0x640}), "virtual", "x")
    first, second = opened
    assert first[0] == ("slcan", "/dev/tty9")
    assert second[0] == ("virtual", "x")
    for _, more in opened:
        assert (more["bitrate"], more["fd"], more["options"]) == (250000, True, {"rtscts": 1})
        assert more["own_ids"] == {0x640}
        # the channels of a recording mean nothing on one live bus
        assert more["receive"] == [IdMatch(0x100, 0x7FF)]


def test_losses_and_failed_sends_are_reported_for_a_second(tmp_path):
    clock = SimpleNamespace(now=10.0)
    link: Any = SimpleNamespace(counters=LinkCounters())
    daemon = live.Daemon(make_engine(load(HEAD, tmp_path)), link, lambda: clock.now)
    assert not daemon.link_health().frames_lost
    link.counters.lost = 3
    health = daemon.link_health()
    assert (health.frames_lost, health.lost, health.send_failed) == (True, 3, False)
    clock.now += 0.6
    link.counters.not_sent("queue_full")
    health = daemon.link_health()
    assert (health.frames_lost, health.send_failed) == (True, True)
    clock.now += 0.6
    health = daemon.link_health()
    assert (health.frames_lost, health.lost, health.send_failed) == (False, 3, True)
    clock.now += 0.6
    assert not daemon.link_health().send_failed


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1, 2, 5, 10])
def test_status_frames_come_as_often_as_configured(rate, tmp_path):
    engine = make_engine(load(f"{HEAD}output: {{status_rate: {rate}}}\n", tmp_path))
    sender, out = Sender(), []
    for k in range(1001):
        out += engine.frame(*sender.frame(k / 100, "ACC", AX=0.0, AY=0.0, AZ=9.81))
    assert sum(can_id == MOUNT for can_id, _ in out) == pytest.approx(10 * rate, abs=1)


def test_each_output_frame_has_the_id_that_is_configured(tmp_path):
    text = HEAD + "  gyroscope: {x: GYR.GX, y: GYR.GY, z: GYR.GZ}\n"
    text += "  magnetometer: {x: MAG.MX, y: MAG.MY, z: MAG.MZ}\n"
    defaults = {
        "acceleration": 0x640, "angular_rate": 0x641, "magnetic_field": 0x642, "mount": 0x643,
        "mount_deviation": 0x644, "health": 0x645, "cross_talk_deviation": 0x64D,
        "zero_deviation": 0x64E,
    }  # fmt: skip
    for k, (name, default) in enumerate(defaults.items()):
        loaded = load(f"{text}output: {{ids: {{{name}: 0x{0x300 + k:X}}}}}\n", tmp_path)
        ids = OutputFrames(loaded.config).can_ids
        assert 0x300 + k in ids
        assert ids - {0x300 + k} == set(defaults.values()) - {default}


def test_a_database_of_another_channel_is_not_heard(tmp_path):
    text = HEAD.replace("bus.dbc", "{path: bus.dbc, channel: can1}") + "  speed: SPD.V\n"
    frames = [Sender().frame(0.0, "SPD", V=36.0)]
    for channel, expected in (("can0", False), ("can1", True)):
        router = compile_router(load(text, tmp_path))
        columns = columns_of(frames, channel)
        assert ("speed" in router.columns(columns.t, columns).samples) is expected


@pytest.mark.parametrize("order", ["[bus.dbc, other.dbc]", "[other.dbc, bus.dbc]"])
def test_of_two_databases_the_first_that_has_the_message_is_used(order, tmp_path):
    other = DBC.replace("BO_ 304 SPD:", "BO_ 306 SPD:")
    assert other != DBC
    (tmp_path / "other.dbc").write_text(other, encoding="ascii")
    router = compile_router(load(HEAD.replace("bus.dbc", order) + "  speed: SPD.V\n", tmp_path))
    ids = {match.can_id for match in router.matches}
    used = 304 if order.startswith("[bus") else 306
    assert ids & {304, 306} == {used}


def test_what_the_database_calls_invalid_is_not_available(tmp_path, monkeypatch):
    def with_invalid(path: Any) -> Database:
        messages = dict(load_database(path).messages)
        speed = messages["SPD"]
        signals = dict(speed.signals, V=replace(speed.signals["V"], invalid_raw=0x7FFF))
        messages["SPD"] = replace(speed, signals=signals)
        return Database(list(messages.values()), {})

    monkeypatch.setattr(wiring, "load_database", with_invalid)
    router = compile_router(load(HEAD + "  speed: SPD.V\n", tmp_path))
    assert router.frame(0.0, 304, bytes.fromhex("ff7f0000")) == ([], ["speed"], ["speed"])
    assert router.rejected == {"not_available": 1}
    samples, _, _ = router.frame(0.1, 304, bytes.fromhex("fe7f0000"))
    assert [channel for channel, _ in samples] == ["reverse", "speed"]
