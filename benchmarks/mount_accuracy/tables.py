"""Tables of errors and coverage, and the bars on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from benchmarks.integrity.force import ENTRIES
from benchmarks.measured import verdict
from benchmarks.mount_accuracy.drives import Trace

AXES = ("roll", "pitch", "yaw")


def quantiles(values: np.ndarray) -> tuple[float, float]:
    """Median and 90th percentile of sizes."""
    sizes = np.abs(values)
    return float(np.median(sizes)), float(np.quantile(sizes, 0.9))


def table(found: dict[str, list[Trace]], times: Sequence[float]) -> list[str]:
    """Median and 90th percentile of the errors, and how often the interval holds the truth."""
    lines = [
        "| estimator | after | roll p50 / p90 | roll beyond the crown p50 / p90 | pitch p50 / p90"
        " | yaw p50 / p90 | 95 % interval holds roll, pitch, yaw |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, runs in found.items():
        for minutes in times:
            said = [trace.said[minutes] for trace in runs if minutes in trace.said]
            if not said:
                continue
            error = np.array([s.error for s in said])
            std = np.array([s.std for s in said])
            beyond = np.array([s.beyond_crown for s in said])
            held = 100.0 * (np.abs(error) <= 1.96 * std).mean(axis=0)
            cells = [quantiles(error[:, 0]), quantiles(beyond)]
            cells += [quantiles(error[:, 1]), quantiles(error[:, 2])]
            middle = " | ".join(f"{a:.2f} / {b:.2f}" for a, b in cells)
            less = "" if len(said) == len(runs) else f" ({len(said)} of {len(runs)})"
            lines.append(
                f"| {name}{less} | {minutes:g} min | {middle} |"
                f" {held[0]:.0f}, {held[1]:.0f}, {held[2]:.0f} % |"
            )
    return lines


def force_table(found: dict[str, list[Trace]], times: Sequence[float]) -> list[str]:
    """Of what a consumer gets: error, median and 90th percentile, and the median of what is stated.

    Cross-talk of the force and of the rate [deg], level zero [m/s^2].
    """
    names = " |".join(f" {name}" for name in ENTRIES)
    lines = [
        f"| estimator | after |{names} | rms(error/deviation) | 95 % holds |",
        "|---" * (len(ENTRIES) + 4) + "|",
    ]
    for name, runs in found.items():
        for minutes in times:
            said = [trace.said[minutes] for trace in runs if minutes in trace.said]
            if not said:
                continue
            left, std = np.array([s.left for s in said]), np.array([s.left_std for s in said])
            cells = [
                "{:.2f} / {:.2f}, s {:.2f}".format(*quantiles(left[:, i]), np.median(std[:, i]))
                for i in range(len(ENTRIES))
            ]
            z = left / std
            lines.append(
                f"| {name} | {minutes:g} min | {' | '.join(cells)} |"
                f" {np.sqrt(np.mean(z**2)):.2f} | {100.0 * np.mean(np.abs(z) <= 1.96):.0f} % |"
            )
    return lines


def bars(runs: list[Trace], times: Sequence[float]) -> list[str]:
    """The bars on the joint estimator's errors, and what carried each angle."""
    lines = [""]
    last = max(times)

    def column(minutes: float, axis: int) -> np.ndarray:
        return np.array([t.said[minutes].error[axis] for t in runs if minutes in t.said])

    p50, p90 = quantiles(column(5.0, 2))
    lines.append(
        f"- Yaw after 5 min: median {p50:.2f} (bar 0.2: {verdict(p50 <= 0.2)}),"
        f" 90th percentile {p90:.2f} deg (bar 0.5: {verdict(p90 <= 0.5)})."
    )
    p50, _ = quantiles(column(last, 2))
    lines.append(
        f"- Yaw after {last:g} min: median {p50:.3f} deg (bar 0.08: {verdict(p50 <= 0.08)})."
    )
    _, p90 = quantiles(column(last, 1))
    lines.append(
        f"- Pitch after {last:g} min: 90th percentile {p90:.2f} deg"
        f" (bar 0.35: {verdict(p90 <= 0.35)})."
    )
    beyond = np.array([t.said[last].beyond_crown for t in runs if last in t.said])
    _, p90 = quantiles(beyond)
    lines.append(
        f"- Roll beyond the drive's mean crown after {last:g} min: 90th percentile {p90:.2f} deg"
        f" (bar 0.4: {verdict(p90 <= 0.4)})."
    )
    held = []
    for minutes in times:
        said = [t.said[minutes] for t in runs if minutes in t.said]
        inside = [np.abs(s.error) <= 1.96 * s.std for s in said]
        held += (100.0 * np.mean(inside, axis=0)).tolist()
    share = float(np.mean(held))
    within = all(90.0 <= h <= 98.0 for h in held)
    lines.append(
        f"- Coverage: {min(held):.0f} to {max(held):.0f} %, mean {share:.0f} %"
        f" (bar 90-98 % of each: {verdict(within)})."
    )
    for axis in AXES:
        totals: dict[str, float] = {}
        for trace in runs:
            if last not in trace.said:
                continue
            for name, weight in trace.said[last].shares.get(axis, {}).items():
                totals[name] = totals.get(name, 0.0) + weight / len(runs)
        text = ", ".join(
            f"{100.0 * w:.0f} % {name.split('_', 1)[1]}"
            for name, w in sorted(totals.items(), key=lambda item: -item[1])
        )
        lines.append(f"- {axis.capitalize()} after {last:g} min is carried by: {text}.")
    usable = [
        t.usable_after if not np.isnan(t.usable_after) else np.inf
        for t in runs
        if t.manoeuvres_after <= 90.0
    ]
    if usable:
        median = float(np.median(usable))
        lines.append(
            f"- Driving until usable, where 90 s hold three launches or brakings: median"
            f" {median:.0f} s in {len(usable)} drives (bar 90 s: {verdict(median <= 90.0)})."
        )
    cost = float(np.median([t.microseconds for t in runs]))
    lines.append(
        f"- Cost: {cost:.0f} us per tick on average, an hour of driving in"
        f" {cost * 36000e-6:.1f} s (bar 8 s: {verdict(cost * 36000e-6 <= 8.0)})."
    )
    return lines
