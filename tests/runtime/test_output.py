"""Output frames: as cantools decodes them, protected as an independent CRC says, never false."""

from __future__ import annotations

import itertools
import math
from importlib import resources

import cantools.database
import numpy as np
import pytest
from crccheck.crc import Crc8SaeJ1850
from scipy.spatial.transform import Rotation

from engine_bus import (
    CONFIGS,
    RICH,
    ScriptedEstimator,
    Sender,
    columns_of,
    engine_of,
    frames_of,
    load,
)
from imucald.can.columns import CAN_EFF_FLAG
from imucald.mount.estimate import (
    Correction,
    Missing,
    MountEstimate,
    MountState,
    SentDeviations,
)
from imucald.runtime.output.output_frames import Health, OutputFrames, output_database

CYCLE = 0.01


@pytest.fixture(scope="module")
def out_dbc():
    text = (resources.files("imucald") / "data" / "imucald_out.dbc").read_text("utf-8")
    return cantools.database.load_string(text, "dbc")


@pytest.fixture
def loaded(tmp_path):
    return load(RICH, tmp_path)


def decoded(out_dbc, name, frames, can_id=None):
    """Physical values of the frames of one message, with `None` for a value not available."""
    message = out_dbc.get_message_by_name(name)
    wanted = message.frame_id if can_id is None else can_id
    result = []
    for found, data in frames:
        if found != wanted:
            continue
        raw = message.decode(data, decode_choices=False, scaling=False)
        values = message.decode(data, decode_choices=False)
        for signal in message.signals:
            if signal.length == 16 and signal.name not in ("RejectedCount",):
                absent = -32768 if signal.is_signed else 65535
                if raw[signal.name] == absent:
                    values[signal.name] = None
            elif signal.name.startswith("Deviation") and raw[signal.name] == 4095:
                values[signal.name] = None
        result.append(values)
    return result


def driven(engine, loaded, seconds=1.0):
    """Frames of half a second without and then with a correction (see ScriptedEstimator)."""
    sender = Sender(loaded)
    frames = []
    for k in range(round(seconds / CYCLE)):
        t = k * CYCLE
        frames.append(sender.frame(t, "ACC", AX=1.0, AY=-2.0, AZ=9.0))
        frames.append(sender.frame(t, "GYR", GX=10.0, GY=-20.0, GZ=30.0))
        frames.append(sender.frame(t, "MAG", MX=20.0, MY=-30.0, MZ=40.0))
        frames.append(sender.frame(t, "PAR", PX=1.0, PY=2.0, PZ=3.0))
    return [out for frame in frames for out in engine.frame(*frame)]


def test_values_are_absent_unless_the_state_has_a_quality_and_else_the_turned_ones(loaded, out_dbc):
    engine = engine_of(loaded)
    out = driven(engine, loaded)
    for name, signals, given in (
        ("IMUCALD_Acceleration", "AccelX AccelY AccelZ", [1.0, -2.0, 9.0]),
        ("IMUCALD_AngularRate", "RateX RateY RateZ", [10.0, 20.0, 30.25]),
        ("IMUCALD_MagneticField", "FieldX FieldY FieldZ", [20.0, -30.0, 40.0]),
    ):
        message = out_dbc.get_message_by_name(name)
        step = message.get_signal_by_name(signals.split()[0]).scale
        rows = decoded(out_dbc, name, out)
        assert len(rows) == 100
        for k, row in enumerate(rows):
            values = [row[s] for s in signals.split()]
            tick = math.floor(k * CYCLE * 10 + 1e-9)
            quality = {2: 2, 3: 3, 4: 4, 5: 4}.get(tick % 6, 0)
            if tick < engine.pipeline.estimator.usable_from or not quality:
                assert values == [None] * 3
                assert row["Quality"] == 0
            else:
                rotation = rotation_at(tick)
                assert values == pytest.approx(rotation @ given, abs=0.51 * float(step))
                assert row["Quality"] == quality


def rotation_at(tick):
    return ScriptedEstimator(steps=tick)._rotation()


def test_a_parallel_sensor_goes_out_under_its_own_29_bit_id(loaded, out_dbc):
    out = driven(engine_of(loaded), loaded)
    rows = decoded(out_dbc, "IMUCALD_Acceleration", out, 0x1ABCDE | CAN_EFF_FLAG)
    assert len(rows) == 100
    expected = rotation_at(5) @ [1.0, 2.0, 3.0]
    assert [rows[55][f"Accel{a}"] for a in "XYZ"] == pytest.approx(expected, abs=0.00101)


class TurnedEstimator(ScriptedEstimator):
    """Sure of one angle about the vertical."""

    correction = Correction.turning(Rotation.from_euler("z", 2.1).as_matrix())
    state = MountState.FINE


def test_a_level_parallel_sensor_of_two_axes_is_turned_and_has_no_z(tmp_path, out_dbc):
    """Claim 5 of method A: L'x = Lx cos - Ly sin, L'y = Lx sin + Ly cos."""
    loaded = load(CONFIGS["planar"], tmp_path)
    L = np.random.default_rng(5).integers(-90, 90, (50, 2))
    sender = Sender(loaded)
    frames = [sender.frame(0.01 * k, "GYR", GX=x, GY=y, GZ=5.0) for k, (x, y) in enumerate(L)]
    engine = engine_of(loaded, TurnedEstimator())
    live = [one for frame in frames for one in engine.frame(*frame)]
    assert frames_of(engine_of(loaded, TurnedEstimator()).columns(columns_of(frames))) == live
    sent = decoded(out_dbc, "IMUCALD_AngularRate", live, 0x700)
    assert [row["RateZ"] for row in sent] == [None] * 50
    assert {row["Quality"] for row in sent} == {3}
    x, y = L.T
    c, s = math.cos(2.1), math.sin(2.1)
    step = out_dbc.get_message_by_name("IMUCALD_AngularRate").get_signal_by_name("RateX").scale
    assert [row["RateX"] for row in sent] == pytest.approx(x * c - y * s, abs=0.51 * step)
    assert [row["RateY"] for row in sent] == pytest.approx(x * s + y * c, abs=0.51 * step)


def test_every_frame_is_protected_as_an_independent_crc_says(loaded):
    last: dict[int, int] = {}
    seen = set()
    for can_id, data in driven(engine_of(loaded), loaded, 4.0):
        wide = 4 if can_id & CAN_EFF_FLAG else 2
        identifier = (can_id & 0x1FFFFFFF).to_bytes(wide, "big")
        assert data[7] == Crc8SaeJ1850.calc(identifier + data[:7])
        counter = data[6] >> 4
        assert counter == (last[can_id] + 1) % 16 if can_id in last else counter == 0
        last[can_id] = counter
        seen.add(can_id)
    assert len(seen) == 9


@pytest.mark.parametrize(("kind", "check"), [("xor", True), ("none", False)])
def test_other_checksums(kind, check, tmp_path):
    loaded = load(RICH.replace("{status_rate: 5}", f"{{checksum: {kind}}}"), tmp_path)
    for can_id, data in driven(engine_of(loaded), loaded):
        total = 0
        wide = 4 if can_id & CAN_EFF_FLAG else 2
        for byte in (can_id & 0x1FFFFFFF).to_bytes(wide, "big") + data[:7]:
            total ^= byte
        assert data[7] == (total if check else 0)


def test_a_rejected_sample_is_sent_as_not_available(loaded, out_dbc):
    engine = engine_of(loaded)
    driven(engine, loaded)
    sender = Sender()
    rejected = [
        (1.0, 0x100, b"\x00"),  # short
        sender.frame(1.0, "GYR", GX=1.0, GY=1.0, GZ=1.0),  # its counter begins anew
    ]
    out = [f for frame in rejected for f in engine.frame(*frame)]
    accel = decoded(out_dbc, "IMUCALD_Acceleration", out)
    assert [accel[0][f"Accel{a}"] for a in "XYZ"] == [None] * 3
    assert accel[0]["Quality"] == 0
    rate = decoded(out_dbc, "IMUCALD_AngularRate", out)
    assert [rate[0][f"Rate{a}"] for a in "XYZ"] == [None] * 3
    assert engine.router.rejected == {"short_frame": 1, "counter_reversed": 1}


def test_a_value_beyond_the_signal_is_not_available_never_clipped(loaded, out_dbc):
    output = OutputFrames(loaded.config)
    _, data = output.corrected("accel", (65.5361, -65.536, 65.5335), 2)
    row = decoded(out_dbc, "IMUCALD_Acceleration", [(0x640, data)])[0]
    assert [row["AccelX"], row["AccelY"]] == [None, None]
    assert row["AccelZ"] == pytest.approx(65.534)
    _, data = output.corrected("gyro", (math.nan, math.radians(400.0), math.radians(1.0)), 2)
    row = decoded(out_dbc, "IMUCALD_AngularRate", [(0x641, data)])[0]
    assert [row["RateX"], row["RateY"], row["RateZ"]] == [None, None, pytest.approx(1.0)]


def status(loaded, estimate, usable, health, out_dbc):
    frames = OutputFrames(loaded.config).status(estimate, usable, health)
    names = ("IMUCALD_Mount", "IMUCALD_MountDeviation", "IMUCALD_Health")
    return [decoded(out_dbc, name, frames)[0] for name in names]


def test_status_carries_angles_deviations_and_state(loaded, out_dbc):
    rotation = Rotation.from_euler("ZYX", [120.0, -30.0, 45.0], degrees=True).as_matrix()
    covariance = np.diag(np.radians([0.1, 0.25, 1.5]) ** 2)
    estimate = MountEstimate(MountState.FINE, rotation, covariance)
    mount, deviation, health = status(loaded, estimate, True, Health(rejected=7), out_dbc)
    assert [mount[f"Mount{a}"] for a in ("Roll", "Pitch", "Yaw")] == pytest.approx(
        [45.0, -30.0, 120.0], abs=0.0051
    )
    assert [deviation[f"Deviation{a}"] for a in "XYZ"] == pytest.approx(
        [0.1, 0.25, 1.5], abs=0.0026
    )
    assert mount["State"] == deviation["State"] == health["State"] == 3
    assert [health[f"Waiting{a}"] for a in ("Roll", "Pitch", "Yaw")] == [0, 0, 0]
    assert (health["RejectedCount"], health["LostCount"]) == (7, 0)


CROSS_TALK = ("XY", "YX", "ZX", "ZY")
ZERO = ("ZeroX", "ZeroY", "RateXZ", "RateYZ")


def sent_deviations(loaded, estimate, usable, out_dbc):
    """The eight deviations of what is sent, and the states that come with them."""
    frames = OutputFrames(loaded.config).status(estimate, usable, Health())
    force = decoded(out_dbc, "IMUCALD_CrossTalkDeviation", frames)[0]
    zero = decoded(out_dbc, "IMUCALD_ZeroDeviation", frames)[0]
    values = [force[f"Deviation{e}"] for e in CROSS_TALK]
    return values + [zero[f"Deviation{e}"] for e in ZERO], {force["State"], zero["State"]}


def test_status_carries_the_deviations_of_what_is_sent(loaded, out_dbc):
    degrees = np.radians([0.1, 0.25, 1.5, 3.0])
    deviations = SentDeviations(*degrees, 0.1234, 0.056, *np.radians([0.7, 0.04]))
    estimate = MountEstimate(MountState.FINE, np.eye(3), np.eye(3), deviations=deviations)
    values, states = sent_deviations(loaded, estimate, True, out_dbc)
    assert values[:4] == pytest.approx([0.1, 0.25, 1.5, 3.0], abs=0.0026)
    assert values[4:6] == pytest.approx([0.1234, 0.056], abs=0.00051)
    assert values[6:] == pytest.approx([0.7, 0.04], abs=0.0026)
    assert states == {3}
    assert sent_deviations(loaded, estimate, False, out_dbc)[0] == [None] * 8


def test_of_a_rotation_alone_they_are_what_a_turn_of_the_housing_leaves(loaded, out_dbc):
    """E of a rotation that is off by one deviation about each axis in turn."""
    std = np.radians([0.9, 0.4, 0.2])
    left = []
    for axis in range(3):
        off = Rotation.from_rotvec(std * np.eye(3)[axis]).as_matrix() - np.eye(3)
        level = off @ [0.0, 0.0, 9.80665]
        force = [off[0, 1], off[1, 0], off[2, 0], off[2, 1]]
        left.append([*np.degrees(force), *level[:2], *np.degrees([off[0, 2], off[1, 2]])])
    expected = np.sqrt(np.sum(np.square(left), axis=0))
    estimate = MountEstimate(MountState.USABLE, np.eye(3), np.diag(std**2))
    values, _ = sent_deviations(loaded, estimate, True, out_dbc)
    assert values == pytest.approx(expected, abs=0.006)


def test_deviations_beyond_the_frame_and_unknown_ones(loaded, out_dbc):
    wide = MountEstimate(MountState.USABLE, np.eye(3), np.eye(3) * 100.0)
    assert sent_deviations(loaded, wide, True, out_dbc)[0] == pytest.approx(
        [20.47] * 4 + [4.094] * 2 + [20.47] * 2
    )
    unknown = MountEstimate(MountState.USABLE, np.eye(3))
    assert sent_deviations(loaded, unknown, True, out_dbc)[0] == [None] * 8


def test_what_readers_of_the_first_database_know_stands_where_it_did(loaded):
    """Of version 1: the bits of the frames that it had."""
    frames = OutputFrames(loaded.config).status(
        MountEstimate(MountState.FINE, np.eye(3), np.eye(3) * 1e-4), True, Health()
    )
    by_id = dict(frames)
    assert [can_id for can_id, _ in frames] == [0x643, 0x644, 0x64D, 0x64E, 0x645]
    deviation = int.from_bytes(by_id[0x644], "little")
    raw = [deviation >> shift & 0xFFFF for shift in (0, 16, 32)]
    assert raw == pytest.approx([np.degrees(0.01) / 0.005] * 3, abs=0.51)
    assert deviation >> 48 & 0xF == 3


def test_status_without_an_estimate_says_what_is_waited_for(loaded, out_dbc):
    estimate = MountEstimate(
        MountState.LEVELLED,
        np.eye(3),
        np.eye(3),
        waiting_for={"yaw": "left turns", "roll": "something"},
        missing={"yaw": Missing.LEFT_TURN},
    )
    mount, deviation, health = status(loaded, estimate, False, Health(), out_dbc)
    assert [mount[f"Mount{a}"] for a in ("Roll", "Pitch", "Yaw")] == [None] * 3
    assert [deviation[f"Deviation{a}"] for a in "XYZ"] == [None] * 3
    assert health["WaitingYaw"] == 3
    assert health["WaitingRoll"] == 15
    assert health["WaitingPitch"] == 0


FLAGS = {
    "accelerometer_missing": "AccelerometerMissing",
    "gyroscope_missing": "GyroscopeMissing",
    "speed_missing": "SpeedMissing",
    "input_rejected": "InputRejected",
    "frames_lost": "FramesLost",
    "id_conflict": "IdConflict",
    "send_failed": "SendFailed",
}


@pytest.mark.parametrize("flag", sorted(FLAGS))
def test_each_flag_of_the_health_frame_is_where_the_database_says(flag, loaded, out_dbc):
    health = status(
        loaded, MountEstimate(MountState.WAITING), False, Health(**{flag: True}), out_dbc
    )
    assert [name for name in FLAGS.values() if health[2][name]] == [FLAGS[flag]]


def test_counts_and_deviations_stop_at_their_ends(loaded, out_dbc):
    estimate = MountEstimate(MountState.USABLE, np.eye(3), np.eye(3) * 100.0)
    _, deviation, health = status(
        loaded, estimate, True, Health(rejected=10**9, lost=10**9), out_dbc
    )
    assert health["RejectedCount"] == 65534
    assert health["LostCount"] == 4094
    assert deviation["DeviationX"] == pytest.approx(327.67, abs=0.006)


def test_health_in_a_drive_shows_missing_and_rejected_input(loaded, out_dbc):
    engine, sender = engine_of(loaded), Sender(loaded)
    out = [
        f
        for k in range(150)
        for f in engine.frame(*sender.frame(0.01 * k, "ACC", AX=0, AY=0, AZ=9.8))
    ]
    out += engine.frame(1.5, 0x170, b"")
    out += [
        f
        for k in range(151, 700)
        for f in engine.frame(*sender.frame(0.01 * k, "ACC", AX=0, AY=0, AZ=9.8))
    ]
    health = decoded(out_dbc, "IMUCALD_Health", out)
    assert len(health) == 34  # 5 a second
    rejected = [h["InputRejected"] for h in health]
    assert sum(rejected) == 5  # for one second
    assert [h["RejectedCount"] for h in health] == sorted(h["RejectedCount"] for h in health)
    assert health[-1]["RejectedCount"] == 1
    assert [h["AccelerometerMissing"] for h in health] == [0] * 34
    assert [h["SpeedMissing"] for h in health] == [0] * 5 + [1] * 29


def test_columns_and_single_samples_are_the_same_bytes(loaded):
    rng = np.random.default_rng(3)
    values = rng.normal(0.0, 40.0, (500, 3))
    values[rng.random((500, 3)) < 0.1] = np.nan
    quality = rng.integers(0, 5, 500).astype(np.uint8)
    single, columns = OutputFrames(loaded.config), OutputFrames(loaded.config)
    expected = [
        single.corrected("accel", v, int(q))[1] for v, q in zip(values, quality, strict=True)
    ]
    parts = [columns.corrected_columns("accel", values[i:j], quality[i:j])[1]
             for i, j in itertools.pairwise([0, 1, 3, 250, 500])]  # fmt: skip
    assert [row.tobytes() for part in parts for row in part] == expected


def test_the_shipped_database_says_all_that_a_receiver_needs(out_dbc):
    ids = {m.name: m.frame_id for m in out_dbc.messages}
    assert sorted(ids.values()) == list(range(0x640, 0x64F))
    for message in out_dbc.messages:
        assert message.length == 8
        assert message.comment
        assert {"Counter", "Checksum"} < {s.name for s in message.signals}
        state = next(s for s in message.signals if s.name in ("Quality", "State"))
        assert state.choices
    for name, start in (
        ("AccelX", -32768),
        ("MountYaw", -32768),
        ("DeviationZ", 65535),
        ("DeviationXY", 4095),
    ):
        signal = next(s for m in out_dbc.messages for s in m.signals if s.name == name)
        assert signal.raw_initial == start
    assert output_database().message("IMUCALD_Mount").cycle_time == 1.0
