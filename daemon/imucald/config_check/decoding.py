"""What the frames themselves show: what does not come, what is rejected, what that costs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from imucald.can.columns import CAN_EFF_FLAG, IdMatch
from imucald.config import LoadedConfig
from imucald.config_check.finding import Finding
from imucald.config_check.source import QuantitySource, configured_name, id_text, stated_cycle
from imucald.config_check.statistics import Probe
from imucald.core.clock_words import clock
from imucald.mount.signal_blocks import ACCEL_GAP, SPEED_GAP

CYCLE_TOLERANCE = 1.5
"""A cycle is reported when it is so many times longer or shorter than the database states."""
MIN_REJECTED_SHARE = 0.01
"""Part of rejected frames or values from which it is reported."""
MIN_EQUAL_VALUES = 100
"""So many equal values of a sensor in a row, and no other, look stuck."""

SLOWEST = {"accel": ACCEL_GAP, "gyro": ACCEL_GAP, "speed": SPEED_GAP}
"""Longest time between two samples that the calibration bridges [s]."""

_NO_SPEED = "missing: yaw takes longer and is less certain; "
_NO_GYRO = "pitch and roll get nothing from turns, and no corrected angular rate is sent"
_NO_TURNS = "so are yaw rate and steering angle"
_STEADY = "only steady angles show straight motion"
_NEVER = (
    "no bend can show that the signs are right, so that no drive makes the mount usable; configure "
    "one of the three, or 'estimator: published'; a stated mount ('calibration: mount') serves too"
)
_NO_REVERSE = "missing: reversing reads as braking, which costs some accuracy"
_NO_SIDE = "unknown: a road crown reads as mount roll (about 0.7 deg); say left or right"
_REMEDIES = {
    "checksum": "; see 'checksum:' (kind, id_bytes, data_id) of the message",
    "counter": "; see 'counter:' (signal, modulus, max_step) of the message",
    "doubled": "; each counts once, nothing is lost: a gateway or the logger wrote copies",
    "short_frame": "; the database describes a longer frame: is it this vehicle's?",
    "long_frame": "; the database describes a shorter frame: is it this vehicle's?",
    "timeout": "; the message stops now and then: its cable, its sender, or 'cycle_time:'",
    "counter_repeated": "; a gateway or a second log sends the same again, or see 'counter:' "
    "(signal, modulus, max_step) of the message",
    "duplicate_sender": "; a second unit sends this identifier, or a gateway sends it again",
    "too_fast": "; it comes far more often than usual: see its sender, or 'cycle_time:'",
    "status": "; the sensor says that it cannot be used, or see 'valid_when:' of the source",
    "out_of_range": "; see 'range:' of the source, and its unit",
    "not_available": "; the sender says so, or see 'not_available:' of the source",
    "saturated": "; the sensor runs into its end, or the database's range is too narrow",
}


STOPPED_S, STOPPED_CYCLES = 10.0, 20.0
"""A message that stops so long before the end [s], and so many of its cycles, is reported."""


@dataclass(frozen=True)
class Decoding:
    """What there is to judge: ids seen (channel, id with flag), samples by channel, duration [s],
    clock steps, bad lines by reason."""

    loaded: LoadedConfig
    probes: list[Probe]
    sources: list[QuantitySource]
    ids: Mapping[tuple[str, int], int]
    samples: Mapping[str, int]
    duration: float
    steps: int
    bad_lines: Counter[str]
    output_ids: frozenset[int]
    drives: bool = False
    """For a minute at least: no axis of a sensor is the same all that time."""

    def findings(self) -> Iterator[Finding]:
        """Yield every finding, in no order."""
        yield from self._silent()
        yield from self._doubtful()
        yield from self._cycles()
        yield from self._too_slow()
        yield from self._nothing_left()
        yield from self._costs()
        yield from self._conflicts()

    def _has(self, channel: str) -> bool:
        return self.samples.get(channel, 0) > 0

    def _silent(self) -> Iterator[Finding]:
        """Messages that did not come, and frames that were all refused."""
        for probe in self.probes:
            quantity = ", ".join(dict.fromkeys(configured_name(tap.channel) for tap in probe.taps))
            if not probe.frames:
                text = f"no frame of {probe.name} ({id_text(probe.match.can_id)}) came"
                yield Finding("warning", quantity, text + self._elsewhere(probe.match))
                continue
            if self._has_stopped(probe):
                when = f"from {clock(probe.last or 0.0)} on, of {clock(self.duration)}"
                yield Finding("warning", quantity, f"no frame of {probe.name} comes {when}")
            bad = probe.rejected.total()
            if bad > MIN_REJECTED_SHARE * probe.frames:
                reasons = counts_text(probe.rejected)
                text = f"{bad} of {probe.frames} frames of {probe.name} are rejected ({reasons})"
                yield Finding("warning", quantity, text + _remedy(probe.rejected))

    def _has_stopped(self, probe: Probe) -> bool:
        """Whether a message that came regularly came no more long before the end."""
        if probe.last is None or probe.cycle is None:
            return False
        return self.duration - probe.last > max(STOPPED_S, STOPPED_CYCLES * probe.cycle)

    def _elsewhere(self, match: IdMatch) -> str:
        """A hint where the frame came by another channel or with another kind of id."""
        channels = [c for c, can_id in self.ids if not (can_id ^ match.can_id) & match.full_mask]
        if channels:
            return f"; it comes on {', '.join(channels)}, the configuration says {match.channel}"
        flipped = IdMatch(match.can_id ^ CAN_EFF_FLAG, match.mask)
        if any(flipped.matches(can_id, c) for c, can_id in self.ids):
            bits = 11 if match.can_id & CAN_EFF_FLAG else 29
            return f"; the same number comes as a {bits}-bit id"
        return ""

    def _doubtful(self) -> Iterator[Finding]:
        for source in self.sources:
            statistics = source.statistics
            good, bad = statistics.si.count, statistics.rejected.total()
            if bad > MIN_REJECTED_SHARE * (good + bad):
                reasons = counts_text(statistics.rejected)
                text = f"{bad} of {good + bad} values of {source.name} are rejected ({reasons})"
                yield Finding("warning", source.quantity, text + _remedy(statistics.rejected))
            if never_changes(source):
                text = f"never changes ({statistics.physical.least:g} {source.unit})"
                yield Finding("error" if self.drives else "warning", source.quantity, text)

    def _cycles(self) -> Iterator[Finding]:
        for probe in self.probes:
            stated = stated_cycle(self.loaded, probe)
            seen = probe.cycle
            if stated and seen and not 1 / CYCLE_TOLERANCE < seen / stated < CYCLE_TOLERANCE:
                text = f"{probe.name} comes every {1e3 * seen:.3g} ms, stated are {1e3 * stated:g}"
                yield Finding("note", "", text)
        if self.bad_lines:
            text = f"lines that cannot be used: {counts_text(self.bad_lines)}"
            yield Finding("warning", "log", text)
        if self.steps:
            text = f"jumps of the time stamps: {self.steps}; holes, or a clock that was set"
            yield Finding("note", "", text)

    def _too_slow(self) -> Iterator[Finding]:
        """What comes so seldom that the calibration cannot bridge from one sample to the next."""
        for channel, longest in SLOWEST.items():
            cycles = [
                probe.cycle
                for probe in self.probes
                if probe.cycle is not None and any(tap.channel == channel for tap in probe.taps)
            ]
            if cycles and min(cycles) > longest:
                text = (
                    f"comes every {min(cycles):.3g} s: the calibration uses none of it, it needs a "
                    f"sample every {longest:g} s at least"
                )
                name = configured_name(channel)
                yield Finding("error" if channel == "accel" else "warning", name, text)

    def _nothing_left(self) -> Iterator[Finding]:
        """An accelerometer of which the calibration can use nothing, though samples came."""
        left = self.samples.get("accel", 0)
        if left > 1 and self.duration == 0.0:
            text = "no time passes: all frames have one time stamp; record with: candump -l can0"
            yield Finding("error", "log", text)
        ours = [
            p for p in self.probes if any(tap.channel == "accel" for tap in p.taps) and p.frames
        ]
        refused = sum((probe.refused for probe in ours), Counter[str]())
        rejected = refused.copy()
        for source in self.sources:
            if source.wanted.channel == "accel":
                rejected += source.statistics.rejected
        # rejections take most of it, and leave less than a sample in each gap that is bridged
        if 0 < left < min(rejected.total(), self.duration / ACCEL_GAP):
            text = (
                f"nearly all of it is rejected ({counts_text(rejected)}): the calibration needs a "
                f"sample every {ACCEL_GAP:g} s, {left} came in {self.duration:.0f} s"
            )
            yield Finding("error", "accelerometer", text)
        elif left and all(2 * p.refused.total() > p.frames for p in ours):
            text = (
                f"most of its frames are rejected ({refused.total()} of "
                f"{sum(p.frames for p in ours)}: {counts_text(refused)}): the calibration does not "
                "learn from a sensor that cannot be trusted"
            )
            yield Finding("error", "accelerometer", text)

    def _costs(self) -> Iterator[Finding]:
        """What is missing, and what that costs."""
        config = self.loaded.config
        if not self._has("accel"):
            text = "gives no sample: nothing can be calibrated"
            yield Finding("error", "accelerometer", text)
        if not self._has("speed"):
            yield Finding("warning", "speed", _NO_SPEED + self._direction_without_speed())
        if not self._has("gyro"):
            yield self._without_gyro()
        elif not self._has("yaw_rate"):
            yield Finding("note", "yaw_rate", "missing: turns are taken from the gyroscope")
        if self._has("speed") and not self._has("reverse"):
            yield Finding("note", "reverse", _NO_REVERSE)
        if config.vehicle.driving_side == "unknown" and config.signals.accelerometer[0].z:
            yield Finding("note", "vehicle.driving_side", _NO_SIDE)

    def _direction_without_speed(self) -> str:
        if self._has("brake"):
            return "the brake switch separates forward from backward"
        if self._has("yaw_rate") or self._has("gyro"):
            return "turns and the first motion after a stop separate forward from backward"
        return "only the first motion after a stop separates forward from backward"

    def _without_gyro(self) -> Finding:
        for channel in ("yaw_rate", "steering"):
            if self._has(channel):
                text = f"missing: turns are taken from {configured_name(channel)}; {_NO_GYRO}"
                return Finding("note", "gyroscope", text)
        missing = f"missing, and {_NO_TURNS}: "
        if self.loaded.config.calibration.estimator == "published":
            return Finding("note", "gyroscope", f"{missing}{_STEADY}; {_NO_GYRO}")
        return Finding("warning", "gyroscope", missing + _NEVER)

    def _conflicts(self) -> Iterator[Finding]:
        for can_id in sorted(self.output_ids):
            seen = sum(n for (_, other), n in self.ids.items() if other == can_id)
            if seen:
                text = (
                    f"{id_text(can_id)} is on this bus already ({seen} frames): imucald sent it, "
                    "or another unit does; then choose another under 'output: ids:'"
                )
                yield Finding("warning", "output.ids", text)


def _remedy(reasons: Counter[str]) -> str:
    """A hint for the most frequent reason; "untrusted" is what follows any other."""
    causes = [reason for reason, _ in reasons.most_common() if reason != "untrusted"]
    kind = causes[0] if causes else ""
    general = _REMEDIES["counter"] if kind.startswith("counter") else ""
    return _REMEDIES.get(kind, general)


def counts_text(reasons: Counter[str]) -> str:
    """Reasons with their numbers, the most frequent first."""
    return ", ".join(f"{reason} {n}" for reason, n in reasons.most_common())


def never_changes(source: QuantitySource) -> bool:
    """Whether an axis of accelerometer or gyroscope says the same all the time."""
    values = source.statistics.si
    is_sensor = source.wanted.channel in ("accel", "gyro")
    return is_sensor and values.count >= MIN_EQUAL_VALUES and values.least == values.largest
