"""`imucald check` shows what is decoded, and notices planted mistakes in units, signs and axes."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace

from imucald import cli
from imucald.can.columns import FrameColumns
from imucald.can.logs.log_reader import CandumpWriter, LogReader
from imucald.can.python_can import can
from imucald.commands.check_view import print_report
from imucald.config import parse_config
from imucald.config.base import MAX_SPEED_DELAY
from imucald.config_check import Check
from imucald.core.rotations import rotation_from_angles
from imucald.core.samples import Series
from imucald.runtime.session import make_engine, open_config
from imucald.simulation import random_model, simulate
from imucald.traffic.can_log import EPOCH_S, bus_frames
from imucald.traffic.drive_encoder import BusEncoder, example_config
from paths import ROOT

DATA = ROOT.parent / "shared" / "data"
EXAMPLE = ROOT / "config" / "examples" / "passenger_car.yaml"
MINUTES = 4.0

Frames = list[FrameColumns]


@pytest.fixture(scope="module")
def frames() -> Frames:
    drive = simulate(random_model(6, standing_first=True), 6, MINUTES)
    return list(bus_frames(drive, BusEncoder(example_config())))


def checked(frames: Frames, change: Callable[[str], str] = str) -> dict[str, Any]:
    check = Check(parse_config(change(EXAMPLE.read_text()), EXAMPLE))
    for chunk in frames:
        check.feed(chunk)
    return check.report()


def findings(report: dict[str, Any], *levels: str) -> dict[str, str]:
    """Findings by quantity, those of a level joined."""
    found: dict[str, str] = {}
    for row in report["findings"]:
        if row["level"] in levels:
            found[row["quantity"]] = found.get(row["quantity"], "") + row["text"] + ". "
    return found


def replacing(old: str, new: str) -> Callable[[str], str]:
    def change(text: str) -> str:
        assert old in text
        return text.replace(old, new)

    return change


def test_a_right_configuration_gives_no_warning(frames: Frames) -> None:
    report = checked(frames)
    assert report["usable"]
    assert findings(report, "error", "warning") == {}
    good = findings(report, "ok")
    assert "at rest" in good["accelerometer"]
    assert "right-handed" in good["accelerometer"]
    assert "yaw_rate" in good["gyroscope"]


def test_rates_units_and_ranges_are_those_of_the_log(frames: Frames) -> None:
    report = checked(frames)
    rows = {row["quantity"]: row for row in report["quantities"]}
    speed = rows["speed"]
    assert (speed["source"], speed["id"]) == ("ESC_Speed.VehicleSpeed", "0x1A0")
    assert (speed["unit"], speed["si_unit"]) == ("km/h", "m/s")
    assert speed["factor"] == pytest.approx(1 / 3.6)
    assert speed["in_unit"]["max"] == pytest.approx(3.6 * speed["in_si"]["max"], rel=1e-5)
    assert rows["accelerometer.x"]["samples"] == pytest.approx(MINUTES * 6000, abs=5)
    messages = {row["name"]: row for row in report["messages"]}
    assert messages["IMU_Accel"]["cycle_s"] == pytest.approx(0.01, rel=0.01)
    assert messages["ESC_Speed"]["stated_cycle_s"] == 0.02
    sent = sum(len(chunk) for chunk in frames)
    assert report["frames"]["read"] == report["frames"]["used"] == sent
    assert report["duration_s"] == pytest.approx(60 * MINUTES, abs=0.1)
    json.dumps(report, allow_nan=False)


@pytest.mark.parametrize("share", [0.0, 0.005, 0.05])
def test_lost_frames_are_shown_and_a_recorder_that_drops_them_is_named(frames, share) -> None:
    rng = np.random.default_rng(1)
    report = checked([chunk.take(rng.random(len(chunk)) >= share) for chunk in frames])
    lost = {row["name"]: row["lost_share"] for row in report["messages"]}
    assert lost["IMU_Accel"] == pytest.approx(share, abs=0.005)  # by its counter
    assert lost["ESC_Speed"] == pytest.approx(share, abs=0.01)  # by its times
    text = findings(report, "warning").get("log", "")
    assert ("% of the frames of each message are lost" in text) == (share == 0.05)
    assert report["usable"]


@pytest.mark.parametrize(("seconds", "is_said"), [(1.0, False), (2.0, True)])
def test_a_speed_that_comes_seldom_is_named_with_what_it_costs(frames, seconds, is_said) -> None:
    seldom = []
    for chunk in frames:
        is_speed = np.isin(chunk.can_id & 0x7FF, (0x1A0, 0x1B0))  # the vehicle's and the wheels'
        kept = ~is_speed
        for can_id in (0x1A0, 0x1B0):
            rows = np.flatnonzero((chunk.can_id & 0x7FF) == can_id)
            at = np.floor(chunk.t[rows] / seconds)
            kept[rows[np.diff(at, prepend=-1.0) > 0]] = True
        seldom.append(chunk.take(kept))
    text = findings(checked(seldom), "note").get("speed", "")
    assert ("twice as long" in text) == is_said


SIGNAL = "{{signal: {0}, {1}}}"
MISTAKES = {
    "yaw rate the other way round": (
        ("ESC_Dynamics.YawRate", "sign: -1"), "yaw_rate", "or remove 'sign: -1' if it is set"),
    "yaw rate in another unit": (
        ("ESC_Dynamics.YawRate", "unit: rad/s"), "yaw_rate", "deg against rad"),
    "steering the other way round": (
        ("EPS_SteeringAngle.SteeringWheelAngle", "sign: -1"),
        "steering_wheel_angle", "wrong sign"),
    "lateral acceleration the other way round": (
        ("ESC_Dynamics.LateralAccel", "sign: -1"), "lateral_acceleration", "wrong sign"),
    "longitudinal acceleration the other way round": (
        ("ESC_Dynamics.LongitudinalAccel", "sign: -1"), "longitudinal_acceleration", "negative"),
    "longitudinal acceleration in another unit": (
        ("ESC_Dynamics.LongitudinalAccel", "unit: m/s^2"), "longitudinal_acceleration",
        "too small"),
    "speed in another unit": (
        ("ESC_Speed.VehicleSpeed", "unit: m/s"), "speed", "km/h against m/s"),
    "miles for kilometres": (
        ("ESC_Speed.VehicleSpeed", "unit: mph"), "speed", "mph against km/h"),
    "brake inverted": (("ESC_Brake.BrakePressed", "equals: 0"), "brake", "accelerates"),
    "reverse inverted": (("TCU_Gear.GearPosition", "equals: 0"), "reverse", "25 km/h"),
    "one axis of the accelerometer inverted": (
        ("IMU_Accel.AccelY", "sign: -1"), "accelerometer", "wrong sign of its y axis"),
    "one axis of the gyroscope inverted": (
        ("IMU_Gyro.RateY", "sign: -1"), "gyroscope", "wrong sign of its y axis"),
}  # fmt: skip


WARNINGS = {
    "longitudinal acceleration the other way round",
    "longitudinal acceleration in another unit",
    "miles for kilometres",
    "brake inverted",
}


@pytest.mark.slow
@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_planted_mistake_is_named_and_nothing_else(frames: Frames, mistake: str) -> None:
    (signal, change), quantity, words = MISTAKES[mistake]
    planted = SIGNAL.format(signal, change)
    old = "{signal: TCU_Gear.GearPosition, equals: 1}" if quantity == "reverse" else signal
    report = checked(frames, replacing(f": {old}", f": {planted}"))
    found = findings(report, "error", "warning")
    assert set(found) == {quantity}
    assert words in found[quantity]
    # what turns the mount, or what every comparison rests on, stops an installation
    assert report["usable"] is (mistake in WARNINGS)


def test_a_wrong_sign_bit_of_the_speed_is_named_and_no_key_that_is_not_there(
    frames: Frames,
) -> None:
    def change(text: str) -> str:
        text = replacing("  reverse: {signal: TCU_Gear.GearPosition, equals: 1}\n", "")(text)
        signs = "sign_signal: ESC_Brake.BrakePressed, sign: -1"
        return replacing("ESC_Speed.VehicleSpeed", SIGNAL.format("ESC_Speed.VehicleSpeed", signs))(
            text
        )

    report = checked(frames, change)
    found = findings(report, "error")
    assert set(found) == {"speed"}
    assert "is negative for" in found["speed"]
    assert "of the time above 25 km/h: check 'sign_signal:' and 'sign:'" in found["speed"]
    assert "reverse" not in findings(report, "error", "warning", "note", "ok")


def test_a_wrong_unit_of_the_accelerometer_is_an_error(frames: Frames) -> None:
    def change(text: str) -> str:
        for axis in "XYZ":
            text = text.replace(f" IMU_Accel.Accel{axis}", f" {{signal: IMU_Accel.Accel{axis}, "
                                "unit: g}")  # fmt: skip
        return text

    report = checked(frames, change)
    assert not report["usable"]
    assert "g against m/s²" in findings(report, "error")["accelerometer"]
    assert findings(report, "warning") == {}


def test_an_accelerometer_without_gravity_is_named_and_not_taken_for_a_unit() -> None:
    drive = simulate(random_model(6, standing_first=True), 6, MINUTES)
    accel = drive.samples["accel"]
    force = accel.values - accel.values.mean(axis=0)
    samples = {**drive.samples, "accel": replace(accel, values=force)}
    linear = dataclasses.replace(drive, samples=samples)
    report = checked(list(bus_frames(linear, BusEncoder(example_config()))))
    assert not report["usable"]
    text = findings(report, "error")["accelerometer"]
    assert "gravity is already removed" in text
    assert "unit" not in text


def test_a_spike_does_not_take_gravity_out_of_a_sound_accelerometer() -> None:
    drive = simulate(random_model(6, standing_first=True), 6, MINUTES)
    accel = drive.samples["accel"]
    values = accel.values.copy()
    values[len(values) // 2] = [1500.0, 0.0, 0.0]
    samples = {**drive.samples, "accel": replace(accel, values=values)}
    spiked = dataclasses.replace(drive, samples=samples)
    report = checked(list(bus_frames(spiked, BusEncoder(example_config()))))
    assert "accelerometer" not in findings(report, "error")


def seldom(frames: Frames, can_id: int, cycle: float) -> Frames:
    """The frames with one identifier's thinned out to a cycle [s]."""
    kept = []
    for chunk in frames:
        own = np.flatnonzero(chunk.can_id == can_id)
        first = np.unique(np.floor(chunk.t[own] / cycle), return_index=True)[1]
        keep = chunk.can_id != can_id
        keep[own[first]] = True
        kept.append(chunk.take(np.flatnonzero(keep)))
    return kept


def test_a_wrong_unit_that_is_set_is_named_and_not_asked_for(frames: Frames) -> None:
    speed = "  speed: ESC_Speed.VehicleSpeed"
    stated = "  speed: {signal: ESC_Speed.VehicleSpeed, unit: m/s}"
    report = checked(frames, replacing(speed, stated))
    text = findings(report, "error")["speed"]
    assert "which looks like km/h against m/s" in text
    assert "'unit: m/s' is set: remove it (the unit in the database is km/h) or correct it" in text
    assert "set 'unit:'" not in text
    assert "speed" not in findings(report, "ok"), "as sent it is not from the wheels"


def test_an_accelerometer_that_comes_too_seldom_is_an_error(frames: Frames) -> None:
    report = checked(seldom(frames, 0x200, 1.0))
    assert not report["usable"]
    assert "every 1 s" in findings(report, "error")["accelerometer"]


@pytest.mark.parametrize("late", [2.0, 3.0])
def test_a_speed_too_late_for_the_calibration_is_named(frames: Frames, late: float) -> None:
    shifted = []
    for chunk in frames:
        t = chunk.t + np.where(chunk.can_id == 0x1A0, late, 0.0)
        order = np.argsort(t, kind="stable")
        shifted.append(replace(chunk.take(order), t=t[order]))
    warned = findings(checked(shifted), "warning")
    assert (
        f"behind the accelerometer, and only {MAX_SPEED_DELAY} s can be corrected"
        in warned["speed"]
    )


def test_a_speed_of_two_senders_that_contradict_is_named_and_nothing_judged_by_it(
    frames: Frames,
) -> None:
    """As two units of J1939 send one message, one of them without a value."""
    rng, mixed = np.random.default_rng(3), []
    for chunk in frames:
        rows = np.flatnonzero(chunk.can_id == 0x1A0)
        data = chunk.data.copy()
        other = rows[rng.random(len(rows)) < 0.4]
        data[other, :2] = 25000 & 0xFF, 25000 >> 8  # 250 km/h
        mixed.append(replace(chunk, data=data))
    report = checked(mixed, lambda text: re.sub(r"  ESC_Speed:\n(?:    .*\n)+", "", text))
    wrong = findings(report, "error", "warning")
    assert "jumps more than a vehicle can" in wrong["speed"]
    assert "source_address" in wrong["speed"]
    assert "gyroscope" not in wrong
    assert not report["usable"]


def test_what_nothing_is_learnt_from_is_named_with_signal_cause_and_time(frames: Frames) -> None:
    began = frames[0].t[0]
    silent = []
    for chunk in frames:
        t = chunk.t - began
        silent.append(chunk.take(~((chunk.can_id == 0x1A0) & (t > 100.0) & (t < 130.0))))
    said = findings(checked(silent), "note")["log"]
    seconds = re.search(
        r"of 240 s, (\d+) s \(no valid speed sample\) could not be used for the mount", said
    )
    assert seconds is not None, said
    assert 25 <= int(seconds[1]) <= 35


def test_a_log_that_shows_no_mount_for_most_of_its_time_is_said_in_the_last_line(
    frames: Frames, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of such a log only 'this configuration can be used' was said."""
    began = frames[0].t[0]
    silent = [chunk.take((chunk.can_id != 0x1A0) | (chunk.t - began < 100.0)) for chunk in frames]
    report = checked(silent)
    assert report["usable"]
    assert report["used_for_mount_s"] == pytest.approx(100.0, abs=10.0)
    assert "could not be used for the mount" in findings(report, "warning")["log"]
    print_report(report)
    last = capsys.readouterr().out.splitlines()[-1]
    assert re.search(r"only (9\d|10\d) of 240 s of this log could be used for the mount", last)


def twice(frames: Frames, later: float = 0.0) -> Frames:
    """Every frame again, so many seconds later."""
    found = []
    for chunk in frames:
        again = chunk.take(np.repeat(np.arange(len(chunk)), 2))
        found.append(replace(again, t=again.t + later * (np.arange(len(again)) % 2)))
    return found


def test_frames_that_all_come_twice_at_one_stamp_count_once_and_are_named(frames: Frames) -> None:
    once, report = checked(frames), checked(twice(frames))
    assert report["usable"]
    assert set(findings(report, "error")) == set(findings(once, "error"))
    row = next(m for m in report["messages"] if m["name"] == "IMU_Accel")
    own = next(m for m in once["messages"] if m["name"] == "IMU_Accel")
    assert row["rejected"] == {"doubled": own["frames"]}
    assert row["cycle_s"] == own["cycle_s"]
    warned = findings(report, "warning")["accelerometer"]
    assert "of IMU_Accel are rejected (doubled" in warned
    assert "Each frame is used once" in warned


def test_copies_are_not_counted_among_the_frames_that_are_lost(frames: Frames) -> None:
    """With a few faults beside them most frames are rejected, and most samples are taken."""
    some = twice(frames)
    first = np.arange(len(some[0])) < 400
    some[0] = replace(some[0], t=some[0].t + 1e-6 * (first & (np.arange(len(first)) % 2 == 1)))
    report = checked(some)
    row = next(m for m in report["messages"] if m["name"] == "IMU_Accel")
    assert 2 * sum(row["rejected"].values()) > row["frames"], "what is planted"
    assert report["usable"]


def test_frames_that_all_come_again_a_little_later_leave_no_accelerometer(frames: Frames) -> None:
    report = checked(twice(frames, later=1e-6))
    assert not report["usable"]
    assert "nearly all samples are rejected" in findings(report, "error")["accelerometer"]
    assert "counter_repeated" in findings(report, "error")["accelerometer"]
    warned = findings(report, "warning")["accelerometer"]
    assert "a gateway or a second log sends the same frames again, or 'counter:'" in warned


def test_a_message_without_counter_that_comes_twice_from_some_time_on_is_named(
    frames: Frames,
) -> None:
    began, found = frames[0].t[0] + 100.0, []
    for chunk in frames:
        found.append(chunk.take(np.repeat(np.arange(len(chunk)), 1 + (chunk.t > began))))
    report = checked(found)
    rows = {m["name"]: m["rejected"] for m in report["messages"]}
    assert rows["ESC_WheelSpeeds"]["duplicate_sender"] > 0.5 * 140.0 * 100.0, "of what came then"
    by_message = sum(reasons.get("duplicate_sender", 0) for reasons in rows.values())
    assert by_message == report["frames"]["rejected"]["duplicate_sender"]
    text = findings(report, "warning")["wheel_speeds"]
    assert "of ESC_WheelSpeeds are rejected (duplicate_sender" in text
    assert "a second control unit sends this identifier, or a gateway sends it again" in text


def test_half_of_the_frames_again_later_is_an_error_where_most_are_rejected(frames: Frames) -> None:
    random = np.random.default_rng(8)
    some = []
    for chunk in frames:
        copies = random.integers(1, 3, len(chunk))
        again = chunk.take(np.repeat(np.arange(len(chunk)), copies))
        is_copy = np.concatenate([[False], np.diff(again.t) == 0.0])
        some.append(replace(again, t=again.t + 1e-6 * is_copy))
    report = checked(some)
    row = next(m for m in report["messages"] if m["name"] == "IMU_Accel")
    assert sum(row["rejected"].values()) > 0.8 * row["frames"], "what is planted"
    assert not report["usable"]
    assert "most of its frames are rejected" in findings(report, "error")["accelerometer"]


def test_a_few_frames_that_come_twice_are_no_error(frames: Frames) -> None:
    random = np.random.default_rng(9)
    again = [1 + (random.random(len(chunk)) < 0.001) for chunk in frames]
    few = [
        chunk.take(np.repeat(np.arange(len(chunk)), n))
        for chunk, n in zip(frames, again, strict=True)
    ]
    assert checked(few)["usable"]


def test_a_log_in_which_no_time_passes_is_an_error(frames: Frames) -> None:
    report = checked([replace(chunk, t=np.zeros(len(chunk))) for chunk in frames])
    assert not report["usable"]
    assert "all frames have the same time stamp" in findings(report, "error")["log"]


@pytest.mark.parametrize("stamp", ["milliseconds for seconds", "begins again each second"])
def test_a_log_with_more_frames_than_any_bus_carries_is_an_error(frames: Frames, stamp) -> None:
    """As if each time stamp had a thousand times the unit, or looped from 0 to 1 s."""
    factor = 1e-3 if stamp.startswith("milli") else 1.0
    chunks = [
        replace(c, t=1e9 + factor * (c.t - frames[0].t[0]) % (1.0 if factor == 1.0 else np.inf))
        for c in frames
    ]
    report = checked(chunks)
    assert not report["usable"]
    assert "more frames than any CAN bus carries" in findings(report, "error")["log"]


def test_samples_that_share_a_coarse_time_stamp_are_too_seldom(frames: Frames) -> None:
    report = checked([replace(chunk, t=np.floor(chunk.t)) for chunk in frames])
    assert "time stamps too coarse" in findings(report, "error")["accelerometer"]


def test_exchanged_wheels_are_noticed(frames: Frames) -> None:
    def change(text: str) -> str:
        return text.replace("Left\n", "@\n").replace("Right\n", "Left\n").replace("@\n", "Right\n")

    found = findings(checked(frames, change), "error", "warning")
    assert list(found) == ["wheel_speeds"]
    assert "exchanged" in found["wheel_speeds"]


def test_wrong_checksum_settings_leave_nothing_and_say_why(frames: Frames) -> None:
    report = checked(frames, replacing("id_bytes: 2", "id_bytes: 4"))
    assert not report["usable"]
    errors, warnings = findings(report, "error"), findings(report, "warning")
    assert "no sample" in errors["accelerometer"]
    assert "id_bytes" in warnings["accelerometer"]
    assert report["frames"]["rejected"]["checksum"] > 0


def test_what_is_missing_is_reported_with_its_cost(frames: Frames) -> None:
    keep = ("accelerometer", "x:", "y:", "z:")

    def change(text: str) -> str:
        head, _, rest = text.partition("signals:\n")
        lines = rest.splitlines()[:4]
        assert all(line.strip().startswith(keep) for line in lines)
        return head + "signals:\n" + "\n".join(lines) + "\n"

    report = checked(frames, change)
    assert report["usable"]
    assert "first motion" in findings(report, "warning")["speed"]
    assert "successive target angles" in findings(report, "note")["gyroscope"], (
        "method A is used then"
    )

    def with_speed(text: str) -> str:
        return change(text) + "  speed: ESC_Speed.VehicleSpeed\n"

    report = checked(frames, with_speed)
    assert "the mount never becomes usable" in findings(report, "warning")["gyroscope"]


@pytest.mark.parametrize(
    "turns",
    [
        "yaw_rate: ESC_Dynamics.YawRate",
        "steering_wheel_angle: EPS_SteeringAngle.SteeringWheelAngle",
    ],
)
def test_a_signal_that_shows_turns_stands_in_for_the_gyroscope(frames: Frames, turns: str) -> None:
    def change(text: str) -> str:
        head, _, rest = text.partition("signals:\n")
        kept = [*rest.splitlines()[:4], "  speed: ESC_Speed.VehicleSpeed", f"  {turns}"]
        return head + "signals:\n" + "\n".join(kept) + "\n"

    report = checked(frames, change)
    assert "gyroscope" not in findings(report, "warning")
    assert "is used for turns" in findings(report, "note")["gyroscope"]


def test_a_message_that_does_not_come_is_reported(frames: Frames) -> None:
    without = [chunk.take(chunk.can_id != 0x1A0) for chunk in frames]
    report = checked(without)
    assert "no frame of ESC_Speed (0x1A0) came" in findings(report, "warning")["speed"]


def test_other_ids_and_taken_output_ids_are_reported(frames: Frames) -> None:
    first = frames[0]
    foreign = first.take(slice(0, 50))
    foreign = FrameColumns(
        foreign.t,
        np.where(np.arange(50) < 20, 0x640, 0x123).astype(np.uint32),
        foreign.length,
        foreign.data,
        foreign.channel,
        foreign.channels,
    )
    report = checked([foreign, *frames])
    assert "0x640" in findings(report, "warning")["output.ids"]
    assert report["output"][0] == {"frame": "acceleration", "id": "0x640", "seen": 20}
    assert (report["frames"]["other_ids"], report["frames"]["other_frames"]) == (2, 50)


@pytest.mark.parametrize(
    "switches",
    [
        "attitude: {enabled: true}\n",
        "attitude: {enabled: true, compensation: {send: true}}\n",
        "travel_direction: {enabled: true}\n",
    ],
)
def test_every_frame_that_the_daemon_sends_is_listed(frames: Frames, switches: str) -> None:
    text = EXAMPLE.read_text() + switches
    if "travel" in switches:
        text = text.replace("signals:\n", "signals:\n  heading: GW_Heading.Heading\n")
    loaded = parse_config(text, EXAMPLE)
    check = Check(loaded)
    check.feed(frames[0])
    sent = make_engine(loaded).output.can_ids
    assert {int(row["id"], 16) for row in check.report()["output"]} == sent


def test_a_channel_mix_up_is_reported(frames: Frames) -> None:
    change = replacing("ESC_Brake.BrakePressed", "{signal: ESC_Brake.BrakePressed, channel: can7}")
    report = checked(frames[:1], change)
    assert (
        "comes on can0, but the configuration states can7" in findings(report, "warning")["brake"]
    )


def test_an_empty_log_is_not_usable() -> None:
    report = checked([])
    assert not report["usable"]
    json.dumps(report, allow_nan=False)


@pytest.mark.slow
def test_figures_are_those_of_numpy_whatever_the_chunks(frames: Frames) -> None:
    whole = checked(frames)
    pieces = [chunk.take(slice(i, i + 997)) for chunk in frames for i in range(0, len(chunk), 997)]
    cut = checked(pieces)
    for one, other in zip(whole["quantities"], cut["quantities"], strict=True):
        for key in ("min", "mean", "max"):
            assert one["in_si"][key] == pytest.approx(other["in_si"][key], rel=1e-5, abs=1e-9)
    assert [f["text"] for f in whole["findings"]] == [f["text"] for f in cut["findings"]]


@pytest.mark.slow
def test_a_fuzzed_bus_is_survived_and_counted() -> None:
    """Random bytes under our ids and any others: a report, finite and complete."""
    rng = np.random.default_rng(5)
    n = 60_000
    known = np.array([0x200, 0x201, 0x1A0, 0x130, 0xC2, 0x1B0, 0x1D0, 0x1E0, 0x640], np.uint32)
    anything = rng.integers(0, 2**29, n, dtype=np.uint32) | np.uint32(0x8000_0000)
    ids = np.where(rng.random(n) < 0.5, rng.choice(known, n), anything)
    t = np.cumsum(rng.exponential(0.001, n)) + 20.0 * (rng.random(n) < 1e-4).cumsum()
    chunk = FrameColumns(
        t - 30.0 * (np.arange(n) > n // 2),  # and the clock is set back once
        ids.astype(np.uint32),
        rng.integers(0, 9, n, dtype=np.uint8),
        rng.integers(0, 256, (n, 8), dtype=np.uint8),
        np.zeros(n, np.uint8),
        ("can0",),
    )
    report = checked([chunk.take(slice(i, i + 7000)) for i in range(0, n, 7000)])
    json.dumps(report, allow_nan=False)
    frames = report["frames"]
    assert frames["read"] == n
    assert frames["rejected"]["short_frame"] > 0
    assert frames["rejected"]["checksum"] > 0
    assert frames["other_ids"] <= 20_000
    assert frames["other_frames"] > 0.4 * n


# the command -----------------------------------------------------------------------------------


def test_the_command_prints_tables_and_its_status(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "drive.log"
    with CandumpWriter(log) as writer:
        for chunk in frames[:2]:
            writer.write_columns(chunk)
    assert cli.main(["check", "--config", str(EXAMPLE), str(log)]) == 0
    text = capsys.readouterr().out
    for word in ("IMU_Accel", "0x200", "km/h", "m/s", "can be used", "0x640 acceleration"):
        assert word in text
    assert cli.main(["check", "--config", str(EXAMPLE), "--json", str(log)]) == 0
    assert json.loads(capsys.readouterr().out)["usable"] is True
    log.write_text("(1600000000.000000) can0 123#00\n")
    assert cli.main(["check", "--config", str(EXAMPLE), str(log)]) == 1


@pytest.mark.slow
def test_the_command_listens_on_a_bus(frames: Frames, capsys: pytest.CaptureFixture[str]) -> None:
    stop = threading.Event()

    def car() -> None:
        chunk = frames[0]
        with can.Bus(interface="virtual", channel="check-live", preserve_timestamps=True) as bus:
            i = 0
            while not stop.wait(0.01):
                for _ in range(5):  # our 470 frames a second, whenever the listener begins
                    data = chunk.data[i, : chunk.length[i]].tobytes()
                    stamp = EPOCH_S + float(chunk.t[i])
                    can_id = int(chunk.can_id[i])
                    bus.send(can.Message(stamp, can_id, is_extended_id=False, data=data))
                    i += 1

    thread = threading.Thread(target=car)
    thread.start()
    try:
        arguments = ["check", "--config", str(EXAMPLE), "--json", "--seconds", "1"]
        status = cli.main([*arguments, "--interface", "virtual", "--channel", "check-live"])
    finally:
        stop.set()
        thread.join()
    report = json.loads(capsys.readouterr().out)
    assert status == 0
    assert report["frames"]["used"] > 50
    assert {row["quantity"] for row in report["quantities"] if row["samples"]} >= {
        "accelerometer.x",
        "speed",
    }


def test_names_in_brackets_are_printed_as_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    """Names come from databases, which are not ours: they are never taken for styles."""
    report = checked([])
    report["messages"][0]["name"] = "[/bold]A[red]"
    report["findings"].append({"level": "note", "quantity": "speed[1]", "text": "[/x] [on blue]"})
    print_report(report)
    text = capsys.readouterr().out
    for words in ("[/bold]A[red]", "speed[1]: [/x] [on blue]", "cycle [ms]"):
        assert words in text


def test_log_and_bus_at_once_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["check", "--config", str(EXAMPLE), "x.log", "--channel", "can0"]
    assert cli.main(arguments) == 1
    assert "not both" in capsys.readouterr().err


@pytest.mark.parametrize(
    "more",
    [
        "output: {ids: {acceleration: 0x200}}",  # an input
        "attitude: {enabled: true, filter: {heading: signal}}",
        "travel_direction: {enabled: true}",
        "diagnostics: {enabled: true, request_id: 0x640}",
        "diagnostics: {enabled: true, security: {key_function: 'nowhere:at_all'}}",
        "model: missing.yaml",
        "calibration: {estimator: published, straight: {recognise_by: [steering]}}",
    ],
)
def test_what_run_refuses_check_refuses_with_the_same_words(
    more: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    signals = {a: f"IMU_Accel.Accel{a.upper()}" for a in "xyz"}
    text = f"database: {ROOT / 'dbc' / 'imucald_example.dbc'}\nsignals: {{accelerometer: "
    text += "{" + ", ".join(f"{a}: {s}" for a, s in signals.items()) + "}}\n" + more + "\n"
    config = tmp_path / "car.yaml"
    config.write_text(text)
    log = tmp_path / "drive.log"
    log.write_text("(1600000000.000000) can0 200#0000000000000000\n")
    arguments = ["--config", str(config)]
    bus = ["--interface", "virtual", "--channel", "refused", "--seconds", "0.1"]
    assert cli.main(["run", *arguments, *bus]) == 78
    refused = capsys.readouterr().err
    assert cli.main(["check", *arguments, str(log)]) == 1
    assert f"{config}" in refused
    told_by_check = capsys.readouterr().err.removeprefix("imucald: ").strip()
    assert told_by_check
    assert told_by_check in refused


def test_warnings_are_counted_in_the_last_line_and_strict_fails_on_them(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "drive.log"
    with CandumpWriter(log) as writer:
        for chunk in frames:
            writer.write_columns(chunk.take(chunk.can_id != 0x1A0))  # the speed
    arguments = ["check", "--config", str(EXAMPLE), str(log)]
    assert cli.main(arguments) == 0
    last = capsys.readouterr().out.strip().splitlines()[-1]
    assert "can be used, with 2 warnings" in last
    assert cli.main([*arguments, "--strict"]) == 1
    assert "--strict" in capsys.readouterr().out.strip().splitlines()[-1]


def test_strict_passes_where_there_is_no_warning(
    frames: Frames, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / "drive.log"
    with CandumpWriter(log) as writer:
        for chunk in frames:
            writer.write_columns(chunk)
    assert cli.main(["check", "--strict", "--config", str(EXAMPLE), str(log)]) == 0
    assert "no warnings" in capsys.readouterr().out.strip().splitlines()[-1]


def test_a_silent_bus_says_what_to_look_at_and_nothing_else(
    capsys: pytest.CaptureFixture[str],
) -> None:
    arguments = ["check", "--config", str(EXAMPLE), "--seconds", "0.2", "--json"]
    assert cli.main([*arguments, "--interface", "virtual", "--channel", "silent"]) == 1
    (finding,) = json.loads(capsys.readouterr().out)["findings"]
    assert finding["level"] == "error"
    assert "no frame came in" in finding["text"]
    assert "bit rate" in finding["text"]


def test_a_bus_of_another_vehicle_is_one_error_with_its_ids(frames: Frames) -> None:
    others = [chunk.take(chunk.can_id == 0x1E0) for chunk in frames]
    for chunk in others:
        chunk.can_id[:] = 0x7A1
    report = checked(others)
    (finding,) = report["findings"]
    assert finding["level"] == "error"
    assert "0x7A1 on can0" in finding["text"]


def test_a_stated_axis_is_held_against_gravity_and_the_change_of_speed(frames: Frames) -> None:
    mount = random_model(6, standing_first=True).mount
    angles = (mount.roll_deg, mount.pitch_deg, mount.yaw_deg)
    R = rotation_from_angles(*map(math.radians, angles))
    axes = [(sign, name) for name in "xyz" for sign in ("", "-")]

    def pointing(row: int) -> dict[str, str]:
        parts = {f"{s}{n}": R[row]["xyz".index(n)] * (-1.0 if s else 1.0) for s, n in axes}
        return {
            "there": max(parts, key=parts.__getitem__),
            "away": min(parts, key=parts.__getitem__),
        }

    def stating(**keys: str) -> dict[str, Any]:
        line = ", ".join(f"{key}: {axis}" for key, axis in keys.items())
        return checked(frames, lambda t: t + f"\ncalibration: {{orientation: {{{line}}}}}\n")

    up, forward = pointing(2), pointing(0)
    right = stating(up=up["there"], forward=forward["there"])
    assert right["usable"]
    assert "points forward, as 'orientation' says" in findings(right, "ok")["accelerometer"]
    back = findings(stating(up=up["there"], forward=forward["away"]), "error")["accelerometer"]
    assert f"its {forward['away']} points back" in back
    assert "sign: -1" not in back
    mirrored = findings(stating(up=up["away"], forward=forward["away"]), "error")["accelerometer"]
    assert "invert the signs of all axes ('sign: -1'" in mirrored
    assert "points back" not in mirrored


def test_what_could_not_be_judged_is_listed(frames: Frames) -> None:
    (text,) = (t for t in texts_of(checked(frames), "note") if "unit and range" in t)
    listed = text.partition(": ")[2].split(", ")
    assert "temperature" in listed
    judged = {"yaw_rate", "steering_wheel_angle", "wheel_speeds", "brake", "reverse", "speed"}
    assert not judged & set(listed)


def test_a_flag_that_is_never_on_or_follows_nothing_is_not_called_right(frames: Frames) -> None:
    never = replacing("{signal: TCU_Gear.GearPosition, equals: 1}",
                      "{signal: TCU_Gear.GearPosition, equals: 3}")  # fmt: skip
    report = checked(frames, never)
    assert "reverse" not in findings(report, "ok")
    (text,) = (t for t in texts_of(report, "note") if "unit and range" in t)
    assert "reverse (never on)" in text
    planted = SIGNAL.format("EPS_SteeringAngle.SteeringWheelAngle", "above: 0")
    report = checked(frames, replacing(": ESC_Brake.BrakePressed", f": {planted}"))
    assert "brake" not in findings(report, "ok")


def test_a_message_that_stops_is_reported(frames: Frames) -> None:
    begin = frames[0].t[0]
    cut = []
    for chunk in frames:
        stops = (chunk.can_id == 0x130) & (chunk.t > begin + 100.0)
        cut.append(chunk.take(np.flatnonzero(~stops)))
    (text,) = texts_of(checked(cut), "warning")
    assert text == "no frame of ESC_Dynamics comes from 1:39 on, of 3:59"
    assert not texts_of(checked(frames), "warning")


def test_smallest_and_largest_beside_each_other_are_of_one_sample(
    frames: Frames, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    planted = SIGNAL.format("ESC_Dynamics.YawRate", "sign: -1")
    report = checked(frames, replacing(": ESC_Dynamics.YawRate", f": {planted}"))
    (row,) = (r for r in report["quantities"] if r["quantity"] == "yaw_rate")
    print_report(report)
    (line,) = (x for x in capsys.readouterr().out.splitlines() if x.startswith("yaw_rate "))
    for end, other in (("min", "max"), ("max", "min")):
        assert f"{row['in_unit'][end]:.3g} = {row['in_si'][other]:.3g}" in line


def test_a_narrow_table_keeps_the_names_of_quantities_and_breaks_sources_at_their_dot(
    frames: Frames, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a pipe too, if COLUMNS is set."""
    monkeypatch.setenv("COLUMNS", "80")
    print_report(checked(frames))
    lines = capsys.readouterr().out.splitlines()
    assert any(x.startswith("steering_wheel_angle ") for x in lines)
    (at,) = (i for i, x in enumerate(lines) if x.startswith("accelerometer.x "))
    assert lines[at].split()[1] == "IMU_Accel."
    assert lines[at + 1].split()[0] == "AccelX"
    assert not any(". =" in x for x in lines)


def test_rejected_samples_stand_apart_from_the_name_of_their_signal(
    frames: Frames, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    planted = SIGNAL.format("ESC_Dynamics.YawRate", "range: [-5, 5]")
    print_report(checked(frames, replacing(": ESC_Dynamics.YawRate", f": {planted}")))
    (line,) = (x for x in capsys.readouterr().out.splitlines() if x.startswith("yaw_rate "))
    assert re.search(r"ESC_Dynamics\.YawRate \(out_of_range \d+ rejected\) ", line)


def test_frames_that_were_not_used_are_counted(
    frames: Frames, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    report = checked(frames, replacing("id_bytes: 2", "id_bytes: 4"))
    print_report(report)
    first = capsys.readouterr().out.splitlines()[0]
    read, used, left, other = map(
        int, re.findall(r"(\d+) (?:frames|used|of configured|not configured)", first)
    )
    assert read == used + left + other
    assert left == sum(report["frames"]["rejected"].values()) > 0


def texts_of(report: dict[str, Any], level: str) -> list[str]:
    """Texts of all findings of a level."""
    return [f["text"] for f in report["findings"] if f["level"] == level]


# real drives -----------------------------------------------------------------------------------


def real(name: str) -> dict[str, Any]:
    log = DATA / name / "drive.log.gz"
    if not log.exists():
        pytest.skip(f"the real drive {name} is not here")
    check = Check(open_config(ROOT / "benchmarks" / "measured_drives" / f"{name}.yaml"))
    for chunk in LogReader([log], None):
        check.feed(chunk)
    return check.report()


@pytest.mark.slow
def test_css_drive_is_right_handed_and_in_the_right_units() -> None:
    report = real("css_canmod_164")
    assert report["usable"]
    assert findings(report, "error", "warning") == {}
    assert "right-handed" in findings(report, "ok")["accelerometer"]
    rows = {(row["quantity"], row["preference"]): row for row in report["quantities"]}
    assert rows["speed", 0]["in_unit"]["max"] == 88.0
    assert rows["speed", 1]["samples"] > 2000
    assert rows["accelerometer.x", 0]["in_si"]["mean"] == pytest.approx(9.81, abs=0.3)


def test_wrx_drive_has_the_signs_that_its_configuration_states() -> None:
    report = real("wrx_sti")
    assert findings(report, "error", "warning") == {}
    assert "wheel_speeds" in findings(report, "ok")["yaw_rate"]
    rows = {row["quantity"]: row for row in report["quantities"]}
    assert rows["steering_wheel_angle"]["in_si"]["max"] == pytest.approx(math.radians(457.3), 1e-3)


def test_a_sensor_that_sticks_within_the_log_is_reported(frames: Frames) -> None:
    unprotected = EXAMPLE.read_text().partition("  IMU_Accel:\n")[0]
    check = Check(parse_config(unprotected + "  ESC_Speed: {}\n", EXAMPLE))
    for chunk in frames:
        late = (chunk.can_id == 0x200) & (chunk.t - frames[0].t[0] > 150.0)
        data = chunk.data.copy()
        data[late, 2:4] = 7  # the y axis
        check.feed(replace(chunk, data=data))
    text = findings(check.report(), "warning")["accelerometer"]
    assert "y repeats one value (stuck, from 15" in text


def edited(channel: str, axis: int | None, value: float) -> Frames:
    """The drive with a channel, or an axis of it, that says the same all the time."""
    drive = simulate(random_model(6, standing_first=True), 6, MINUTES)
    series = drive.samples[channel]
    values = series.values.copy()
    values[..., slice(None) if axis is None else axis] = value
    samples = {**drive.samples, channel: Series(series.t, values)}
    return list(
        bus_frames(dataclasses.replace(drive, samples=samples), BusEncoder(example_config()))
    )


def test_a_speed_that_never_changes_cannot_be_used() -> None:
    report = checked(edited("speed", None, 13.0))
    assert not report["usable"]
    assert "13.00 m/s in the whole log" in findings(report, "error")["speed"]


def steady(speed: float, accel_unit: float, noise: float, seconds: float = 90.0) -> Frames:
    """A straight level road, or a parking place, and a sensor that lies level; no noise: coarse."""
    drive = simulate(random_model(6, standing_first=True), 6, MINUTES)
    rng = np.random.default_rng(0)
    samples = {}
    for channel, series in drive.samples.items():
        t = series.t[series.t < seconds]
        values = np.zeros((len(t), *series.values.shape[1:]))
        if channel == "accel":
            values += [0.0, 0.0, 9.81]
            values += noise * rng.standard_normal(values.shape)
            values[:, 2] += 0.05 * rng.standard_normal(len(t))
            values *= accel_unit
        elif channel == "speed":
            values += speed
        elif channel == "gyro":
            values += 0.001 * rng.standard_normal(values.shape)
        samples[channel] = Series(t, values)
    return list(
        bus_frames(dataclasses.replace(drive, samples=samples), BusEncoder(example_config()))
    )


def test_a_cruise_in_whole_kilometres_per_hour_is_a_warning_at_most() -> None:
    """70 s at 100 km/h as OBD-II sends it: the accelerometer shows no change either."""
    report = checked(steady(100.0 / 3.6, 1.0, noise=0.3, seconds=75.0))
    assert "speed" not in findings(report, "error")
    assert "in the whole log" in findings(report, "warning")["speed"]


def test_a_coarse_sensor_in_a_parked_vehicle_is_still_held_against_gravity() -> None:
    """Two axes say the same all the time, and the third shows half of gravity."""
    report = checked(steady(0.0, 0.51, noise=0.0))
    found = findings(report, "error")
    assert "unit" in found["accelerometer"], found
    assert "never changes" in findings(report, "warning")["accelerometer.x"]


@pytest.mark.parametrize(
    ("channel", "axis", "quantity"),
    [("accel", 0, "accelerometer.x"), ("accel", 2, "accelerometer.z"), ("gyro", 2, "gyroscope.z")],
)
def test_a_dead_axis_is_the_error_and_no_other_signal_is_blamed(
    channel: str, axis: int, quantity: str
) -> None:
    report = checked(edited(channel, axis, 0.0))
    assert not report["usable"]
    found = findings(report, "error")
    assert set(found) == {quantity}
    assert "never changes" in found[quantity]
