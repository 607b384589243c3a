"""The table of questions about what no cause explains."""

from __future__ import annotations

from imucald.diagnosis.fit.chance import Answer, Row, reported
from imucald.diagnosis.left_over.table import AGAINST, LEFT, ODD
from imucald.diagnosis.result import Kind


def test_every_kind_has_a_question_of_its_own_words():
    rows = (*ODD, *AGAINST, *LEFT)
    # Lost readings are found among the faults.
    assert {row.kind for row in rows} == set(Kind) - {Kind.READINGS_LOST}
    questions = [row.question for row in rows]
    assert len(set(questions)) == len(questions)


def test_one_loop_asks_all_rows_by_limit_by_chance_and_with_a_rate_apart():
    late = Answer("speed", 3.0, 1.0, 1e-4, "", parameter="late")
    noise = Answer("gyro", 0.5, 1.0, 0.5, "")
    rows = (
        Row(Kind.TOO_MUCH, "By a limit?", lambda _: [Answer("accel_y", 2.0, 1.0, 1.0, "")], True),
        Row(Kind.UNEVEN, "Below it?", lambda _: [Answer("accel_y", 0.5, 1.0, 0.0, "")], True),
        Row(Kind.WANDERS, "By chance?", lambda others: [late, *[noise] * others]),
    )
    asked: list[str] = []

    def found(others: int, apart: str = "") -> list[tuple[str, str, float]]:
        return [(s.signal, s.kind, s.size) for s in reported(rows, others, asked.append, apart)]

    limit, chance = ("accel_y", Kind.TOO_MUCH, 2.0), ("speed", Kind.WANDERS, 3.0)
    assert found(10) == [limit, chance]
    assert asked == [row.question for row in rows]
    # A thousand other questions use up the rate, unless the parameter has one of its own.
    assert found(1000) == [limit]
    assert found(1000, "late") == [limit, chance]
