"""Find faulty sensors and signals in a log, for `imucald check`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucald.config import Config
from imucald.config_check.finding import Finding
from imucald.config_check.source import configured_name
from imucald.core.samples import Samples
from imucald.motion.sample_health import SampleHealth
from imucald.motion.signal_health import FaultEvent, SignalFault
from imucald.motion.ticks import TickRow, tick_index
from imucald.mount.estimate import MountEstimate, MountState
from imucald.mount.estimator_settings import EstimatorSettings
from imucald.mount.explanation import left_out_details
from imucald.mount.mount_words import left_out_words
from imucald.mount.signal_blocks import SignalBlockMaker
from imucald.runtime.pipeline import Pipeline

MOST_SHARE = 0.5
"""A signal that is ignored for more than this share of a log is not used as evidence. If more than
this share of a log cannot be used, this is a warning."""
_WORDS = {
    SignalFault.STUCK: "repeats one value",
    SignalFault.SATURATED: "stays at the end of its range (is the range in the sensor or in the "
    "database too small?)",
    SignalFault.IMPLAUSIBLE: "has values that no road vehicle reaches (did its unit change?)",
}


class _SignalsOnly:
    """Replaces an estimator in this check: it only finds stuck signals and estimates no mount."""

    correction, state = None, MountState.WAITING

    def __init__(self, settings: EstimatorSettings) -> None:
        self.blocks = SignalBlockMaker(settings)

    @property
    def stuck_signals(self) -> Mapping[str, bool]:
        return self.blocks.stuck

    def step(self, tick: TickRow) -> None:
        if self.blocks.push(tick):
            self.blocks.block()

    def gap(self) -> None:
        self.blocks.restart()

    def estimate(self) -> MountEstimate:
        return MountEstimate(self.state)

    def quiet_ticks(self) -> int:
        return self.blocks.until_block - 1

    def keep_quiet(self, ticks: NDArray[np.float64]) -> None:
        self.blocks.push_all(ticks)


class LogHealth:
    """Checks the sensors and signals of a log as `run` does, chunk by chunk.

    axes: the number of measured axes of each channel.
    """

    def __init__(self, axes: Mapping[str, int], config: Config) -> None:
        settings = EstimatorSettings(config.calibration, config.vehicle)
        self._signals = _SignalsOnly(settings)
        self._pipeline = Pipeline(self._signals, health=SampleHealth(axes))

    def gap(self, t: float) -> None:
        """Register a jump of stream time to t [s]."""
        self._pipeline.gap(tick_index(t))

    def add_samples(self, samples: Samples, t_last: float) -> None:
        """Add samples of all channels, up to stream time t_last [s]."""
        self._pipeline.run(samples, {}, t_last, with_snapshots=False)

    @property
    def left_out(self) -> Sequence[Mapping[str, Any]]:
        """Return the data that the calibration ignores, see `left_out_details`."""
        return left_out_details(self._signals.blocks)

    @property
    def events(self) -> Iterable[FaultEvent]:
        """Return the faults so far."""
        return self._pipeline.health.events


def health_findings(events: Iterable[FaultEvent]) -> Iterator[Finding]:
    """Yield one finding per sensor, fault and axes, with the time of the first fault and the number
    of faults."""
    found: dict[tuple[str, SignalFault, str], list[float]] = {}
    for event in events:
        found.setdefault((event.channel, event.fault, event.axes), []).append(event.since)
    for (channel, fault, axes), times in found.items():
        often = f", {len(times)} times" if len(times) > 1 else ""
        what = f"{', '.join(axes)} {_WORDS[fault]}".strip()
        then = (
            "the daemon would send 'not available' for that time"
            if axes
            else "the daemon would not use it for that time"
        )
        text = f"{what} ({fault}, from {times[0]:.1f} s on{often}); {then}"
        yield Finding("warning", configured_name(channel), text)


def jumping_finding(left_out: Sequence[Mapping[str, Any]], duration: float) -> Iterator[Finding]:
    """Report a speed that jumps in most of a log. Such a signal is not the speed of one vehicle.
    duration: duration of the log [s].
    """
    for one in left_out:
        if one["cause"] == SignalFault.SPEED_JUMP and one["seconds"] > MOST_SHARE * duration:
            text = (
                f"jumps more than a vehicle can, in {one['seconds']:.0f} of {duration:.0f} s, "
                "so no other signal is checked against it. Do several control units send it "
                "('source_address:', 'channel:')? Is it the right signal?"
            )
            yield Finding("error", configured_name(one["signal"]), text)


def left_out_finding(
    left_out: Sequence[Mapping[str, Any]], duration: float, is_explained: bool
) -> Iterator[Finding]:
    """Report the time that the calibration ignores. duration: duration of the log [s].
    is_explained: an error says why, so most of the log is not a warning of its own."""
    if words := left_out_words({"not_learnt_from": left_out}):
        is_most = is_mostly_unused(used_s(left_out, duration), duration)
        text = f"of {duration:.0f} s, {words} could not be used for the mount"
        yield Finding("warning" if is_most and not is_explained else "note", "log", text)


def is_mostly_unused(used: float, duration: float) -> bool:
    """Return whether most of a log of this duration [s] could not be used. used: as `used_s`."""
    return duration - used > MOST_SHARE * duration


def used_s(left_out: Sequence[Mapping[str, Any]], duration: float) -> float:
    """Return the time from which the mount could be learnt [s]. Each moment that could not be used
    has one cause, so the times of the causes add up."""
    return max(duration - sum(float(one["seconds"]) for one in left_out), 0.0)
