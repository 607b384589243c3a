"""Tables and bars from the results, as in benchmarks/records/integrity.md."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks.integrity.cases import (
    AS_RECORDED,
    LATEST_FOUND_S,
    QUIET,
    ROWS,
    SATURATED,
    SHIFTED,
    Row,
)
from benchmarks.integrity.force import table as force_table
from benchmarks.measured import ROOT, verdict

Line = dict[str, Any]
PAGE = ROOT / "benchmarks" / "records" / "integrity.md"
BEGIN, END = "<!-- integrity -->", "<!-- end of integrity -->"
HOUR = 3600.0


def report(lines: Sequence[Line]) -> str:
    """All tables and bars of what there is."""
    hidden = [x for x in lines if not x.get("shown", True)]
    lines = [x for x in lines if x.get("shown", True)]
    by_row = {row.name: [x for x in lines if x["row"] == row.name] for row in ROWS}
    there = [row for row in ROWS if by_row[row.name]]
    quiet = [x for x in lines if x["row"] == QUIET.name]
    recorded = [x for x in lines if x["row"] == AS_RECORDED.name]
    out = [_drives([*lines, *hidden]), ""]
    if quiet:
        out += ["### Without a fault", "", *_quiet(quiet), ""]
    if there:
        out += ["### Faults", "", *_table(there, by_row), ""]
    if hidden:
        out += ["### Faults that no signal shows", "", *_hidden(hidden), ""]
    sensors = [("sound", quiet)] + [(r.name, by_row[r.name]) for r in there if r.part == "errors"]
    if any(lines for _, lines in sensors):
        out += ["### What a consumer gets", "", *force_table(sensors), ""]
    out += ["### Bars", "", *_bars(there, by_row, quiet, recorded), ""]
    if recorded:
        out += ["### Logs as they were recorded", "", *_recorded(recorded), ""]
    return "\n".join(out)


def worst(lines: Sequence[Line], number: int) -> str:
    """The drives of each fault that were misleading for longest after the allowed time."""
    out = ["fault, base, number, onset [s], seen: late, misleading, good [s]; time to alert"]
    for row in ROWS:
        found = [x for x in lines if x["row"] == row.name and (x["beyond"] > 0.0 or x["crash"])]
        for x in sorted(found, key=lambda x: -float(x["beyond"]))[:number]:
            alert = "never" if x["alert_clock"] is None else f"{x['alert_clock']:.1f} s"
            place = f"{row.name}, {x['base']}, {x['variant']}, {x['onset']:.1f}, {x['seen']}"
            times = f"{x['beyond']:.1f}, {x['misleading']:.1f}, {x['good']:.0f}; {alert}"
            out.append(f"{place}: {times} {x['crash'] or ''}".rstrip())
    return "\n".join(out)


def _drives(lines: Sequence[Line]) -> str:
    edited = {x["base"] for x in lines if x["row"] not in (QUIET.name, AS_RECORDED.name)}
    seeds = sorted(int(base) for base in edited if base.isdigit())
    logs = [base for base in edited if not base.isdigit()]
    drives = f"{len(seeds)} simulated drives from seed {seeds[0]} on" if seeds else "No drives"
    return f"{drives} and {len(logs)} logs have had faults put in, in {len(lines)} runs."


def written(page: str, text: str) -> str:
    """The page with the figures between its marks replaced."""
    head, rest = page.split(BEGIN)
    _, tail = rest.split(END)
    return f"{head}{BEGIN}\n\n{text.strip()}\n\n{END}{tail}"


# sums over drives ------------------------------------------------------------------------------


def total(lines: Sequence[Line], key: str) -> float:
    """Sum of a figure."""
    return float(sum(x[key] for x in lines))


def share(lines: Sequence[Line], key: str) -> float:
    """Of the time sent as good; 0 where nothing was."""
    good = total(lines, "good")
    return total(lines, key) / good if good else 0.0


def in_time(row: Row, lines: Sequence[Line], limit: float | None = None) -> float:
    """Share of drives whose fault was told within what is allowed, or `limit` s of driving.

    Drives in which nothing was sent as good since the fault have nothing to tell and do not count.
    """
    allowed = row.allowed
    by_clock = allowed.clock > 0.0 and limit is None
    most = allowed.clock if by_clock else allowed.driving if limit is None else limit
    key = "alert_clock" if by_clock else "alert_driving"
    told = [x[key] is not None and x[key] <= most for x in lines if x["exposed"]]
    return float(np.mean(told)) if told else 1.0


def holds(lines: Sequence[Line]) -> list[float]:
    """Share of good seconds at which the 95 % interval of roll, pitch, yaw holds."""
    known = total(lines, "known")
    hits = np.sum([x["hits"] for x in lines], axis=0)
    return [float(h) / known if known else float("nan") for h in hits]


def _percent(x: float, digits: int = 0) -> str:
    return "" if np.isnan(x) else f"{100.0 * x:.{digits}f}"


# tables ----------------------------------------------------------------------------------------


def _table(rows: Sequence[Row], by_row: dict[str, list[Line]]) -> Iterator[str]:
    yield (
        "| fault | drives with good frames | reported in time | misleading, s an hour |"
        " of it late | longest time to alert, clock / driving | 95 % holds, roll / pitch / yaw |"
        " fine, s an hour | crashes | `check` says error |"
    )
    yield "|---|---|---|---|---|---|---|---|---|---|"
    for row in rows:
        lines = by_row[row.name]
        hours = total(lines, "judged") / HOUR
        has_limit = row.allowed.clock > 0.0 or row.allowed.driving > 0.0
        told = f"{_percent(in_time(row, lines))} %" if has_limit else ""
        cover = " / ".join(_percent(x) for x in holds(lines)) if row.part != "values" else ""
        crashes = sum(x["crash"] is not None for x in lines)
        checked = f"{sum(x['level'] == 'error' for x in lines)}" if row.checked else ""
        exposed = sum(x["exposed"] for x in lines)
        yield (
            f"| {row.name} | {exposed} of {len(lines)} | {told} |"
            f" {total(lines, 'misleading') / hours:.1f} |"
            f" {total(lines, 'beyond') / hours:.1f} | {_longest(lines)} | {cover} |"
            f" {total(lines, 'fine') / hours:.0f} | {crashes or ''} | {checked} |"
        )


def _hidden(lines: Sequence[Line]) -> Iterator[str]:
    """Drives in which nothing differs from a sound one; they are in no bar and no other table."""
    for row in ROWS:
        found = [x for x in lines if x["row"] == row.name]
        if found:
            wrong = total(found, "misleading") / (total(found, "judged") / HOUR)
            names = ", ".join(sorted(x["base"] for x in found))
            yield (
                f"- {row.name}: {len(found)} drives ({names}), good and wrong for {wrong:.0f} s an"
                f" hour, *fine* in {sum(x['fine'] > 0.0 for x in found)}."
            )


def _longest(lines: Sequence[Line]) -> str:
    never = sum(x["alert_clock"] is None for x in lines)
    clock = max((x["alert_clock"] for x in lines if x["alert_clock"] is not None), default=0.0)
    driving = max(
        (x["alert_driving"] for x in lines if x["alert_driving"] is not None), default=0.0
    )
    text = f"{clock:.0f} / {driving:.0f} s"
    return f"{text}, never in {never}" if never else text


def _quiet(lines: Sequence[Line]) -> Iterator[str]:
    hours = total(lines, "judged") / HOUR
    suspects, silent = total(lines, "suspects"), total(lines, "not_available")
    yield f"- {len(lines)} drives, {hours:.0f} h."
    yield f"- Misleading: {total(lines, 'misleading') / hours * 100.0:.1f} s in 100 h."
    yield (
        f"- Taken back without a fault: {suspects / hours * 100.0:.1f} times in 100 h as suspect,"
        f" {silent / hours * 100.0:.1f} as not available."
    )
    for state in ("usable", "fine"):
        found = [x[f"{state}_after"] for x in lines if x[f"{state}_after"] is not None]
        if found:
            yield (
                f"- Driving until {state}: median {np.median(found):.0f} s, 90th percentile"
                f" {np.quantile(found, 0.9):.0f} s ({len(found)} of {len(lines)} drives)."
            )
    cover = " / ".join(_percent(x) for x in holds(lines))
    yield f"- The 95 % interval of roll / pitch / yaw holds in {cover} % of the good seconds."


def _recorded(lines: Sequence[Line]) -> Iterator[str]:
    yield (
        "| log | good, s | fine, s | misleading, s | suspect, not available |"
        " own fault reported after |"
    )
    yield "|---|---|---|---|---|---|"
    for x in lines:
        own = x.get("own_fault")
        told = (
            ""
            if own is None
            else "never"
            if own["alert_driving"] is None
            else (f"{own['alert_driving']:.0f} s of driving")
        )
        yield (
            f"| {x['base']} | {x['good']:.0f} | {x['fine']:.0f} | {x['misleading']:.0f} |"
            f" {x['suspects']}, {x['not_available']} | {told} |"
        )


# bars ------------------------------------------------------------------------------------------


def _bars(
    rows: Sequence[Row],
    by_row: dict[str, list[Line]],
    quiet: Sequence[Line],
    recorded: Sequence[Line],
) -> Iterator[str]:
    if quiet:
        hours = total(quiet, "judged") / HOUR
        lost = (total(quiet, "suspects") + total(quiet, "not_available")) / hours * 100.0
        misled = total(quiet, "misleading")
        text = f"{misled:.0f} s misleading in {hours:.0f} h (bar 0)"
        yield f"- 1, no fault: {text}: {verdict(not misled)}."
        yield f"- 1, no fault: taken back {lost:.1f} times in 100 h (bar 1): {verdict(lost < 1.0)}."
    judges: dict[int, Callable[[Row, list[Line]], Iterator[str]]] = {
        2: _bar_values, 3: _bar_remount, 4: _bar_creep, 5: _bar_errors, 6: _bar_signs,
    }  # fmt: skip
    for row in rows:
        judge = judges.get(row.bar)
        if judge is not None:
            yield f"- {row.bar}, {row.name}: {'; '.join(judge(row, by_row[row.name]))}."
    if rows:
        yield from _bar_all(rows, by_row)
    for name in (SHIFTED, SATURATED):
        for x in recorded:
            if x["base"] == name:
                own = x["own_fault"]
                after = own["alert_driving"]
                told = (
                    "never reported"
                    if after is None
                    else f"reported after {after:.0f} s of driving"
                )
                met = after is not None and after <= 60.0 and not own["beyond"]
                late = f"{own['beyond']:.0f} s misleading later"
                yield f"- 9, {name}: {told} (bar 60), {late} (bar 0): {verdict(met)}."


def _bar_values(row: Row, lines: list[Line]) -> Iterator[str]:
    told = in_time(row, lines)
    limit = "2 s" if row.allowed.clock else f"{row.allowed.driving:.0f} s of driving"
    yield f"reported within {limit} in {_percent(told)} % (bar 100): {verdict(told == 1.0)}"
    late = total(lines, "beyond")
    yield f"{late:.0f} s misleading afterwards (bar 0): {verdict(late == 0.0)}"


def _bar_remount(row: Row, lines: list[Line]) -> Iterator[str]:
    told = in_time(row, lines)
    limit = row.allowed.driving
    yield (
        f"reported within {limit:.0f} s of driving in {_percent(told)} % (bar 95):"
        f" {verdict(told >= 0.95)}"
    )
    if limit < LATEST_FOUND_S:
        told = in_time(row, lines, LATEST_FOUND_S)
        yield (
            f"within {LATEST_FOUND_S:.0f} s in {_percent(told)} % (bar 99): {verdict(told >= 0.99)}"
        )
    ends = sum(x["at_end"] for x in lines)
    yield f"misleading to the end in {ends} drives (bar 0): {verdict(not ends)}"


def _bar_creep(row: Row, lines: list[Line]) -> Iterator[str]:
    known = total(lines, "known")
    within = total(lines, "within") / known if known else 1.0
    yield (
        f"within 3 deviations in {_percent(within)} % of {known / HOUR:.1f} h sent as good"
        f" (bar 98): {verdict(within >= 0.98)}"
    )


def _bar_errors(row: Row, lines: list[Line]) -> Iterator[str]:
    cover = holds(lines)
    text = " / ".join(_percent(x) for x in cover)
    met = all(x >= 0.9 for x in cover)
    yield f"95 % intervals of roll / pitch / yaw hold in {text} % (bar 90): {verdict(met)}"


def _bar_signs(row: Row, lines: list[Line]) -> Iterator[str]:
    fine = sum(x["fine"] > 0.0 for x in lines)
    yield f"fine in {fine} of {len(lines)} drives (bar 0): {verdict(not fine)}"
    errors = sum(x["level"] == "error" for x in lines)
    met = verdict(errors == len(lines))
    yield f"`check` says error in {errors} of {len(lines)} (bar all): {met}"
    crashes = sum(x["crash"] is not None for x in lines)
    yield f"ends with an exception in {crashes} (bar 0): {verdict(not crashes)}"


def _bar_all(rows: Sequence[Row], by_row: dict[str, list[Line]]) -> Iterator[str]:
    late = float(np.mean([share(by_row[row.name], "beyond") for row in rows]))
    every = float(np.mean([share(by_row[row.name], "misleading") for row in rows]))
    yield (
        f"- 7, {len(rows)} faults weighed equally: misleading later than the allowed time to alert"
        f" in {_percent(late, 2)} % of the time sent as good (bar 0.1): {verdict(late <= 0.001)};"
        f" that time counted too, {_percent(every, 2)} %."
    )
