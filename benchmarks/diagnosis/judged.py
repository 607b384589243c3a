"""What counts as right, and the tables of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from benchmarks.diagnosis.measured_logs import KNOWN
from benchmarks.diagnosis.real_effects import EFFECTS

Line = Mapping[str, Any]
LONG_MIN = 15.0


def names_of(line: Line) -> set[str]:
    """What was said, with what was said to look like it."""
    return set(line["said"]) | {n for group in line["sets"] for n in group}


def is_right(line: Line) -> bool:
    """The cause was named, alone or in a set. Where nothing of the catalogue is right: structure is
    told, and no name that is not true of the log as it is."""
    if "unknown" in line["right"]:
        seen = line["verdict"] == "unknown" or bool(line["left"])
        return seen and not wrong_names(line)
    if not line["right"]:
        return not wrong_names(line)
    return bool(set(line["right"]) & names_of(line))


def wrong_names(line: Line) -> list[str]:
    """Names that are neither hidden nor true of the log as it is, nor in a set with either."""
    known = set(KNOWN.get(line["log"], ()))
    right = set(line["right"]) | known
    alike = {n for g in line["sets"] if right & set(g) for n in g}
    return [n for n in line["said"] if n not in right | alike]


def _row(*cells: object) -> str:
    return "| " + " | ".join(str(c) for c in cells) + " |"


def nulls(lines: Sequence[Line]) -> Iterator[str]:
    """Measured pieces against the model that the other pieces gave."""
    yield _row("log", "pieces", "nothing", "named", "not known to be true", "left over")
    yield _row(*["---"] * 6)
    for log in dict.fromkeys(x["log"] for x in lines):
        own = [x for x in lines if x["log"] == log and "refused" not in x]
        refused = sum("refused" in x for x in lines if x["log"] == log)
        said = sorted(n for x in own for n in x["said"])
        left = sorted(k for x in own for k in x["left"])
        count = f"{len(own)}" + (f" ({refused} refused: too short)" if refused else "")
        quiet = sum(x["verdict"] == "nothing" for x in own)
        wrong = ", ".join(n for x in own for n in wrong_names(x)) or "-"
        yield _row(log, count, quiet, ", ".join(said) or "-", wrong, ", ".join(left) or "-")


def hidden(lines: Sequence[Line], null_lines: Sequence[Line]) -> Iterator[str]:
    """Effects hidden in measured logs, by effect and size."""
    lines = [x for x in lines if "refused" not in x]
    yield _row("effect", *(f"size {i + 1}" for i in range(4)), "wrong names", "in 15 min and more")
    yield _row(*["---"] * 7)
    wrong = single = 0
    for name, effect in EFFECTS.items():
        own = [x for x in lines if x["effect"] == name]
        if not own:
            continue
        cells = []
        for level, size in enumerate(effect.sizes):
            some = [x for x in own if x["level"] == level]
            if some:
                found = sum(map(is_right, some))
                cells.append(f"{size / effect.per:g} {effect.unit}: {found}/{len(some)}")
            else:
                cells.append("-")
        bad = [n for x in own for n in wrong_names(x)]
        wrong += sum(bool(wrong_names(x)) for x in own)
        single += sum(len(x["said"]) == 1 and not x["sets"] and bool(wrong_names(x)) for x in own)
        long = [x for x in own if x["minutes"] >= LONG_MIN]
        by_level = [
            f"{sum(is_right(x) for x in long if x['level'] == i)}/"
            f"{sum(x['level'] == i for x in long)}" for i in range(4)
        ]  # fmt: skip
        shown = ", ".join(f"{n} x{bad.count(n)}" for n in sorted(set(bad))) or "-"
        yield _row(name, *cells, shown, " ".join(by_level))
    held, sized = intervals(lines, null_lines)
    total = len(lines)
    yield ""
    yield (
        f"{sum(map(is_right, lines))} of {total} right; a name that is not there in {wrong} "
        f"({100 * wrong / max(total, 1):.1f} %), alone in {single}; intervals hold the hidden "
        f"size in {held} of {sized}."
    )


def intervals(lines: Sequence[Line], null_lines: Sequence[Line]) -> tuple[int, int]:
    """How many intervals of named parameters hold what was put in, on top of what the same piece
    as it is says of the parameter, named or not."""
    own = {
        (x["log"], _piece(x)): {k: v[:2] for k, v in {**x["others"], **x["values"]}.items()}
        for x in null_lines if "refused" not in x
    }  # fmt: skip
    held = sized = 0
    for x in lines:
        truth = x.get("truth") or {}
        key = truth.get("key") or ""
        got = x["values"].get(key)
        if got is None:
            continue
        value, se, q = got
        base, base_se = own.get((x["log"], _piece(x)), {}).get(key, (0.0, 0.0))
        sized += 1
        held += abs(value - base - truth["value"]) <= q * (se**2 + base_se**2) ** 0.5
    return held, sized


def _piece(line: Line) -> str:
    return str(line["key"].rpartition("/")[2])


def outside(lines: Sequence[Line], null_lines: Sequence[Line]) -> Iterator[str]:
    """How many effects that the catalogue lacks are seen, in logs that are not `unknown` anyway;
    what no test could see that does not know the effect is counted by itself."""
    already = {(x["log"], _piece(x)) for x in null_lines if x.get("verdict") == "unknown"}
    there = [x for x in lines if "refused" not in x and (x["log"], _piece(x)) not in already]
    fair = [x for x in there if _is_visible(x)]
    for effect in dict.fromkeys(x["effect"] for x in fair):
        own = [x for x in fair if x["effect"] == effect]
        yield f"- {effect}: seen in {sum(map(is_right, own))} of {len(own)}."
    hard = [x for x in there if not _is_visible(x)]
    said = ", ".join(f"{x['effect']} in {x['log']} ({_ratio(x)})" for x in hard)
    yield (
        f"- In all {sum(map(is_right, fair))} of {len(fair)}, with a wrong name in "
        f"{sum(bool(wrong_names(x)) for x in fair)}; pieces that are `unknown` as they are "
        f"({len(already)}) are left out."
    )
    if hard:
        yield (
            f"- Too small at any size tried for a test that does not know their shape (deviations "
            f"of the ideal filter, needed): {said}; seen in {sum(map(is_right, hard))}, a wrong "
            f"name in {sum(bool(wrong_names(x)) for x in hard)}."
        )


def _is_visible(line: Line) -> bool:
    truth = line.get("truth") or {}
    return bool(truth.get("ideal", 1.0) >= truth.get("needed", 0.0))


def _ratio(line: Line) -> str:
    return f"{line['truth']['ideal']:.1f}, {line['truth']['needed']:.1f}"


def drives(lines: Sequence[Line], what: str) -> Iterator[str]:
    """How many drives are right, and one row for each that is not. what: the drives' name."""
    missed = [x for x in lines if not is_right(x)]
    good = len(lines) - len(missed)
    yield f"{what}: {good} of {len(lines)} right{'; the others:' if missed else '.'}"
    if not missed:
        return
    yield ""
    yield _row("drive", "hidden", "verdict", "named", "look-alikes", "likely", "left over")
    yield _row(*["---"] * 7)
    for x in missed:
        sets = "; ".join(" = ".join(g) for g in x["sets"])
        yield _row(
            x["log"], x["effect"] or "-", x["verdict"], ", ".join(x["said"]) or "-", sets or "-",
            ", ".join(x["likely"]) or "-", ", ".join(x["left"]) or "-",
        )  # fmt: skip


def summary(part: str, lines: Sequence[Line]) -> str:
    """One line a part."""
    lines = [x for x in lines if "refused" not in x]
    if not lines:
        return f"{part}: nothing to tell"
    good = [x for x in lines if is_right(x)]
    invented = sum(bool(wrong_names(x)) for x in lines)
    near = sum(not is_right(x) and bool(set(x["right"]) & set(x["likely"])) for x in lines)
    return (
        f"{part}: {len(good)} of {len(lines)} right, {near} more likely; names that are not there "
        f"in {invented}"
    )


def calibration(lines: Sequence[Line]) -> Iterator[str]:
    """Of what was told as certain and as likely, how much was there."""
    yield _row("world", "certain", "right", "likely", "right")
    yield _row(*["---"] * 5)
    for part in dict.fromkeys(x["part"] for x in lines):
        own = [x for x in lines if x["part"] == part and "refused" not in x]
        sure = [(n, x) for x in own for n in x["said"]]
        bad = sum(n in wrong_names(x) for n, x in sure)
        likely = [(n, x) for x in own for n in x["likely"]]
        good = sum(n in {*x["right"], *KNOWN.get(x["log"], ())} for n, x in likely)
        yield _row(part, len(sure), len(sure) - bad, len(likely), good)


def file_alone(lines: Sequence[Line]) -> str:
    """Whether the written file does alone what the page says, within 5 %."""
    pairs = [v for x in lines for v in (x.get("file") or {}).values() if v[2] > 0.0]
    near = sum(abs(after - alone) <= 0.05 * alone for _, after, alone in pairs)
    return f"Within 5 % of what the page says: {near} of {len(pairs)} signals."


def cost(lines: Sequence[Line]) -> str:
    """Processor time and memory."""
    per_hour = sorted(x["cpu_s_per_h"] for x in lines if x.get("minutes", 0.0) >= LONG_MIN)
    if not per_hour:
        return "No drive of 15 min."
    middle = per_hour[len(per_hour) // 2]
    return (
        f"Processor time per hour of driving: median {middle:.0f} s, most {per_hour[-1]:.0f} s; "
        f"memory up to {max(x['mib'] for x in lines if 'mib' in x)} MiB."
    )
