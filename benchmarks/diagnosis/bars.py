"""What the diagnosis is held against: each bar with its figure, met or not."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence

from benchmarks.diagnosis.judged import (
    LONG_MIN,
    Line,
    asked_of,
    driven,
    fair_outside,
    file_alone,
    intervals,
    is_long,
    is_right,
    is_wrong_alone,
    long_logs,
    statements,
    wrong_names,
)
from benchmarks.diagnosis.measured_logs import LOOSE
from benchmarks.diagnosis.outside_effects import NOT_RUN
from benchmarks.diagnosis.real_effects import DEG, EFFECTS
from benchmarks.measured import verdict

ASKED: Mapping[str, float] = {
    "accel_bias": 0.2, "accel_bias_x": 0.2, "gyro_bias": 0.1 * DEG, "gyro_scale": 0.06,
    "speed_scale": 0.06, "speed_late": 0.2, "remount": 4.0 * DEG, "clipped": 0.02,
    "gyro_stuck": 30.0, "speed_stuck": 30.0, "lost": 0.02, "steering_offset": 3.0 * DEG,
}  # fmt: skip
"""Effect to the size [SI] that is to be found in 15 min and more with a gyroscope."""
GYRO_BIAS_WITHOUT_STOPS, STOP_S = 0.3 * DEG, 10.0
"""A mean over 10 s knows the zero to 0.002 deg/s (BMI160 data sheet: 0.007 deg/s a root Hz)."""
NEW = "the last twelve, none of which was run before this judge"
PLAIN_LEVEL = 2
"""Size at which a diagnosis without a model file is judged: the third."""
PER_HOUR_S, MIDDLE_S, MIB = 60.0, 30.0, 1024.0


def bars(by_part: Mapping[str, Sequence[Line]]) -> Iterator[str]:
    """One line a bar. by_part: outcomes of each part."""
    nulls = [x for x in by_part["nulls"] if "refused" not in x]
    of = {part: asked_of(lines) for part, lines in by_part.items()}
    everything = [x for lines in of.values() for x in lines]
    if of["measured"]:
        yield from _hidden(of["measured"], nulls)
    if nulls:
        yield _unmodified(nulls)
    if everything:
        beyond = [f"{k} in {x['key']}" for x in everything for k in x.get("implausible", ())]
        yield _line(2, "found beyond the plausible range", len(beyond), "none", not beyond)
    yield from _simulated(of)
    yield from _plain(driven(of["plain"]))
    yield from _calibrated(everything)
    if of["outside"]:
        yield from _outside(of["outside"], nulls)
    near, signals = file_alone(everything)
    if signals:
        found = f"{near} of {signals} signals"
        yield _line(6, "written file within 5 % of what the page says", found, "all",
                    near == signals)  # fmt: skip
    yield from _cost(everything)
    crashed = [x for x in everything if "crash" in x]
    if crashed:
        yield f"- Ended by an exception, counted as wrong: {len(crashed)}, {crashed[0]['crash']}"


def _line(number: int, what: str, figure: object, bar: object, met: bool, more: str = "") -> str:
    return f"- {number}, {what}: {figure} (bar {bar}): {verdict(met)}{more}."


def _part_of(count: int, total: int) -> str:
    return f"{count} of {total} ({100.0 * count / max(total, 1):.1f} %)"


def _hidden(lines: Sequence[Line], nulls: Sequence[Line]) -> Iterator[str]:
    wrong = sum(bool(wrong_names(x)) for x in lines)
    more = f"; alone in {sum(map(is_wrong_alone, lines))}"
    yield _line(1, "wrong name where an effect is hidden in a measured log",
                _part_of(wrong, len(lines)), "3 %", wrong <= 0.03 * len(lines), more)  # fmt: skip
    held, sized = intervals(lines, nulls)
    if sized:
        yield _line(1, "interval holds the hidden size", _part_of(held, sized), "90 %",
                    held >= 0.9 * sized)  # fmt: skip
    found = found_at_or_below(lines)
    good = sum(map(sum, found.values()))
    total = sum(map(len, found.values()))
    if total:
        each = ", ".join(f"{name} {_asked(name)} {sum(x)}/{len(x)}" for name, x in found.items())
        yield _line(1, f"found at or below the size that is asked for, in {LONG_MIN:.0f} min and "
                    "more with a gyroscope", _part_of(good, total), "90 %", good >= 0.9 * total,
                    f": {each}")  # fmt: skip
    absent = [name for name in ASKED if name not in found]
    if absent:
        yield f"- 1, not tested in a log of {LONG_MIN:.0f} min: {', '.join(absent)}."


def _plain(lines: Sequence[Line]) -> Iterator[str]:
    at = [x for x in lines if x["level"] == PLAIN_LEVEL]
    for what, own, bar in (
        ("8 min and more", at, 0.6), ("15 min and more", [x for x in at if is_long(x)], 0.85)
    ):  # fmt: skip
        if own:
            good = sum(map(is_right, own))
            yield _line(8, f"without a model file, size 3 named in {what}",
                        _part_of(good, len(own)), f"{100 * bar:.0f} %",
                        good >= bar * len(own))  # fmt: skip
    if lines:
        wrong = sum(map(is_wrong_alone, lines))
        yield _line(8, "without a model file, a wrong name alone", _part_of(wrong, len(lines)),
                    "2 %", wrong <= 0.02 * len(lines))  # fmt: skip


def _asked(effect: str) -> str:
    return f"{ASKED[effect] / EFFECTS[effect].per:g} {EFFECTS[effect].unit}"


def found_at_or_below(lines: Sequence[Line]) -> dict[str, list[bool]]:
    """Effect to one entry a log and draw: found at the size asked for or at a smaller one. A draw
    counts once the size asked for was run."""
    logs = long_logs(lines)
    found: dict[str, list[bool]] = {}
    for effect in ASKED:
        draws: dict[tuple[str, int], list[Line]] = defaultdict(list)
        for x in lines:
            if x["effect"] == effect and x["log"] in logs:
                draws[x["log"], x["draw"]].append(x)
        for some in draws.values():
            asked = _asked_size(some)
            below = [x for x in some if _size(x) <= asked]
            if any(_size(x) == asked for x in below):
                found.setdefault(effect, []).append(any(map(is_right, below)))
    return found


def _size(line: Line) -> float:
    return EFFECTS[line["effect"]].sizes[line["level"]]


def _asked_size(of_draw: Sequence[Line]) -> float:
    asked = ASKED[of_draw[0]["effect"]]
    if of_draw[0]["effect"] == "gyro_bias":
        piece = [x for x in of_draw if _size(x) == asked]
        if not all(x.get("longest_stop_s", 0.0) >= STOP_S for x in piece):
            return GYRO_BIAS_WITHOUT_STOPS
    return asked


def _unmodified(lines: Sequence[Line]) -> str:
    """`unknown` is right of a phone that is held loosely, and of nothing else."""
    loose = [x for x in lines if x["log"] in LOOSE]
    firm = [x for x in lines if x["log"] not in LOOSE]
    good = sum(is_right(x) and x["verdict"] != "unknown" for x in firm)
    good += sum(map(is_right, loose))
    more = f"; {len(loose)} are of phones held loosely, which may be `unknown`"
    return _line(2, "unmodified piece: `nothing`, or what is known to be true of it",
                 _part_of(good, len(lines)), "95 %", good >= 0.95 * len(lines), more)  # fmt: skip


def _simulated(of: Mapping[str, Sequence[Line]]) -> Iterator[str]:
    if own := of["second_world"]:
        good, bad = sum(map(is_right, own)), sum(bool(wrong_names(x)) for x in own)
        yield _line(3, "drives of `second_world` right", f"{good} of {len(own)}", "12 of 14",
                    good * 14 >= 12 * len(own))  # fmt: skip
        yield _line(3, "drives of `second_world` with something invented", bad, "1", bad <= 1)
    for part, what in (
        ("generated", "named rightly in drives of the generator"),
        ("generated_nulls", "nothing invented in sound drives of the generator"),
        ("generated_outside", "outside effects seen in drives of the generator"),
    ):
        if own := of[part]:
            good = sum(map(is_right, own))
            bar = 0.8 if part == "generated_outside" else 0.95
            number = 5 if part == "generated_outside" else 3
            yield _line(number, what, _part_of(good, len(own)), f"{100 * bar:.0f} %",
                        good >= bar * len(own))  # fmt: skip


def _calibrated(lines: Sequence[Line]) -> Iterator[str]:
    sure, right, likely, good = statements(lines)
    if sure:
        yield _line(4, "reported as certain and right", _part_of(right, sure), "97 %",
                    right >= 0.97 * sure)  # fmt: skip
    if likely:
        yield _line(4, "reported as likely and right", _part_of(good, likely), "80 to 97 %",
                    0.8 * likely <= good <= 0.97 * likely)  # fmt: skip


def _outside(lines: Sequence[Line], nulls: Sequence[Line]) -> Iterator[str]:
    fair = fair_outside(lines, nulls)
    new = [x for x in fair if x["effect"] in NOT_RUN]
    for what, own in (("all", fair), (NEW, new)):
        if own:
            seen, wrong = _seen_and_wrong(own)
            yield _line(5, f"outside effects seen in measured logs, {what}",
                        _part_of(seen, len(own)), "80 %", seen >= 0.8 * len(own))  # fmt: skip
            yield _line(5, f"a wrong name for an outside effect, {what}",
                        _part_of(wrong, len(own)), "5 %", wrong <= 0.05 * len(own))  # fmt: skip


def _seen_and_wrong(lines: Sequence[Line]) -> tuple[int, int]:
    return sum(map(is_right, lines)), sum(bool(wrong_names(x)) for x in lines)


def _cost(lines: Sequence[Line]) -> Iterator[str]:
    long = [x for x in lines if x.get("minutes", 0.0) >= LONG_MIN]
    per_hour = sorted(float(x["cpu_s_per_h"]) for x in long)
    if not per_hour:
        return
    middle = per_hour[len(per_hour) // 2]
    yield _line(7, "processor time an hour of driving, most [s]", f"{per_hour[-1]:.0f}",
                f"{PER_HOUR_S:.0f}", per_hour[-1] <= PER_HOUR_S)  # fmt: skip
    yield _line(7, "processor time an hour of driving, median [s]", f"{middle:.0f}",
                f"{MIDDLE_S:.0f}", middle <= MIDDLE_S)  # fmt: skip
    most = max(x["mib"] for x in lines if "mib" in x)
    yield _line(7, "memory, the benchmark's own logs included [MiB]", most, f"{MIB:.0f}",
                most < MIB)  # fmt: skip
