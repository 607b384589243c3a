from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imucald.core.rotations import levelling_rotation
from imucald.mount.method_a.levelling import LongRunLevel, StopBook

G = 9.80665
DEG = math.radians(1.0)
ANGLE = st.floats(-math.pi, math.pi)


@pytest.mark.slow
@given(ANGLE, ANGLE, ANGLE, st.floats(5.0, 15.0))
def test_levelling_is_exact_for_any_mount(yaw: float, pitch: float, roll: float, g: float) -> None:
    mount = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    up = mount.inv().apply([0.0, 0.0, 1.0])
    assume(up[2] > -1.0 + 1e-6)
    R = np.array([g * up, mount.inv().apply([3.0, 4.0, g])]) @ levelling_rotation(g * up).T
    assert R[0] == pytest.approx([0.0, 0.0, g], abs=1e-9)
    # What was horizontal stays horizontal, at its size; only its direction is still open.
    assert math.hypot(R[1][0], R[1][1]) == pytest.approx(5.0, abs=1e-7)
    assert R[1][2] == pytest.approx(g, abs=1e-7)


def slope(pitch_deg: float, roll_deg: float) -> tuple[float, float, float]:
    x, y, z = Rotation.from_euler("YX", [pitch_deg, roll_deg], degrees=True).inv().apply([0, 0, G])
    return float(x), float(y), float(z)


def tilt_error_deg(up: tuple[float, float, float]) -> float:
    return math.degrees(math.asin(math.hypot(up[0], up[1])))


def test_windows_of_one_stop_are_one_place() -> None:
    book = StopBook(1.3 * DEG, 0.1)
    for k in range(30):
        book.add_static_window(slope(2.0, 0.0), 100.0, new_place=k == 0)
    tilt = book.tilt()
    assert tilt is not None
    assert (book.seen, tilt.places) == (1, 1)
    assert tilt_error_deg(tilt.up) == pytest.approx(2.0, abs=1e-6)
    assert tilt.std > 1.2 * DEG, "a long stop says no more about slope than a short one"


def test_several_places_average_the_slope_and_say_so() -> None:
    rng = np.random.default_rng(3)
    book = StopBook(1.3 * DEG, 0.0)
    before = math.inf
    for k in range(16):
        book.add_static_window(slope(*rng.normal(0.0, 1.3, 2)), 100.0, new_place=True)
        tilt = book.tilt()
        assert tilt is not None
        if k in {0, 3, 15}:
            assert tilt.std < 0.7 * before
            before = tilt.std
    assert tilt_error_deg(tilt.up) < 3.0 * math.degrees(tilt.std)
    assert tilt.std == pytest.approx(1.3 * DEG / 4.0, rel=0.4)


def test_no_number_of_stops_averages_the_bias() -> None:
    book = StopBook(1.0 * DEG, 0.1)
    for _ in range(40):
        book.add_static_window((0.0, 0.0, G), 100.0, new_place=True)
    tilt = book.tilt()
    assert tilt is not None
    assert tilt.std > 0.1 / G


def test_one_ramp_among_many_places_counts_little() -> None:
    book = StopBook(1.0 * DEG, 0.0)
    for _ in range(8):
        book.add_static_window(slope(0.0, 0.0), 100.0, new_place=True)
    book.add_static_window(slope(12.0, 0.0), 100.0, new_place=True)
    tilt = book.tilt()
    assert tilt is not None
    assert tilt_error_deg(tilt.up) < 0.8 * 12.0 / 9.0


def test_as_published_the_last_stop_decides() -> None:
    book = StopBook(1.3 * DEG, 0.1, average=False)
    book.add_static_window(slope(3.0, 0.0), 100.0, new_place=True)
    book.add_static_window(slope(0.0, -1.0), 100.0, new_place=True)
    tilt = book.tilt()
    assert tilt is not None
    assert tilt_error_deg(tilt.up) == pytest.approx(1.0, abs=1e-6)


def test_the_mean_of_a_long_drive_levels_and_admits_how_badly() -> None:
    rng = np.random.default_rng(1)
    run = LongRunLevel(1.3 * DEG, 0.1)
    assert run.tilt() is None
    speed = 0.0
    for k in range(3000):
        a = 1.0 if k % 300 < 150 else -1.0
        speed += 0.1 * a
        run.add_mean_force(a + G * 1.3 * DEG * rng.normal(), 0.5 * rng.normal(), G, 0.1)
        if k == 600:
            early = run.tilt()
    late = run.tilt()
    assert early is not None
    assert late is not None
    assert late.std < early.std
    assert tilt_error_deg(late.up) < 2.0 * math.degrees(late.std)
    assert late.std > 0.5 * DEG
