"""The tables of the diagnosis's judge: what is right is counted, what is missed has a row."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks.diagnosis.__main__ import mixed
from benchmarks.diagnosis.bars import bars, found_at_or_below
from benchmarks.diagnosis.cases import PARTS, Case
from benchmarks.diagnosis.judged import drives, is_right, wrong_names
from benchmarks.diagnosis.measured_logs import STATE
from benchmarks.diagnosis.run import known, one, run


def hidden(effect: str, level: int, draw: int, named: bool, **more: object) -> dict[str, object]:
    return {
        "key": f"measured/a_van/{effect}/{level}/{draw}/0of2", "part": "measured", "log": "a_van",
        "effect": effect, "level": level, "draw": draw, "right": ["it"], "minutes": 20.0,
        "said": ["it"] if named else [], "likely": [], "sets": [], "left": [], "values": {},
        "others": {}, "verdict": "found" if named else "nothing", "cpu_s_per_h": 10.0, "mib": 100,
        "longest_stop_s": 60.0, **more,
    }  # fmt: skip


def line(log: str, *named: str) -> dict[str, object]:
    return {
        "log": log, "effect": "gyro_bias", "right": ["gyro_bias"], "verdict": "found",
        "said": list(named), "sets": [], "likely": [], "left": [],
    }  # fmt: skip


def test_a_missed_drive_has_a_row_and_a_right_one_is_counted():
    first, _, _, _, *rows = drives([line("one", "gyro_bias"), line("two", "accel_bias")], "Drives")
    assert first == "Drives: 1 of 2 right; the others:"
    assert rows == ["| two | gyro_bias | found | accel_bias | - | - | - |"]


def test_where_all_is_right_there_is_no_table():
    assert list(drives([line("one", "gyro_bias")], "Drives")) == ["Drives: 1 of 1 right."]


def test_an_effect_counts_where_the_size_asked_for_or_a_smaller_one_of_its_draw_is_named():
    small, asked, large = 0, 1, 2  # 3, 6 and 9 %
    lines = [
        hidden("gyro_scale", small, 17, True), hidden("gyro_scale", asked, 17, False),
        hidden("gyro_scale", asked, 18, True), hidden("gyro_scale", asked, 19, False),
        hidden("gyro_scale", large, 19, True), hidden("gyro_scale", small, 20, True),
    ]  # fmt: skip
    assert found_at_or_below(lines) == {"gyro_scale": [True, True, False]}


@pytest.mark.parametrize(("own", "right"), [(-0.16, True), (-0.09, False), (None, False)])
def test_a_delay_that_the_logs_own_one_undoes_is_nothing(own, right):
    """Together 0.04 or 0.11 s, where 0.03 s and 1.96 times 0.01 s may be."""
    known = None if own is None else [own, 0.01]
    late = hidden("speed_late", 1, 3, False, truth={"key": "speed.delay_s", "value": 0.2})
    assert is_right({**late, "own": known}) == right


@pytest.mark.parametrize(("named", "by_means", "wrong"), [
    (-0.0033, -0.0034, []), (-0.0033, -0.0020, ["gyro_bias"]), (-0.0009, -0.0008, ["gyro_bias"]),
])  # fmt: skip
def test_a_zero_that_plain_means_at_stops_confirm_beyond_its_tolerance_is_no_wrong_name(
    named, by_means, wrong
):
    key = "gyro.bias.y"
    said = {**line("one", "gyro_bias"), "right": ["unknown"], "values": {key: [named, 2e-4, 3.0]}}
    assert wrong_names({**said, "at_rest": {key: [by_means, 1e-4]}}) == wrong
    assert wrong_names(said) == ["gyro_bias"]


def test_what_disjoint_pieces_show_beside_a_plain_car_is_no_wrong_name():
    said = {**line("css_canmod_164", "accel_bias"), "right": ["gyro_scale"], "values": {}}
    assert wrong_names({**said, "part": "plain"}) == []
    assert wrong_names({**said, "part": "measured"}) == ["accel_bias"]


def test_without_a_model_file_the_third_size_and_pieces_that_drive_are_judged():
    nothing = dict.fromkeys(PARTS, ())
    own = [hidden("lost", 2, draw, draw < 9, minutes=10.0 + draw) for draw in range(10)]
    own += [hidden("lost", 1, 0, False), hidden("lost", 2, 0, False, refused="3 segments")]
    told = "\n".join(bars({**nothing, "plain": own}))
    assert "named in 8 min and more: 9 of 10 (90.0 %) (bar 60 %): met" in told
    assert "named in 15 min and more: 4 of 5 (80.0 %) (bar 85 %): NOT MET" in told


def test_a_short_log_does_not_count_for_what_is_asked_of_long_ones():
    assert found_at_or_below([hidden("lost", 2, 17, True, minutes=14.0)]) == {}


@pytest.mark.parametrize(("longest_stop_s", "found"), [(60.0, [False]), (2.0, [True])])
def test_a_gyroscopes_zero_of_a_drive_without_stops_may_be_larger(longest_stop_s, found):
    stands = {"longest_stop_s": longest_stop_s}
    lines = [hidden("gyro_bias", 0, 17, False, **stands), hidden("gyro_bias", 2, 17, True)]
    assert found_at_or_below(lines) == {"gyro_bias": found}


def test_each_bar_is_told_with_its_figure_and_whether_it_is_met():
    nothing = dict.fromkeys(PARTS, ())
    own = [hidden("lost", 2, draw, True) for draw in range(10)]
    told = "\n".join(bars({**nothing, "measured": own}))
    assert "- 1, wrong name where an effect is hidden in a measured log: 0 of 10 (0.0 %) (bar 3 %): met" in told  # fmt: skip  # noqa: E501
    assert "10 of 10 (100.0 %) (bar 90 %): met: lost 2 % 10/10." in told
    assert "NOT MET" not in told
    crash = hidden("lost", 2, 3, False, verdict="crash", crash="KeyError: 'x'", right=["none"])
    crash["said"] = ["gyro_bias"]
    told = "\n".join(bars({**nothing, "measured": [*own[:9], crash]}))
    assert "1 of 10 (10.0 %) (bar 3 %): NOT MET; alone in 1." in told
    assert "Ended by an exception, counted as wrong: 1, KeyError: 'x'" in told


def test_cases_come_draw_by_draw_with_the_parts_in_an_even_mix():
    of = {part: [Case(part, str(i), draw=d) for d in (17, 18) for i in range(n)]
          for part, n in (("measured", 8), ("outside", 4))}  # fmt: skip
    order = mixed(of)
    assert [c.draw for c in order] == [17] * 12 + [18] * 12
    for count in range(3, 13, 3):
        assert sum(c.part == "outside" for c in order[:count]) == count // 3
    assert [c.log for c in order if c.part == "measured"][:8] == list("01234567")


def test_outcomes_are_read_up_to_a_line_that_was_broken_off(tmp_path: Path):
    path = tmp_path / "outcomes.jsonl"
    whole = {"key": "a", "state": STATE}
    older = {"key": "b", "state": "of another diagnosis"}
    path.write_text("\n".join([json.dumps(whole), json.dumps(older), '{"key": "c", "sta']))
    assert known(path) == {"a": whole}


def test_an_exception_is_an_outcome_and_what_is_known_is_not_run_again(tmp_path: Path):
    path = tmp_path / "outcomes.jsonl"
    absent = Case("measured", "no such log", "lost")
    assert one(absent)["verdict"] == "crash"
    run([absent], path, 1, None)
    before = path.read_text()
    run([absent], path, 1, None)
    assert path.read_text().strip() == before.strip()
    assert [x["verdict"] for x in known(path).values()] == ["crash"]
