"""Findings from the frames: missing messages, rejected frames, and the consequences."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, IdMatch
from imucald.can.dbc.decode import J1939_ADDRESS_MASK, id_match
from imucald.can.j1939_transport import in_transport
from imucald.can.lost_frames import dropping_recorder
from imucald.config import LoadedConfig
from imucald.config_check.finding import Finding, cut_frames
from imucald.config_check.source import QuantitySource, configured_name, id_text, stated_cycle
from imucald.config_check.statistics import Probe
from imucald.core.text import clock, counted
from imucald.inputs.router import OF_SENSOR
from imucald.inputs.routes import MessageRoute
from imucald.mount.signal_blocks import ACCEL_GAP, SPEED_GAP

CYCLE_TOLERANCE = 1.5
"""A cycle is reported if it differs from the database's cycle by more than this factor."""
MIN_REJECTED_SHARE = 0.01
"""Smallest share of rejected frames or values that is reported."""
MIN_EQUAL_VALUES = 100
"""A sensor counts as stuck if it has sent at least this number of values and all values are
equal."""

SLOWEST = {"accel": ACCEL_GAP, "gyro": ACCEL_GAP, "speed": SPEED_GAP}
"""Longest time between two samples for which the calibration interpolates [s], by channel."""

SELDOM_SPEED = 1.5
"""Longest useful cycle of the speed [s]. A speed with a longer cycle does not show motions shorter
than 3 s, such as most starts and brakings. In simulated drives with a speed at 0.5 Hz, the
calibration took twice as long."""

_NO_SPEED = "missing: yaw is found later and is less certain; "
_NO_GYRO = (
    "without a gyroscope, turns do not help to find pitch and roll, and no corrected angular rate "
    "is sent"
)
_NO_TURNS = "yaw rate and steering angle are missing too"
_STEADY = "straight driving is recognised only where successive target angles agree"
_NEVER = (
    "no signal shows turns, so the signs cannot be checked and the mount never becomes "
    "usable. Configure one of the three signals, or 'estimator: published', or state the "
    "mount ('calibration: mount')"
)
_NO_REVERSE = (
    "missing: driving backwards looks like braking, so the mount is a little less accurate"
)
_NO_SIDE = (
    "unknown: the roll of the mount may be off by about 0.7 deg, since roads slope to the "
    "side; state left or right"
)

_REMEDIES = {
    "checksum": "; check 'checksum:' (kind, id_bytes, data_id) of the message",
    "counter": "; check 'counter:' (signal, modulus, max_step) of the message",
    "doubled": "; a gateway or the logger wrote copies. Each frame is used once: nothing is lost",
    "short_frame": "; the database describes a longer frame: is it this vehicle's?",
    "long_frame": "; the database describes a shorter frame: is it this vehicle's?",
    "too_early": "; a second control unit sends this identifier, or a gateway sends it again",
    "counter_repeated": "; a gateway or a second log sends the same frames again, or 'counter:' "
    "(signal, modulus, max_step) of the message is wrong",
    "duplicate_sender": "; a second control unit sends this identifier, or a gateway sends it "
    "again",
    "too_fast": "; the message comes far more often than usual: check its sender, or set "
    "'cycle_time:'",
    "status": "; the sensor says that its value cannot be used, or 'valid_when:' of the source is "
    "wrong",
    "out_of_range": "; check 'range:' of the source, and its unit",
    "not_available": "; the sender marks the value as not available, or 'not_available:' of the "
    "source is wrong",
    "saturated": "; the sensor reaches the end of its range, or the range in the database is too "
    "narrow",
}


COARSE = ", although its frames come more often (are the time stamps too coarse?)"
BURST_S = 0.5
"""Longest delay after which an adapter delivers frames in one burst [s]."""


@dataclass(frozen=True)
class Decoding:
    """Makes findings from the data of a log: received ids (channel, id with flag), samples by
    channel, duration [s], clock steps, bad lines by reason."""

    loaded: LoadedConfig
    probes: list[Probe]
    sources: list[QuantitySource]
    ids: Mapping[tuple[str, int], int]
    samples: Mapping[str, int]
    duration: float
    steps: int
    bad_lines: Counter[str]
    output_ids: frozenset[int]
    least_duration: float = 0.0
    """Time that all frames of the log need on the fastest bus [s]."""
    paces: Mapping[str, float] = field(default_factory=dict)
    """Usual time between two ticks with samples, by channel [s]."""
    announced: Mapping[tuple[str, int], int] = field(default_factory=dict)
    """Length [bytes] of each message announced by J1939 transport frames, by (channel, id)."""
    drives: bool = False
    """True if the vehicle drives for at least a minute. In this time, every sensor axis changes."""
    is_reverse_derived: bool = False
    """True if no reverse signal is configured and the sign of the speed is used as the reverse
    signal."""

    def findings(self) -> Iterator[Finding]:
        """Yield all findings, in no particular order."""
        yield from self._silent()
        yield from self._cut()
        yield from self._several_senders()
        yield from self._unused_senders()
        yield from self._doubtful()
        yield from self._cycles()
        yield from self._too_slow()
        yield from self._nothing_left()
        yield from self._costs()
        yield from self._conflicts()

    def _has(self, channel: str) -> bool:
        return self.samples.get(channel, 0) > 0

    def _silent(self) -> Iterator[Finding]:
        """Find configured messages that were not received, and messages whose frames were all
        rejected."""
        for probe in self.probes:
            names = dict.fromkeys(configured_name(tap.channel) for tap in probe.taps)
            quantity = ", ".join(names) or "sign_signal"
            if not probe.frames:
                text = f"no frame of {probe.name} ({id_text(probe.match.can_id)}) came"
                text += self._elsewhere(probe.match) or self._of_its_pgn(probe)
                yield Finding("warning", quantity, text)
                continue
            last = probe.has_stopped(self.duration)
            if last is not None:
                when = f"from {clock(last)} on, of {clock(self.duration)}"
                yield Finding("warning", quantity, f"no frame of {probe.name} comes {when}")
            bad = probe.rejected.total()
            if bad > MIN_REJECTED_SHARE * probe.frames:
                reasons = counts_text(probe.rejected)
                text = f"{bad} of {probe.frames} frames of {probe.name} are rejected ({reasons})"
                yield Finding("warning", quantity, text + _remedy(probe.rejected))

    def _elsewhere(self, match: IdMatch) -> str:
        """Return a hint if frames with the same id number were received on another channel or with
        the other id length (11 or 29 bits)."""
        channels = [c for c, can_id in self.ids if not (can_id ^ match.can_id) & match.full_mask]
        if channels:
            return (
                f"; the message comes on {', '.join(channels)}, but the configuration states "
                f"{match.channel}"
            )
        flipped = IdMatch(match.can_id ^ CAN_EFF_FLAG, match.mask)
        if any(flipped.matches(can_id, c) for c, can_id in self.ids):
            bits = 11 if match.can_id & CAN_EFF_FLAG else 29
            return (
                f"; an id of the same number comes with {bits} bits: check the id in the database"
            )
        return ""

    def _of_its_pgn(self, probe: Probe) -> str:
        """Return a hint if the message's PGN was received from another address or in transport
        frames."""
        if not isinstance(probe.route, MessageRoute) or not probe.match.can_id & CAN_EFF_FLAG:
            return ""
        match = id_match(probe.route.plan.message, True, probe.match.channel)
        found = {i & J1939_ADDRESS_MASK for c, i in self.ids if match.matches(i, c)}
        if found:
            names = ", ".join(f"0x{address:02X}" for address in sorted(found))
            key = "set 'j1939: true' at its database to accept any address"
            if probe.match.mask != CAN_EFF_MASK:
                key = "see 'source_address:'"
            return f"; its PGN comes from the address {names}: {key}"
        sizes = [n for (c, can_id), n in self.announced.items() if match.matches(can_id, c)]
        return f"; {in_transport(max(sizes))}" if sizes else ""

    def _cut(self) -> Iterator[Finding]:
        for probe in self.probes:
            if not probe.frames or not isinstance(probe.route, MessageRoute):
                continue
            size = probe.route.plan.message.length
            if probe.shortest < size:
                yield Finding("warning", probe.name, cut_frames(probe.name, probe.shortest, size))

    def _several_senders(self) -> Iterator[Finding]:
        """Find J1939 messages that were received from several addresses although no source address
        is configured."""
        for probe in self.probes:
            match = probe.match
            if not match.can_id & CAN_EFF_FLAG or match.mask & J1939_ADDRESS_MASK:
                continue
            found = {i & J1939_ADDRESS_MASK for channel, i in self.ids if match.matches(i, channel)}
            if len(found) < 2:
                continue
            names = ", ".join(f"0x{address:02X}" for address in sorted(found))
            taken, address = "all of them are used", min(found)
            if probe.sender is not None and probe.sender.address is not None:
                address = probe.sender.address
                taken = f"0x{address:02X} is used (chosen in the first seconds)"
            text = (
                f"{probe.name} comes from {len(found)} addresses ({names}): {taken}; name the "
                f"sender: 'source_address: 0x{address:02X}'"
            )
            yield Finding("note" if probe.sender is None else "warning", probe.name, text)
        chosen = {
            probe.name: probe.sender.address
            for probe in self.probes
            if probe.sender is not None
            and probe.sender.address is not None
            and any(tap.channel in OF_SENSOR for tap in probe.taps)
        }
        if len(set(chosen.values())) > 1:
            names = ", ".join(f"{name} of 0x{address:02X}" for name, address in chosen.items())
            text = (
                f"its messages come from several senders ({names}). Are the senders one sensor? If "
                "not, name the sender with 'source_address:', or remove the signals of the "
                "other sensor"
            )
            yield Finding("warning", "accelerometer", text)

    def _unused_senders(self) -> Iterator[Finding]:
        """Find J1939 messages with a configured source address that other addresses send too."""
        for probe in self.probes:
            match = probe.match
            is_j1939 = match.can_id & CAN_EFF_FLAG and match.mask != CAN_EFF_MASK
            if not (probe.frames and is_j1939 and match.mask & J1939_ADDRESS_MASK):
                continue
            pgn = IdMatch(match.can_id, match.mask & ~J1939_ADDRESS_MASK, match.channel)
            others = {
                can_id & J1939_ADDRESS_MASK
                for channel, can_id in self.ids
                if pgn.matches(can_id, channel)
                and not any(p.match.matches(can_id, channel) for p in self.probes)
            }
            if others:
                names = ", ".join(f"0x{address:02X}" for address in sorted(others))
                used = match.can_id & J1939_ADDRESS_MASK
                text = f"{probe.name} of 0x{used:02X} is used; {names} sends the same PGN"
                yield Finding("note", probe.name, text)

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
            seen = [c for c in (probe.cycle, *probe.cycles) if c]
            # A database states the cycle of all frames of a message, or that of a group.
            if stated and seen and not any(_is_near(c, stated) for c in seen):
                text = (
                    f"{probe.name} comes every {1e3 * seen[-1]:.3g} ms, but the "
                    f"configuration or the database states {1e3 * stated:g} ms"
                )
                yield Finding("note", "", text)
        dropping = dropping_recorder([p.lost_share for p in self.probes])
        if dropping is not None:
            yield Finding("warning", "log", dropping)
        if self.bad_lines:
            text = f"some lines cannot be used: {counts_text(self.bad_lines)}"
            yield Finding("warning", "log", text)
        if self.steps:
            jumps = counted(self.steps, "jump")
            text = f"the time stamps have {jumps}: frames are missing, or the clock was set"
            yield Finding("note", "", text)

    def _too_slow(self) -> Iterator[Finding]:
        for channel, longest in SLOWEST.items():
            found = [probe.cycle_of(channel) for probe in self.probes]
            cycles = [cycle for cycle in found if cycle is not None]
            pace = self.paces.get(channel, 0.0)
            if cycles and max(min(cycles), pace) > longest:
                why = "" if min(cycles) > longest else COARSE
                text = (
                    f"comes every {max(min(cycles), pace):.3g} s{why}: the calibration does "
                    f"not use it, since it needs a sample at least every {longest:g} s"
                )
                name = configured_name(channel)
                yield Finding("error" if channel == "accel" else "warning", name, text)
            elif channel == "speed" and cycles and min(cycles) > SELDOM_SPEED:
                text = (
                    f"comes every {min(cycles):.3g} s: finding the mount takes about twice as "
                    "long as with a speed every second; request the speed more often"
                )
                yield Finding("note", configured_name(channel), text)

    def _nothing_left(self) -> Iterator[Finding]:
        """Report an accelerometer whose samples the calibration cannot use at all."""
        left = self.samples.get("accel", 0)
        if left > 1 and self.duration == 0.0:
            text = "all frames have the same time stamp; record with: candump -l can0"
            yield Finding("error", "log", text)
        elif self.least_duration > self.duration + BURST_S:
            text = (
                f"more frames than any CAN bus carries: {sum(self.ids.values())} in "
                f"{self.duration:.1f} s, where they take {self.least_duration:.1f} s at 1 "
                "Mbit/s: are the time stamps in milliseconds, or do they start again several "
                "times?"
            )
            yield Finding("error", "log", text)
        ours = [
            p for p in self.probes if any(tap.channel == "accel" for tap in p.taps) and p.frames
        ]
        refused = sum((probe.refused for probe in ours), Counter[str]())
        rejected = refused.copy()
        for source in self.sources:
            if source.wanted.channel == "accel":
                rejected += source.statistics.rejected
        # most samples are rejected: less than one remains in each gap that can be bridged
        if 0 < left < min(rejected.total(), self.duration / ACCEL_GAP):
            text = (
                f"nearly all samples are rejected ({counts_text(rejected)}): the calibration "
                f"needs a sample every {ACCEL_GAP:g} s, but {left} were left in "
                f"{self.duration:.0f} s"
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
        config = self.loaded.config
        if not self._has("accel"):
            text = "no sample was received; imucald needs an accelerometer"
            yield Finding("error", "accelerometer", text)
        if not self._has("speed"):
            yield Finding("warning", "speed", _NO_SPEED + self._direction_without_speed())
        if not self._has("gyro"):
            yield self._without_gyro()
        elif not self._has("yaw_rate"):
            yield Finding("note", "yaw_rate", "missing: the gyroscope is used for turns")
        if self._has("speed") and not self._has("reverse") and not self.is_reverse_derived:
            yield Finding("note", "reverse", _NO_REVERSE)
        if config.vehicle.driving_side == "unknown" and config.signals.accelerometer[0].z:
            yield Finding("note", "vehicle.driving_side", _NO_SIDE)

    def _direction_without_speed(self) -> str:
        if not self.loaded.config.uses_method_a:
            return "turns distinguish forward from backward"
        if self._has("brake"):
            return "the brake switch distinguishes forward from backward"
        if self._has("yaw_rate") or self._has("gyro"):
            return "turns and the first motion after a stop distinguish forward from backward"
        return "only the first motion after a stop distinguishes forward from backward"

    def _without_gyro(self) -> Finding:
        for channel in ("yaw_rate", "steering"):
            if self._has(channel):
                text = f"missing: {configured_name(channel)} is used for turns; {_NO_GYRO}"
                return Finding("note", "gyroscope", text)
        missing = f"missing, and {_NO_TURNS}: "
        if self.loaded.config.uses_method_a:
            return Finding("note", "gyroscope", f"{missing}{_STEADY}; {_NO_GYRO}")
        return Finding("warning", "gyroscope", missing + _NEVER)

    def _conflicts(self) -> Iterator[Finding]:
        for can_id in sorted(self.output_ids):
            seen = sum(n for (_, other), n in self.ids.items() if other == can_id)
            if seen:
                text = (
                    f"{id_text(can_id)} is on this bus already ({seen} frames). If imucald "
                    "did not send them, another control unit uses this id: choose another id under "
                    "'output: ids:'"
                )
                yield Finding("warning", "output.ids", text)


def _remedy(reasons: Counter[str]) -> str:
    """Return a hint for the most frequent reason. The reason "untrusted" is ignored, because it is
    a consequence of other reasons."""
    causes = [reason for reason, _ in reasons.most_common() if reason != "untrusted"]
    kind = causes[0] if causes else ""
    general = _REMEDIES["counter"] if kind.startswith("counter") else ""
    return _REMEDIES.get(kind, general)


def counts_text(reasons: Counter[str]) -> str:
    """Return a text of the reasons with their numbers, the most frequent first."""
    return ", ".join(f"{reason} {n}" for reason, n in reasons.most_common())


def never_changes(source: QuantitySource) -> bool:
    """True if an axis of accelerometer or gyroscope always has the same value."""
    values = source.statistics.si
    is_sensor = source.wanted.channel in ("accel", "gyro")
    return is_sensor and values.count >= MIN_EQUAL_VALUES and values.least == values.largest


def _is_near(seen: float, stated: float) -> bool:
    return 1 / CYCLE_TOLERANCE < seen / stated < CYCLE_TOLERANCE
