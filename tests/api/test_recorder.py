"""Events of a replay: when a moved sensor was found, and by how much it was turned."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest

from imucald.api import recorder
from imucald.api.columns import Columns
from imucald.api.recorder import Recorder
from imucald.mount.estimate import MountEstimate, MountState
from imucald.runtime.pipeline import Snapshot

NO_FAULTS = SimpleNamespace(
    pipeline=SimpleNamespace(health=SimpleNamespace(summary=lambda: {"events": []}))
)


def shift(size: float, turn: list[float] | None = None) -> dict[str, object]:
    return {"angle": "roll", "size_deg": size, "turn_deg": turn}


def recorded(*lists: list[dict[str, object]]) -> tuple[Recorder, Columns]:
    """A second for each list of shifts."""
    made = Recorder(signals=False)
    for second, shifts in enumerate(lists):
        estimate = MountEstimate(MountState.FINE, details={"shifts": shifts})
        made.snapshot(Snapshot(10 * second + 9, estimate, usable=True))
    return made, made.events(0.0, NO_FAULTS)  # type: ignore[arg-type]


def shifts_of(events: Columns) -> list[tuple[float, str, tuple[float, ...]]]:
    t, _, kind, text, *turn = events.arrays
    turns = zip(*turn, strict=True)
    return [(float(a), str(c), tuple(map(float, d)))
            for a, b, c, d in zip(t, kind, text, turns, strict=True) if b == "shift"]  # fmt: skip


def test_a_turn_that_is_known_later_stands_at_the_time_at_which_the_shift_was_found():
    _, events = recorded([], [shift(2.0)], [shift(2.0)], [shift(2.0, [3.0, 0.0, 0.0]), shift(-1.0)])
    first, second = shifts_of(events)
    assert first[0] == 2.0
    assert "+3.0 deg" in first[1]
    assert first[2] == (3.0, 0.0, 0.0)
    assert second[0] == 4.0
    assert "-1.0 deg" in second[1]
    assert all(map(math.isnan, second[2]))


def test_a_mount_that_starts_again_loses_no_shift():
    _, events = recorded([shift(2.0), shift(1.0)], [], [shift(2.0), shift(1.0, [0.0, 1.0, 0.0])])
    assert [t for t, _, _ in shifts_of(events)] == [1.0, 1.0]
    assert shifts_of(events)[1][2] == (0.0, 1.0, 0.0)


def test_events_beyond_the_most_are_counted_shifts_among_them(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(recorder, "MAX_EVENTS", 3)  # the state and two shifts
    found = [shift(float(k)) for k in range(1, 6)]
    made, events = recorded(found[:1], found[:4], found)
    assert [text for _, text, _ in shifts_of(events)] == [
        "the drive shows +1.0 deg about the forward axis",
        "the drive shows +2.0 deg about the forward axis",
    ]
    assert made.events_left_out == 3
