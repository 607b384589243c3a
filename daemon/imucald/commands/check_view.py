"""Print the report of `imucald check` as text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rich.table import Table
from rich.text import Text

from imucald.commands.terminal import PIPED_WIDTH, plain_console
from imucald.config_check.health import is_mostly_unused
from imucald.core.text import counted, one_line

LONG_QUANTITY, LONG_SOURCE = 18, 12
"""On a narrow terminal, names longer than this are broken at their dot [columns]. LONG_QUANTITY is
for quantities, LONG_SOURCE for sources."""
_STYLES = {"error": "bold red", "warning": "yellow", "note": "cyan", "ok": "green"}


def print_report(report: Mapping[str, Any], strict: bool = False) -> None:
    """Print messages, quantities, findings and output ids."""
    console = plain_console()
    frames = report["frames"]
    left = frames["read"] - frames["used"] - frames["other_frames"]
    console.print(
        f"{counted(frames['read'], 'frame')} in {report['duration_s']:.1f} s: "
        f"{frames['used']} used, "
        + (f"{left} of configured messages rejected, " if left else "")
        + f"{frames['other_frames']} not configured ({counted(frames['other_ids'], 'id')})"
    )
    console.print()
    console.print(_messages(report["messages"]))
    console.print()
    whole = _quantities(report["quantities"], False, console.is_terminal)
    unlimited = console.options.update_width(PIPED_WIDTH)
    is_narrow = console.measure(whole, options=unlimited).maximum > console.width
    console.print(_quantities(report["quantities"], True, True) if is_narrow else whole)
    console.print()
    console.print(_findings(report["findings"]))
    console.print()
    ids = ", ".join(f"{row['id']} {row['frame']}" for row in report["output"])
    console.print(f"imucald would send: {ids}")
    console.print(_verdict(report, strict))
    if report["usable"] and is_mostly_unused(report["used_for_mount_s"], report["duration_s"]):
        used = f"{report['used_for_mount_s']:.0f} of {report['duration_s']:.0f} s"
        text = f"But only {used} of this log could be used for the mount."
        console.print(Text(text, style="bold yellow"))


def _verdict(report: Mapping[str, Any], strict: bool) -> Text:
    """Return the last line: whether the configuration is usable, and the number of warnings."""
    warnings = report["warnings"]
    how_many = counted(warnings, "warning")
    if not report["usable"]:
        more = f": see the errors above, and {how_many}" if warnings else ": see the errors above"
        return Text(f"This configuration cannot be used yet{more}.", style="bold red")
    if not warnings:
        return Text("This configuration can be used: no warnings.", style="bold green")
    if strict:
        return Text(
            f"This configuration has {how_many}; --strict allows no warning.", style="bold red"
        )
    return Text(f"This configuration can be used, with {how_many}: see above.", style="bold yellow")


def _messages(rows: list[dict[str, Any]]) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("message", overflow="fold")
    table.add_column("id")
    table.add_column("frames", justify="right")
    table.add_column("cycle [ms]", justify="right")
    table.add_column("stated", justify="right")
    table.add_column("lost", justify="right")
    table.add_column("rejected", overflow="fold")
    for row in rows:
        channel = f" {one_line(row['channel'])}" if row["channel"] else ""
        table.add_row(
            one_line(row["name"]),
            row["id"] + channel,
            Text(str(row["frames"]), style="" if row["frames"] else "red"),
            _millis(row["cycle_s"]),
            _millis(row["stated_cycle_s"]),
            "-" if row["lost_share"] is None else f"{100.0 * row['lost_share']:.1f} %",
            _reasons(row["rejected"]),
        )
    return table


def _quantities(rows: list[dict[str, Any]], narrow: bool, stacked: bool) -> Table:
    """narrow: long names are broken at their dot. stacked: cells may have two lines."""
    table = Table(box=None, pad_edge=False, padding=(0, 1, 0, 0 if narrow else 1))
    table.add_column("quantity", no_wrap=stacked)
    table.add_column("from", overflow="fold")
    table.add_column("samples", justify="right")
    for name in ("min", "mean", "max"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("unit", overflow="fold")
    new_line = "\n" if stacked else " "
    for row in rows:
        rank = f" ({row['preference'] + 1}.)" if row["preference"] else ""
        rejected = f"{new_line}({_reasons(row['rejected'])} rejected)" if row["rejected"] else ""
        in_unit, in_si = row["in_unit"], row["in_si"]
        same = row["unit"] == row["si_unit"] or row["factor"] == 1.0 or not row["si_unit"]
        ends = ("max", "min") if row["factor"] < 0 else ("min", "max")  # of the same sample
        cells = [
            _figure(in_si[k])
            if same or in_unit[k] is None
            else f"{_figure(in_unit[k])}\n{_figure(in_si[k_si])}"
            for k, k_si in (("min", ends[0]), ("mean", "mean"), ("max", ends[1]))
        ]
        unit = row["si_unit"] if same else f"{one_line(row['unit'])}\n{row['si_unit']}"
        if not same and row["factor"] < 0:
            unit += " (sign -1)"
        line = [
            _broken(row["quantity"], LONG_QUANTITY if narrow else None) + rank,
            _broken(one_line(row["source"]), LONG_SOURCE if narrow else None) + rejected,
            str(row["samples"]),
            *cells,
            unit,
        ]
        table.add_row(*(line if stacked else [cell.replace("\n", " = ") for cell in line]))
    return table


def _broken(name: str, most: int | None) -> str:
    """Break a dotted name that is longer than `most` into two lines."""
    return name if most is None or len(name) <= most else name.replace(".", ".\n", 1)


def _findings(rows: list[dict[str, Any]]) -> Table:
    table = Table.grid(padding=(0, 2))
    for row in rows:
        quantity = f"{row['quantity']}: " if row["quantity"] else ""
        text = one_line(quantity + row["text"])
        table.add_row(Text(row["level"], style=_STYLES[row["level"]]), text)
    return table


def _millis(seconds: float | None) -> str:
    return "-" if seconds is None else f"{1e3 * seconds:.4g}"


def _figure(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _reasons(rejected: Mapping[str, int]) -> str:
    return ", ".join(f"{reason} {n}" for reason, n in rejected.items()) or "none"
