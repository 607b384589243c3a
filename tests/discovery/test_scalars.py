"""A single signal that follows the motion: one that measures it, not a switch that goes with it."""

from __future__ import annotations

import numpy as np
import pytest

from imucald.can.dbc.database import load_database
from imucald.discovery.candidates import SeenSignal
from imucald.discovery.scalars import LONGITUDINAL, find_scalar
from paths import ROOT

DATABASE = load_database(ROOT / "dbc" / "imucald_example.dbc")
N = 6000


def seen(x: np.ndarray, levels: tuple[float, ...]) -> SeenSignal:
    """A signal without unit, whatever its message: values x (n,) on ticks."""
    message, signal = next(
        (message, signal)
        for message in DATABASE.messages.values()
        for signal in message.signals.values()
        if not signal.unit.strip()
    )
    return SeenSignal(
        message, signal, "can0", x, x, 0.02, levels, x if levels else None, (),
        float(x.min()), float(x.max()),
    )  # fmt: skip


@pytest.fixture
def change_of_speed() -> np.ndarray:
    """Stops in a city [m/s^2]: of 60 s some 15 s braking, the rest small changes."""
    rng = np.random.default_rng(3)
    t = np.arange(N) * 0.1
    braking = np.where((t % 60.0) < 15.0, -1.1, 0.0)
    return braking + 0.2 * np.sin(t / 3.0) + 0.05 * rng.standard_normal(N)


def test_a_brake_switch_is_no_longitudinal_acceleration(change_of_speed: np.ndarray) -> None:
    pressed = (change_of_speed < -0.5).astype(float)
    assert np.corrcoef(pressed, change_of_speed)[0, 1] < -0.8
    assert (
        find_scalar(LONGITUDINAL, change_of_speed, [seen(pressed, (0.0, 1.0))], shows_left=False)
        is None
    )


def test_a_coarse_acceleration_is_one(change_of_speed: np.ndarray) -> None:
    coarse = np.round(4.0 * change_of_speed) / 4.0
    levels = tuple(np.unique(coarse).tolist())
    assert 2 < len(levels) < 16
    found = find_scalar(LONGITUDINAL, change_of_speed, [seen(coarse, levels)], shows_left=False)
    assert found is not None
    assert found.sources[""].sign == 1
