"""Faulty sensors of a log, as `imucald check` says about them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from imucald.config_check.finding import Finding
from imucald.config_check.source import configured_name
from imucald.motion.sample_health import FaultEvent
from imucald.motion.signal_health import SignalFault

_WORDS = {
    SignalFault.STUCK: "repeats one value",
    SignalFault.SATURATED: "stays at the end of its range: is a range set too small?",
    SignalFault.IMPLAUSIBLE: "has values impossible in a road vehicle, or another unit than before",
}


def health_findings(events: Iterable[FaultEvent]) -> Iterator[Finding]:
    """One finding for each sensor, fault and axes, with the first time and how often."""
    found: dict[tuple[str, SignalFault, str], list[float]] = {}
    for event in events:
        found.setdefault((event.channel, event.fault, event.axes), []).append(event.since)
    for (channel, fault, axes), times in found.items():
        often = f", {len(times)} times" if len(times) > 1 else ""
        text = (
            f"{', '.join(axes)} {_WORDS[fault]} ({fault}, from {times[0]:.1f} s on{often}); its "
            "corrected frames would not be available then"
        )
        yield Finding("warning", configured_name(channel), text)
