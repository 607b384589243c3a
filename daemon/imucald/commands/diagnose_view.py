"""Show a diagnosis on the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from imucald.commands.terminal import plain_console, plain_where_needed
from imucald.core.text import counted
from imucald.report import titles
from imucald.report import wording as words
from imucald.report.model_changes import is_of_cause, shown_changes, value_text

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from imucald.diagnosis.result import Diagnosis, FoundCause

SHOWN_CANDIDATES = 12
SHOWN_STRUCTURE = 8
SHOWN_NOTES = 12

COLOURS = {"found": "bold blue", "ambiguous": "bold yellow", "unknown": "bold magenta",
           "nothing": "bold green"}  # fmt: skip


def print_diagnosis(diagnosis: Diagnosis, has_file: bool = True) -> None:
    """Print verdict, causes, their effects, and the remaining errors. has_file: a model file was
    read or written, so values of the model are values of this file.
    """
    from rich.text import Text

    plain_where_needed()
    console = plain_console()
    verdict = words.verdict(diagnosis)
    console.print(Text(verdict.headline, style=COLOURS[diagnosis.verdict]))
    console.print(Text(verdict.explanation))
    console.print(Text.assemble(("Next: ", "bold"), verdict.next))
    for cause in (*diagnosis.causes, *diagnosis.likely):
        _print_cause(console, cause, diagnosis)
    for other in words.other_suspects(diagnosis):
        console.print()
        console.print(
            f"ambiguous: {other.title}. {other.text} This cause is not written into the file."
        )
    _print_open(console, diagnosis)
    console.print()
    _print_signals(console, diagnosis)
    for change in shown_changes(diagnosis):
        source = "found" if is_of_cause(change, diagnosis) else "estimated for this diagnosis"
        where = "model file" if has_file else source
        before, after = value_text(change.before), value_text(change.after)
        console.print(f"{where}, {change.key}: {before} -> {after}")
    if diagnosis.causes:
        console.print(f"gain on held-out data: {words.gain(diagnosis.gain)}")
    _print_candidates(console, diagnosis)
    for note in diagnosis.notes[:SHOWN_NOTES]:
        console.print(f"note: {note}")
    if len(diagnosis.notes) > SHOWN_NOTES:
        more = counted(len(diagnosis.notes) - SHOWN_NOTES, "more note is", "more notes are")
        console.print(f"{more} in the JSON")


def _print_cause(console: Console, cause: FoundCause, diagnosis: Diagnosis) -> None:
    from rich.padding import Padding
    from rich.text import Text

    console.print()
    card = words.card(cause, diagnosis)
    console.print(Text.assemble((f"{card.certainty}: {card.title}", "bold"), f". {card.text}"))
    table = _table()
    table.add_column("parameter", overflow="fold")
    table.add_column("value ± 95 %", justify="right")
    table.add_column("model file", justify="right")
    table.add_column("key and value in the model file", overflow="fold")
    for row in card.rows:
        in_file = f"{row.key}: {row.in_file}" if row.key else ""
        table.add_row(f"  {row.title}", row.value, row.stated, in_file)
    if card.rows:
        console.print(table)
    seen = [f"seen in {words.in_series(card.signals)}"] if card.signals else []
    for text in (
        *seen,
        *filter(None, [card.evidence]),
        *(f"against it: {x}" for x in card.against),
    ):
        console.print(Padding(text, (0, 0, 0, 2)))


def _print_open(console: Console, diagnosis: Diagnosis) -> None:
    if diagnosis.look_alikes:
        console.print()
    for group_titles, group in words.look_alike_groups(diagnosis).items():
        console.print(f"cannot be distinguished: {words.in_series(group_titles, 'or')}")
        if ways := words.ways_apart(group):
            console.print("a drive that would distinguish these causes:")
        for way in ways:
            console.print(f"  {way}")
    if not diagnosis.structure:
        return
    console.print()
    console.print("residuals that no cause explains:")
    table = _table()
    for title in ("signal", "what", "what is seen"):
        table.add_column(title, overflow="fold")
    for s in diagnosis.structure[:SHOWN_STRUCTURE]:
        signal = titles.signal_title(s.signal)
        table.add_row(f"  {signal}", s.kind, words.structure_text(s))
    console.print(table)


def _print_signals(console: Console, diagnosis: Diagnosis) -> None:
    table = _table()
    table.add_column("residual of", min_width=len("accelerometer"))
    table.add_column("verdict")
    for title in ("rms before", "after", "change", "floor"):
        table.add_column(title, justify="right")
    table.add_column("unit")
    rows = words.signal_rows(diagnosis)
    for name, *cells, _, _ in rows:
        table.add_row(name, *cells)
    console.print(table)
    console.print(words.NOTHING_MEANS)
    for row in filter(lambda row: row.left, rows):
        console.print(f"left in {row.name}: {row.left}")


def _print_candidates(console: Console, diagnosis: Diagnosis) -> None:
    rows = [row for row in words.not_named(diagnosis) if row.outcome != "within tolerance"]
    if rows:
        table = _table()
        for title in ("not named", "outcome", "value ± 95 %", "would have shown"):
            table.add_column(title, overflow="fold")
        for row in rows[:SHOWN_CANDIDATES]:
            table.add_row(row.title, row.outcome, row.value, row.shows)
        console.print(table)
    rest = len(diagnosis.candidates) - min(len(rows), SHOWN_CANDIDATES)
    if rest > 0:
        console.print(f"{rest} more causes were not named; report and JSON list them")


def _table() -> Table:
    from rich.table import Table

    return Table(box=None, pad_edge=False)
