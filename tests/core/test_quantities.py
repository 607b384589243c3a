"""A quantity is one row: its setting, its table and its place in a tick follow from it."""

from __future__ import annotations

import pytest

from imucald.api.columns import raw_columns
from imucald.config.signals import Signals
from imucald.core.samples import QUANTITIES, Quantity
from imucald.motion import ticks


@pytest.mark.parametrize("row", QUANTITIES.values(), ids=list(QUANTITIES))
def test_setting_and_table_follow_from_the_row(row: Quantity) -> None:
    assert row.key in Signals.__struct_fields__
    assert len(raw_columns(row.channel)) == len(raw_columns("speed")) - 1 + row.width
    assert row.title


def test_each_column_of_a_tick_is_given_once() -> None:
    rows = QUANTITIES.values()
    assert list(ticks.MEANS) == [row.channel for row in rows if row.tick == "mean"]
    assert list(ticks.LASTS) == [row.channel for row in rows if row.tick == "last"]
    columns = [ticks.T, *ticks.ACCEL, *ticks.GYRO, *ticks.SPEED, *ticks.WHEEL_SPREAD]
    columns += [column for signal in ticks.MEANS.values() for column in signal]
    assert sorted([*columns, *ticks.LASTS.values()]) == list(range(ticks.COLUMNS))
