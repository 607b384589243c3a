"""The judge of signal forms: what it writes is the form, and what it says follows from the runs."""

from __future__ import annotations

from pathlib import Path

import cantools
import numpy as np
import pytest
from benchmarks.signal_forms.bus import Bus, Layout
from benchmarks.signal_forms.drives import Put, any_mount, base_of
from benchmarks.signal_forms.forms import FORMS, Form
from benchmarks.signal_forms.outcome import outcomes
from benchmarks.signal_forms.report import report

SEED = 900_000
MINUTES = 1.0
KMH, DEG = 3.6, np.degrees(1.0)


@pytest.fixture(scope="module")
def base():
    return base_of(Put(str(SEED), "simulated", minutes=MINUTES), {})


def form(name: str) -> Form:
    return next(form for form in FORMS if form.name == name)


def written(base, name: str, folder: Path) -> tuple[Bus, list[tuple[float, str, dict]]]:
    """The frames of a form, decoded by cantools: time, message, values."""
    chosen, rng = form(name), np.random.default_rng(1)
    samples = {c: s for c, s in base.samples.items() if c not in chosen.without}
    samples = chosen.samples(samples, rng)
    bus = Bus(chosen.layout, samples, "right", folder)
    frames = chosen.frames(bus.frames(samples), rng)
    database = cantools.database.load_file(folder / "bus.dbc")
    names = {message.frame_id: message.name for message in database.messages}
    found = [
        (t, names[can_id], database.decode_message(can_id, data))
        for t, can_id, data in frames.rows()
        if can_id in names
    ]
    return bus, found


def values(found, message: str, signal: str) -> np.ndarray:
    return np.array([v[signal] for _, name, v in found if name == message and signal in v])


def test_a_coarse_speed_is_written_in_its_steps(base, tmp_path):
    _, found = written(base, "speed 1 km/h, 50 Hz", tmp_path)
    speed = values(found, "ESC_Speed", "VehicleSpeed")
    assert np.array_equal(speed, np.rint(speed))
    assert np.abs(speed - KMH * base.samples["speed"].values).max() <= 0.5 + 1e-9
    assert not any(name == "ESC_WheelSpeeds" for _, name, _ in found)


def test_magnitude_and_sign_bit_make_the_signal(base, tmp_path):
    _, found = written(base, "sign bits, no gyroscope", tmp_path)
    size = values(found, "ESC_Dynamics", "YawRate")
    sign = values(found, "ESC_Dynamics", "YawRateSign")
    true = DEG * base.samples["yaw_rate"].values
    assert size.min() >= 0.0
    assert 0 < sign.sum() < len(sign)
    assert np.abs(np.where(sign == 1, -size, size) - true).max() <= 0.005 + 1e-9


def test_axes_that_take_turns_each_come_in_a_third_of_the_frames(base, tmp_path):
    _, found = written(base, "one axis a frame", tmp_path)
    accel = base.samples["accel"].values
    for i, axis in enumerate("XYZ"):
        one = values(found, "IMU_Axis", f"Accel{axis}")
        assert np.abs(one - accel[i::3, i]).max() <= 0.001 + 1e-9


def test_lost_frames_leave_holes_in_the_counters(base, tmp_path):
    _, found = written(base, "10 % lost, counters", tmp_path)
    counter = values(found, "IMU_Accel", "IMU_Accel_AC")
    steps = np.diff(counter) % 16
    assert 0.08 < np.mean(steps != 1) < 0.12
    assert steps.max() < 8


def test_stamps_are_those_of_the_burst(base, tmp_path):
    _, found = written(base, "stamps of 0.2 s", tmp_path)
    t = np.unique([t for t, _, _ in found])
    assert np.allclose(np.diff(t), 0.2)


@pytest.mark.parametrize("chosen", FORMS, ids=lambda one: one.name)
def test_every_form_has_a_bus_that_cantools_loads(base, chosen, tmp_path):
    samples = {c: s for c, s in base.samples.items() if c not in chosen.without}
    samples = chosen.samples(samples, np.random.default_rng(1))
    frames = Bus(chosen.layout, samples, "right", tmp_path).frames(samples)
    assert len(frames)
    cantools.database.load_file(tmp_path / "bus.dbc")


def test_a_plain_bus_states_the_cycles(base, tmp_path):
    Bus(Layout(), base.samples, "right", tmp_path).frames(base.samples)
    database = cantools.database.load_file(tmp_path / "bus.dbc")
    assert database.get_message_by_name("IMU_Accel").cycle_time == 10


def test_mounts_are_drawn_from_all_rotations():
    drawn = np.array([list(any_mount(seed).values()) for seed in range(200)])
    assert (np.abs(drawn[:, 0]) > 90.0).mean() > 0.35
    assert (np.abs(drawn[:, 1]) > 30.0).mean() > 0.35


def line(name: str, **changed):
    """A sound run of a form, with something changed."""
    said = {"end": {"error": [0.1, 0.1, 0.1], "std": [0.2, 0.2, 0.2]}}
    sound = {
        "form": name, "drive": "1", "group": "simulated", "twin_usable_s": 100.0, "usable_s": 120.0,
        "said": said, "driving_s": 800.0, "not_learnt_s": 0.0, "named_s": 0.0,
    }  # fmt: skip
    return {**sound, **changed}


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"usable_s": None}, "usable 0/1"),
        ({"usable_s": 151.0}, "within 1.5x 0/1"),
        ({"bad": {"suspect": 30.0}}, "suspect in 1"),
        ({"moves": [{"t": 30.0}]}, "moved in 1"),
        ({"not_learnt_s": 50.0, "named_s": 50.0}, "not learnt 6 %"),
        ({"not_learnt_s": 30.0}, "not named in 1"),
        ({"said": {"end": {"error": [0.5, 0.1, 0.1], "std": [0.2] * 3}}}, "95 % holds in 67 %"),
        ({"refused": "car.yaml:1"}, "refused in 1"),
        ({"check": {"usable": False, "texts": ["error"]}}, "check says error in 1"),
    ],
)
def test_a_bar_that_is_missed_is_named(changed, text):
    said, is_met = report([line("jitter 20 ms", **changed)])
    assert text in said
    assert not is_met


def test_a_sound_run_meets_every_bar_of_its_form():
    assert report([line("jitter 20 ms")])[0].splitlines()[1].endswith("OK")


@pytest.mark.parametrize(
    ("texts", "text"),
    [
        ([], 'check says no "lost" in 1'),
        (["warning: bus: look at the cable"], 'check says no "lost" in 1'),
        (["warning: bus: 5 % of the frames are lost"], "OK"),
    ],
)
def test_a_form_of_a_poor_recording_asks_check_to_say_so(texts, text):
    check = {"usable": True, "texts": texts}
    told = line("5 % lost, counters", check=check)
    assert report([told])[0].splitlines()[1].endswith(text)


@pytest.mark.slow
def test_two_forms_on_a_short_drive_are_judged_through_the_whole_product():
    names = ("IMU 100 Hz", "stamps of 1 s")
    put = Put(str(SEED), "simulated", minutes=3.0)
    fine, coarse = outcomes((put, names, False))
    assert fine["usable_s"] == fine["twin_usable_s"] is not None
    assert fine["not_learnt_s"] < 0.05 * fine["driving_s"]
    assert fine["said"]["end"]["error"] is not None
    assert coarse["usable_s"] is not None
    assert coarse["frames"] == fine["frames"]
