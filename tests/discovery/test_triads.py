"""Which three signals are an accelerometer, by the size of their vector alone."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.can.columns import FrameColumns, concatenate
from imucald.can.dbc.database import load_database_text
from imucald.discovery import GatheredFrames
from imucald.discovery.candidates import candidates_of, messages_in
from imucald.discovery.triads import Triad, accelerometers

DATABASE = """VERSION ""
BS_:
BU_: A B
BO_ 256 Box: 6 A
 SG_ One : 0|16@1- (0.001,0) [-32|32] "{unit}" B
 SG_ Two : 16|16@1- (0.001,0) [-32|32] "{unit}" B
 SG_ Three : 32|16@1- (0.001,0) [-32|32] "{unit}" B
"""
RATE = 20.0
RACING_G = 0.9
"""Amplitude of braking and turning; the vector's size spreads by some 15 % then."""


def triads_of(force_g: np.ndarray, unit: str) -> list[Triad]:
    """What is found in a log of one message that holds a vector (n, 3) [g]."""
    n = len(force_g)
    raw = np.round(force_g / 0.001).astype("<i2").view(np.uint8).reshape(n, 6)
    frames = FrameColumns(
        np.arange(n) / RATE, np.full(n, 256, np.uint32), np.full(n, 6, np.uint8),
        np.pad(raw, ((0, 0), (0, 2))), np.zeros(n, np.uint8), ("can0",),
    )  # fmt: skip
    database = load_database_text(DATABASE.format(unit=unit), "dbc")
    (message,) = messages_in(database, GatheredFrames.from_chunks([frames]).traffic(), None)
    return accelerometers(candidates_of(message, int(n / RATE * 10.0)))


def racing(down_g: float) -> np.ndarray:
    """Four minutes on a track (n, 3) [g]: braking and turning by turns, gravity on the third."""
    t = np.arange(0.0, 240.0, 1.0 / RATE)
    along = RACING_G * np.clip(np.sin(2 * np.pi * t / 11.0), -1.0, 0.3)
    across = RACING_G * np.sin(2 * np.pi * t / 17.0) ** 3
    bumps = 0.05 * np.random.default_rng(1).standard_normal(len(t))
    return np.stack([along, across, down_g + bumps], axis=1)


def test_a_sensor_in_a_car_that_is_driven_hard_is_found_by_its_calm_part():
    (triad,) = triads_of(racing(-1.0), "g")
    assert triad.unit.name == "g"
    assert triad.spread > 0.05
    assert triad.size == pytest.approx(9.81, rel=0.08)


@pytest.mark.parametrize(("down_g", "unit"), [(0.0, "g"), (-1.0, ""), (-0.7, "g")])
def test_without_gravity_or_a_stated_unit_three_accelerations_are_no_sensor(down_g, unit):
    assert triads_of(racing(down_g), unit) == []


TWO_RATES = """VERSION ""
BS_:
BU_: A B
BO_ 256 First: 4 A
 SG_ {}X : 0|16@1- (0.001,0) [-32|32] "g" B
 SG_ {}Z : 16|16@1- (0.001,0) [-32|32] "g" B
BO_ 257 Second: 4 A
 SG_ {}Y : 0|16@1- (0.001,0) [-32|32] "g" B
"""


@pytest.mark.parametrize(("names", "found"), [(("Acc",) * 3, 1), (("P", "Q", "R"), 0)])
def test_axes_that_come_at_two_rates_are_a_sensor_where_their_names_say_so(names, found):
    n = 2000
    force = np.array([0.3, 0.2, 0.93]) + np.random.default_rng(5).normal(0.0, 0.01, (n, 3))
    raw = np.round(force / 0.001).astype("<i2")
    parts = []
    for can_id, axes, step in ((256, [0, 2], 1), (257, [1, 0], 2)):
        t = np.arange(0, n, step)
        data = np.ascontiguousarray(raw[t][:, axes]).view(np.uint8).reshape(len(t), 4)
        ids, length = np.full(len(t), can_id, np.uint32), np.full(len(t), 4, np.uint8)
        channel = np.zeros(len(t), np.uint8)
        padded = np.pad(data, ((0, 0), (0, 4)))
        parts.append(FrameColumns(t / RATE, ids, length, padded, channel, ("can0",)))
    whole = concatenate(parts)
    frames = GatheredFrames.from_chunks([whole.take(np.argsort(whole.t, kind="stable"))])
    database = load_database_text(TWO_RATES.format(*names), "dbc")
    candidates = [
        candidate
        for message in messages_in(database, frames.traffic(), None)
        for candidate in candidates_of(message, int(n / RATE * 10.0))
    ]
    assert len(accelerometers(candidates)) == found
