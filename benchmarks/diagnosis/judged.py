"""What counts as right, and the tables of it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.diagnosis.measured_logs import KNOWN, REPEATED
from benchmarks.diagnosis.outside_effects import NOT_RUN
from benchmarks.diagnosis.real_effects import EFFECTS
from imucald.diagnosis.causes import PARAMETERS
from imucald.mount.mount_words import SD_95

Line = Mapping[str, Any]
LONG_MIN = 15.0


def names_of(line: Line) -> set[str]:
    """What was said, with what was said to look like it."""
    return set(line["said"]) | {n for group in line["sets"] for n in group}


def is_right(line: Line) -> bool:
    """The cause was named, alone or in a set. Where nothing of the catalogue is right: structure is
    reported, and no name that is not true of the log as it is."""
    if "unknown" in line["right"]:
        seen = line["verdict"] == "unknown" or bool(line["left"])
        return seen and not wrong_names(line)
    if not line["right"]:
        return not wrong_names(line)
    if meets_its_own(line) and line["verdict"] == "nothing":
        return True
    return bool(set(line["right"]) & names_of(line))


def meets_its_own(line: Line) -> bool:
    """What was put in and what is named in the log as it is may be within tolerance together (95 %
    of the latter's interval): then the file is right, and nothing is to be found."""
    truth, own = line.get("truth") or {}, line.get("own")
    if not own or not truth.get("key"):
        return False
    together = abs(own[0] + truth["value"])
    return bool(together <= PARAMETERS[truth["key"]].tolerance + SD_95 * own[1])


def zero_is_true(line: Line) -> bool:
    """A gyroscope's zero that is named and that plain means at stops confirm: they are beyond its
    tolerance by 1.96 deviations, and each 95 % interval holds them. A high-pass takes out the zero
    that the file takes off; a gain changes it with all else."""
    rest, named = line.get("at_rest") or {}, line["values"]
    keys = [key for key in rest if key in named]
    off = any(abs(rest[k][0]) > PARAMETERS[k].tolerance + SD_95 * rest[k][1] for k in keys)
    return off and all(
        abs(named[k][0] - rest[k][0]) <= SD_95 * float(np.hypot(named[k][1], rest[k][1]))
        for k in keys
    )


def wrong_names(line: Line) -> list[str]:
    """Names that are neither hidden nor true of the log as it is, nor in a set with either."""
    known = set(KNOWN.get(line["log"], ())) | ({"gyro_bias"} if zero_is_true(line) else set())
    if line.get("part", "").startswith("plain"):
        known |= set(REPEATED.get(line["log"], ()))
    right = set(line["right"]) | known
    alike = {n for g in line["sets"] if right & set(g) for n in g}
    return [n for n in line["said"] if n not in right | alike]


def is_wrong_alone(line: Line) -> bool:
    """One name, and no look-alike, and it is wrong."""
    return len(line["said"]) == 1 and not line["sets"] and bool(wrong_names(line))


def asked_of(lines: Sequence[Line]) -> list[Line]:
    """Without the cases whose log has no such signal; what was refused or crashed is missed."""
    return [x for x in lines if "lacks" not in x]


def long_logs(lines: Sequence[Line]) -> set[str]:
    """Measured logs whose halves last long enough."""
    return {x["log"] for x in lines if x.get("minutes", 0.0) >= LONG_MIN}


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
    lines = asked_of(lines)
    yield _row("effect", *(f"size {i + 1}" for i in range(4)), "wrong names", "in 15 min and more")
    yield _row(*["---"] * 7)
    wrong = single = 0
    of_15_min = long_logs(lines)
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
        single += sum(map(is_wrong_alone, own))
        long = [x for x in own if x["log"] in of_15_min]
        by_level = [
            f"{sum(is_right(x) for x in long if x['level'] == i)}/"
            f"{sum(x['level'] == i for x in long)}" for i in range(4)
        ]  # fmt: skip
        yield _row(name, *cells, _counted(bad), " ".join(by_level))
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
        for x in null_lines
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


def plain(lines: Sequence[Line], null_lines: Sequence[Line]) -> Iterator[str]:
    """Effects hidden in logs that are diagnosed without a model file, in whole pieces."""
    said = {(x["log"], _piece(x)): names_of(x) for x in null_lines}
    yield _row("effect", "15 min and more", "8 to 15 min", "shows as it is", "wrong names")
    yield _row(*["---"] * 5)
    for name, effect in EFFECTS.items():
        own = [x for x in driven(lines) if x["effect"] == name]
        if own:
            long, short = ([x for x in own if is_long(x) == of] for of in (True, False))
            already = sum(bool({*effect.right} & said.get((x["log"], _piece(x)), set()))
                          for x in own)  # fmt: skip
            bad = _counted([n for x in own for n in wrong_names(x)])
            yield _row(name, _share(long), _share(short), f"{already} of {len(own)}", bad)


def driven(lines: Sequence[Line]) -> list[Line]:
    """Without the pieces in which the vehicle hardly drives."""
    return [x for x in asked_of(lines) if "refused" not in x]


def is_long(line: Line) -> bool:
    """Whether a piece lasts long enough for most causes."""
    return bool(line.get("minutes", 0.0) >= LONG_MIN)


def outside(lines: Sequence[Line], null_lines: Sequence[Line]) -> Iterator[str]:
    """How many effects that the catalogue lacks are seen, in logs that are not `unknown` anyway;
    what no test could see that does not know the effect is counted by itself."""
    fair = fair_outside(lines, null_lines)
    kept = {id(x) for x in fair}
    logs = list(dict.fromkeys(x["log"] for x in fair))
    yield _row("effect", *logs, "seen", "wrong names")
    yield _row(*["---"] * (len(logs) + 3))
    for effect in dict.fromkeys(x["effect"] for x in fair):
        own = [x for x in fair if x["effect"] == effect]
        cells = [_share([x for x in own if x["log"] == log]) for log in logs]
        bad = [n for x in own for n in wrong_names(x)]
        new = " (new)" if effect in NOT_RUN else ""
        yield _row(effect + new, *cells, _share(own), _counted(bad))
    wrong = sum(bool(wrong_names(x)) for x in fair)
    yield ""
    yield (
        f"In all {_share(fair)}, with a wrong name in {wrong}; pieces that are `unknown` as they "
        f"are ({len(_already(null_lines))}) are left out."
    )
    hard = [x for x in asked_of(lines) if id(x) not in kept and not _is_visible(x)]
    if hard:
        cases = ", ".join(
            f"{effect} in {log} ({n})" if n > 1 else f"{effect} in {log}"
            for (effect, log), n in Counter((x["effect"], x["log"]) for x in hard).items()
        )
        yield ""
        yield (
            "Too small at any size tried for a test that does not know their shape (an ideal "
            f"filter gives less than such a test needs): {cases}; seen in "
            f"{sum(map(is_right, hard))}, a wrong name in "
            f"{sum(bool(wrong_names(x)) for x in hard)}."
        )


def fair_outside(lines: Sequence[Line], null_lines: Sequence[Line]) -> list[Line]:
    """Of pieces that are not `unknown` as they are, what an ideal filter could see."""
    already = _already(null_lines)
    there = [x for x in asked_of(lines) if (x["log"], _piece(x)) not in already]
    return [x for x in there if _is_visible(x)]


def _already(null_lines: Sequence[Line]) -> set[tuple[str, str]]:
    return {(x["log"], _piece(x)) for x in null_lines if x["verdict"] == "unknown"}


def _share(lines: Sequence[Line]) -> str:
    return f"{sum(map(is_right, lines))}/{len(lines)}" if lines else "-"


def _counted(names: Sequence[str]) -> str:
    return ", ".join(f"{n} x{names.count(n)}" for n in sorted(set(names))) or "-"


def _is_visible(line: Line) -> bool:
    truth = line.get("truth") or {}
    return bool(truth.get("ideal", 1.0) >= truth.get("needed", 0.0))


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
    lines = [x for x in asked_of(lines) if part != "nulls" or "refused" not in x]
    if not lines:
        return f"{part}: nothing to tell"
    good = [x for x in lines if is_right(x)]
    invented = sum(bool(wrong_names(x)) for x in lines)
    near = sum(not is_right(x) and bool(set(x["right"]) & set(x["likely"])) for x in lines)
    return (
        f"{part}: {len(good)} of {len(lines)} right, {near} more likely; names that are not there "
        f"in {invented}"
    )


def statements(lines: Sequence[Line]) -> tuple[int, int, int, int]:
    """How many are reported as certain, how many of these are right; the same of likely ones."""
    sure = [(n, x) for x in lines for n in x["said"]]
    bad = sum(n in wrong_names(x) for n, x in sure)
    likely = [(n, x) for x in lines for n in x["likely"]]
    good = sum(n in {*x["right"], *KNOWN.get(x["log"], ())} for n, x in likely)
    return len(sure), len(sure) - bad, len(likely), good


def calibration(lines: Sequence[Line]) -> Iterator[str]:
    """Of what was reported as certain and as likely, how much was there."""
    yield _row("world", "certain", "right", "likely", "right")
    yield _row(*["---"] * 5)
    for part in dict.fromkeys(x["part"] for x in lines):
        yield _row(part, *statements([x for x in lines if x["part"] == part]))
    yield _row("all", *statements(lines))


def file_alone(lines: Sequence[Line]) -> tuple[int, int]:
    """How many signals the written file brings alone to what the page says, within 5 %; of all."""
    pairs = [v for x in lines for v in (x.get("file") or {}).values() if v[2] > 0.0]
    return sum(abs(after - alone) <= 0.05 * alone for _, after, alone in pairs), len(pairs)
