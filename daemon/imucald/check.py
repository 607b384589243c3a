"""What a configuration decodes from a log or a bus: sources, units, rates, gaps, suspicions.

The frames go through the daemon's own router, so what is told here is what `imucald run` would do.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucald.bus.columns import (
    CAN_EFF_FLAG,
    CAN_EFF_MASK,
    CLASSIC_BYTES,
    FD_BYTES,
    FrameColumns,
    IdMatch,
)
from imucald.bus.database import Signal
from imucald.bus.link import Frame
from imucald.bus.routes import MessageRoute
from imucald.bus.wiring import Wanted, compile_router, wanted_numbers
from imucald.check_judgement import Finding, judge
from imucald.check_motion import Motion, TickMeans
from imucald.check_statistics import Probe, SignalStatistics
from imucald.config import LoadedConfig
from imucald.output import OutputFrames
from imucald.timebase import TimeBase

EVERY_FRAME = (IdMatch(0, 0), IdMatch(CAN_EFF_FLAG, 0))
"""Lets every identifier through, 11 and 29 bits."""

SI_UNITS = {
    "acceleration": "m/s^2",
    "angular_rate": "rad/s",
    "angle": "rad",
    "speed": "m/s",
    "magnetic_field": "T",
    "temperature": "degC",
    "flag": "",
}
CYCLE_TOLERANCE = 1.5
"""A cycle is told when it is so many times longer or shorter than the database states."""
MANY_REJECTED = 0.01
"""Part of rejected frames or values from which it is told."""
FEWEST_STUCK = 100
"""So many equal values of a sensor in a row, and no other, look stuck."""

_WORDS = {
    "accel": "accelerometer",
    "gyro": "gyroscope",
    "mag": "magnetometer",
    "steering": "steering_wheel_angle",
    "lateral_accel": "lateral_acceleration",
    "longitudinal_accel": "longitudinal_acceleration",
}
"""Channels whose name in the configuration differs."""
_WHEELS = ("front_left", "front_right", "rear_left", "rear_right")
_OUTPUTS = ("acceleration", "angular_rate", "magnetic_field", "mount", "mount_deviation", "health")


@dataclass(frozen=True)
class Source:
    """One configured number with the figures that its signal gave."""

    wanted: Wanted
    probe: Probe
    signal: Signal | None
    name: str
    statistics: SignalStatistics

    @property
    def quantity(self) -> str:
        """The quantity's name in the configuration, with axis or wheel."""
        word = _WORDS.get(self.wanted.channel, self.wanted.channel).replace("/", ".")
        if self.wanted.width == 3:
            return f"{word}.{'xyz'[self.wanted.slot]}"
        return f"{word}.{_WHEELS[self.wanted.slot]}" if self.wanted.width == 4 else word

    @property
    def unit(self) -> str:
        """The source's unit, as the configuration or the database spells it."""
        stated = self.wanted.source.unit
        return stated if stated is not None else self.signal.unit if self.signal else ""


class Check:
    """Takes frames; tells at the end what they were.

    Raises ConfigError where the configuration cannot be wired.
    """

    def __init__(self, loaded: LoadedConfig) -> None:
        self.loaded = loaded
        self.router = compile_router(loaded)
        self.probes = [Probe(route) for route in self.router.routes]
        self.router.routes = tuple(self.probes)
        self.output = OutputFrames(loaded.config)
        self.ids: Counter[tuple[str, int]] = Counter()
        """Frames by (channel, id with the flag for 29 bits)."""
        self._timebase = TimeBase()
        self._means = TickMeans()

    def feed(self, frames: FrameColumns) -> None:
        """Take a chunk of all the frames of a log or a bus."""
        for index in np.unique(frames.channel).tolist():
            ids, counts = np.unique(frames.can_id[frames.channel == index], return_counts=True)
            for can_id, count in zip(ids.tolist(), counts.tolist(), strict=True):
                self.ids[frames.channels[index], can_id] += count
        for piece in self._timebase.columns(frames.t):
            chunk = frames.take(slice(piece.start, piece.stop))
            self._means.add(self.router.columns(piece.t, chunk).samples)

    # the report ------------------------------------------------------------------------------

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return self._timebase.now

    def sources(self) -> list[Source]:
        """All configured numbers, in the order of the configuration."""
        by_key: dict[tuple[str, int, int], tuple[Probe, str, Signal | None]] = {}
        for probe in self.probes:
            route = probe.route
            for tap in probe.taps:
                for component, slot in zip(tap.components, tap.slots, strict=True):
                    name, signal = probe.name, None
                    if isinstance(route, MessageRoute):
                        signal = route.plan.message.signal(route.plan.signal_names[component.index])
                        name = f"{probe.name}.{signal.name}"
                    by_key[tap.channel, tap.rank, slot] = probe, name, signal
        found = []
        for wanted in wanted_numbers(self.loaded.config.signals):
            key = wanted.channel, wanted.rank, wanted.slot
            probe, name, signal = by_key[key]
            found.append(Source(wanted, probe, signal, name, probe.signals[key]))
        return found

    def findings(self) -> list[Finding]:
        """Everything to tell, the worst first."""
        sources = self.sources()
        found = [*self._silent(), *self._doubtful(sources), *self._costs(), *self._conflicts()]
        vehicle = self.loaded.config.vehicle
        planar = self.loaded.config.signals.accelerometer[0].z is None
        motion = Motion(self._means.grid(), planar)
        found += judge(motion, vehicle.track, vehicle.wheelbase, vehicle.steering_ratio)
        return sorted(found, key=lambda f: ("error", "warning", "note", "ok").index(f.level))

    def _has(self, channel: str) -> bool:
        return self.router.sample_counts[channel] > 0

    def _silent(self) -> Iterator[Finding]:
        """Messages that did not come, and frames that were all refused."""
        for probe in self.probes:
            quantity = ", ".join(
                dict.fromkeys(_WORDS.get(tap.channel, tap.channel) for tap in probe.taps)
            )
            if not probe.frames:
                text = f"no frame of {probe.name} ({_id_text(probe.match.can_id)}) came"
                yield Finding("warning", quantity, text + self._elsewhere(probe.match))
                continue
            bad = probe.rejected.total()
            if bad > MANY_REJECTED * probe.frames:
                reasons = _counts_text(probe.rejected)
                text = f"{bad} of {probe.frames} frames of {probe.name} are rejected ({reasons})"
                yield Finding("warning", quantity, text + _remedy(probe.rejected))

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

    def _doubtful(self, sources: list[Source]) -> Iterator[Finding]:
        for source in sources:
            statistics = source.statistics
            good, bad = statistics.si.count, statistics.rejected.total()
            if bad > MANY_REJECTED * (good + bad):
                reasons = _counts_text(statistics.rejected)
                text = f"{bad} of {good + bad} values of {source.name} are rejected ({reasons})"
                yield Finding("warning", source.quantity, text + _remedy(statistics.rejected))
            sensor = source.wanted.channel in ("accel", "gyro")
            same = statistics.si.least == statistics.si.largest
            if sensor and good >= FEWEST_STUCK and same:
                text = f"never changes ({statistics.physical.least:g} {source.unit})"
                yield Finding("warning", source.quantity, text)
        for probe in self.probes:
            stated = _stated_cycle(self.loaded, probe)
            seen = probe.cycle
            if stated and seen and not 1 / CYCLE_TOLERANCE < seen / stated < CYCLE_TOLERANCE:
                text = f"{probe.name} comes every {1e3 * seen:.3g} ms, stated are {1e3 * stated:g}"
                yield Finding("note", "", text)
        if self._timebase.steps:
            text = f"time stamps jump {self._timebase.steps} times: holes, or a clock that was set"
            yield Finding("note", "", text)

    def _costs(self) -> Iterator[Finding]:
        """What is missing, and what that costs."""
        config = self.loaded.config
        if not self._has("accel"):
            text = "gives no sample: nothing can be calibrated"
            yield Finding("error", "accelerometer", text)
        if not self._has("speed"):
            yield Finding("warning", "speed", _NO_SPEED + self._direction_without_speed())
        if not self._has("gyro"):
            yield Finding("note", "gyroscope", self._without_gyro())
        elif not self._has("yaw_rate"):
            yield Finding("note", "yaw_rate", "is missing: turns are taken from the gyroscope")
        if self._has("speed") and not self._has("reverse"):
            yield Finding("note", "reverse", _NO_REVERSE)
        if config.vehicle.driving_side == "unknown" and config.signals.accelerometer[0].z:
            yield Finding("note", "vehicle.driving_side", _NO_SIDE)

    def _direction_without_speed(self) -> str:
        if self._has("brake"):
            return "forward is told from backward by the brake switch"
        if self._has("yaw_rate") or self._has("gyro"):
            return "forward is told from backward in turns and by the first motion after a stop"
        return "forward is told from backward by the first motion after a stop only"

    def _without_gyro(self) -> str:
        for channel in ("yaw_rate", "steering"):
            if self._has(channel):
                word = _WORDS.get(channel, channel)
                return f"is missing: turns are taken from {word}; {_NO_GYRO}"
        return f"is missing, and {_NO_TURNS}; {_NO_GYRO}"

    def _conflicts(self) -> Iterator[Finding]:
        for can_id in sorted(self.output.can_ids):
            seen = sum(n for (_, other), n in self.ids.items() if other == can_id)
            if seen:
                text = (
                    f"{_id_text(can_id)} is on this bus already ({seen} frames): imucald sent it, "
                    "or another unit does; then choose another under 'output: ids:'"
                )
                yield Finding("warning", "output.ids", text)

    def report(self) -> dict[str, Any]:
        """Everything, as docs/json.md describes it."""
        findings = self.findings()
        matched = {
            key for key in self.ids if any(p.match.matches(key[1], key[0]) for p in self.probes)
        }
        unknown = {key: n for key, n in self.ids.items() if key not in matched}
        return {
            "usable": not any(f.level == "error" for f in findings),
            "duration_s": round(self.duration, 3),
            "messages": [_message(self.loaded, probe) for probe in self.probes],
            "quantities": [_quantity(source) for source in self.sources()],
            "findings": [finding.as_dict() for finding in findings],
            "output": self._output_ids(),
            "frames": {
                "read": sum(self.ids.values()),
                "used": self.router.used,
                "rejected": dict(sorted(self.router.rejected.items())),
                "other_ids": len(unknown),
                "other_frames": sum(unknown.values()),
            },
        }

    def _output_ids(self) -> list[dict[str, Any]]:
        config = self.loaded.config
        ids = {name: getattr(config.output.ids, name) for name in _OUTPUTS}
        if config.signals.gyroscope is None:
            del ids["angular_rate"]
        if config.signals.magnetometer is None:
            del ids["magnetic_field"]
        ids |= {f"parallel.{sensor.name}": sensor.id for sensor in config.signals.parallel}
        seen: Counter[int] = Counter()
        for (_, can_id), n in self.ids.items():
            seen[can_id & CAN_EFF_MASK] += n
        return [{"frame": n, "id": _id_text(i), "seen": seen[i]} for n, i in ids.items()]


_NO_SPEED = "is missing: yaw takes longer and is less certain; "
_NO_GYRO = "pitch and roll get nothing from turns, and no corrected angular rate is sent"
_NO_TURNS = "so are yaw rate and steering angle: straight motion is told by steady angles only"
_NO_REVERSE = "is missing: reversing reads as braking, which costs some accuracy"
_NO_SIDE = "is unknown: a road crown reads as mount roll (about 0.7 deg); say left or right"


def columns_of(frames: Sequence[Frame], channel: str) -> FrameColumns:
    """Frames of a live bus, (t, id, data) each, as columns."""
    width = CLASSIC_BYTES if all(len(f[2]) <= CLASSIC_BYTES for f in frames) else FD_BYTES
    data = b"".join(payload.ljust(width, b"\0") for _, _, payload in frames)
    n = len(frames)
    return FrameColumns(
        t=np.array([t for t, _, _ in frames]),
        can_id=np.array([can_id for _, can_id, _ in frames], dtype=np.uint32),
        length=np.array([len(payload) for _, _, payload in frames], dtype=np.uint8),
        data=np.frombuffer(data, np.uint8).reshape(n, width),
        channel=np.zeros(n, np.uint8),
        channels=(channel,),
    )


def _remedy(reasons: Counter[str]) -> str:
    """A hint for the most frequent reason."""
    return _REMEDIES.get(reasons.most_common(1)[0][0], "")


_REMEDIES = {
    "checksum": "; see 'checksum:' (kind, id_bytes, data_id) of the message",
    "counter": "; see 'counter:' (signal, modulus, max_step) of the message",
    "short_frame": "; the database describes a longer frame: is it this vehicle's?",
    "out_of_range": "; see 'range:' of the source, and its unit",
    "not_available": "; the sender says so, or see 'not_available:' of the source",
    "saturated": "; the sensor runs into its end, or the database's range is too narrow",
}


def _message(loaded: LoadedConfig, probe: Probe) -> dict[str, Any]:
    return {
        "name": probe.name,
        "id": _id_text(probe.match.can_id),
        "channel": probe.match.channel,
        "frames": probe.frames,
        "cycle_s": None if probe.cycle is None else round(probe.cycle, 6),
        "stated_cycle_s": _stated_cycle(loaded, probe),
        "rejected": dict(sorted(probe.rejected.items())),
    }


def _quantity(source: Source) -> dict[str, Any]:
    conversion = source.statistics.conversion
    return {
        "quantity": source.quantity,
        "preference": source.wanted.rank,
        "source": source.name,
        "id": _id_text(source.probe.match.can_id),
        "unit": source.unit,
        "si_unit": SI_UNITS[conversion.unit.dimension],
        "factor": conversion.unit.factor * conversion.sign,
        "samples": source.statistics.si.count,
        "in_unit": source.statistics.physical.as_dict(),
        "in_si": source.statistics.si.as_dict(),
        "rejected": dict(sorted(source.statistics.rejected.items())),
    }


def _stated_cycle(loaded: LoadedConfig, probe: Probe) -> float | None:
    if not isinstance(probe.route, MessageRoute):
        return None
    protection = loaded.config.messages.get(probe.name)
    own = protection.cycle_time if protection is not None else None
    return own or probe.route.plan.message.cycle_time


def _counts_text(reasons: Counter[str]) -> str:
    return ", ".join(f"{reason} {n}" for reason, n in reasons.most_common())


def _id_text(can_id: int) -> str:
    return f"0x{can_id & CAN_EFF_MASK:X}"
