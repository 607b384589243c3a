"""Pass frames through the daemon's own router, and report the results."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from imucald.can.columns import (
    CAN_EFF_FLAG,
    CAN_EFF_MASK,
    CLASSIC_BYTES,
    FrameColumns,
    IdMatch,
)
from imucald.can.dbc.decode import J1939_ADDRESS_MASK
from imucald.can.j1939_transport import announced_messages
from imucald.config import LoadedConfig
from imucald.config_check.decoding import Decoding, counts_text, never_changes
from imucald.config_check.finding import Finding
from imucald.config_check.health import (
    LogHealth,
    health_findings,
    jumping_finding,
    left_out_finding,
    used_s,
)
from imucald.config_check.judgement import judge
from imucald.config_check.motion import Motion, TickMeans
from imucald.config_check.source import (
    id_text,
    message_row,
    never_negative,
    not_judged,
    quantity_row,
    signs_of_speed,
    sources,
    turned_quantities,
    unit_advice,
)
from imucald.config_check.statistics import Probe
from imucald.inputs.wiring import compile_router
from imucald.runtime.output.output_frames import OutputFrames
from imucald.runtime.session import make_engine, open_compensation
from imucald.runtime.timebase import TimeBase

EVERY_FRAME = (IdMatch(0, 0), IdMatch(CAN_EFF_FLAG, 0))
"""A filter that accepts every identifier, of 11 and 29 bits."""
MAX_IDS = 20_000
"""Largest number of identifiers that are counted separately. A vehicle has hundreds of identifiers;
a fuzzed bus may have any number."""
FASTEST_BUS = 1e6
"""Bit rate of the fastest CAN bus [bit/s]."""
MAX_TEXT = 80
_OUTPUTS = (
    "acceleration", "angular_rate", "magnetic_field", "mount", "mount_deviation",
    "cross_talk_deviation", "zero_deviation", "health",
)  # fmt: skip


class Check:
    """Receives frames, and makes a report at the end.

    Raises the same ConfigError as `run` if the configuration cannot be used.
    """

    def __init__(self, loaded: LoadedConfig, silence: str = "the log holds no frame") -> None:
        """Prepare the check. silence: text with a remedy, reported if there is no frame at all."""
        make_engine(loaded)  # raises its errors
        self.loaded = loaded
        self.silence = silence
        self.router = compile_router(loaded)
        self.compensation = open_compensation(loaded)
        self.probes = [Probe(route) for route in self.router.routes]
        self.router.watchers = self.probes
        self.output = OutputFrames(loaded.config)
        self.ids: Counter[tuple[str, int]] = Counter()
        """Frames by (channel, id with the flag for 29 bits)."""
        self.bad_lines: Counter[str] = Counter()
        """Number of lines that the log reader rejected, by reason; for the report."""
        self._announced: dict[tuple[str, int], int] = {}
        self._uncounted = 0
        self._bits: Counter[str] = Counter()
        """Smallest number of bits of each channel's frames on a bus."""
        self._timebase = TimeBase()
        self._means = TickMeans()
        self._health = LogHealth(self.router.measured_axes, loaded.config)

    def feed(self, frames: FrameColumns) -> None:
        """Add a chunk of frames of a log or a bus. The chunk must include unwanted frames."""
        for index in np.unique(frames.channel).tolist():
            here = frames.channel == index
            self._bits[frames.channels[index]] += least_bits(frames.take(here))
            if len(self._announced) < MAX_IDS:
                found = announced_messages(
                    frames.can_id[here], frames.data[here], frames.length[here]
                )
                self._announced |= {(frames.channels[index], i): n for i, n in found.items()}
            ids, counts = np.unique(frames.can_id[here], return_counts=True)
            for can_id, count in zip(ids.tolist(), counts.tolist(), strict=True):
                key = frames.channels[index], can_id
                if key not in self.ids:
                    self._meet(*key)
                if key in self.ids or len(self.ids) < MAX_IDS:
                    self.ids[key] += count
                else:
                    self._uncounted += count
        for segment in self._timebase.segments(frames.t):
            chunk = frames.take(slice(segment.start, segment.stop))
            samples = self.router.columns(segment.t, chunk).samples
            self._means.add_samples(samples)
            if segment.gap:
                self._health.gap(float(segment.t[0]))
            self._health.add_samples(samples, float(segment.t[-1]))

    def _meet(self, channel: str, can_id: int) -> None:
        """Store the J1939 source address of a new id, if frames of all senders are accepted."""
        for probe in self.probes:
            is_any = probe.match.can_id & CAN_EFF_FLAG and not probe.match.mask & J1939_ADDRESS_MASK
            if is_any and probe.sender is None and probe.match.matches(can_id, channel):
                probe.addresses.add(can_id & J1939_ADDRESS_MASK)

    # the report ------------------------------------------------------------------------------

    @property
    def duration(self) -> float:
        """Seconds from the first frame to the last."""
        return self._timebase.now

    def findings(self) -> list[Finding]:
        """Return all findings, the worst first."""
        found = self._nothing() or self._found()
        return sorted(found, key=lambda f: ("error", "warning", "note", "ok").index(f.level))

    def _nothing(self) -> list[Finding]:
        """If no configured frame was received, return one error with a hint; else return an empty
        list."""
        if not self.frames_read:
            bad = (
                f"; some lines cannot be used: {counts_text(self.bad_lines)}"
                if self.bad_lines
                else ""
            )
            return [Finding("error", "bus", self.silence + bad)]
        if any(probe.frames for probe in self.probes):
            return []
        ids = ", ".join(dict.fromkeys(f"{id_text(i)} on {channel}" for channel, i in self.ids))
        text = (
            f"none of the {len(self.probes)} configured messages came, but {len(self.ids)} "
            f"other ids did ({_shortened(ids)}). Is this the right bus ('channel:')? Does the "
            "database belong to it?"
        )
        return [Finding("error", "bus", text)]

    @property
    def frames_read(self) -> int:
        """Number of all frames, wanted or not."""
        return sum(self.ids.values()) + self._uncounted

    def _found(self) -> list[Finding]:
        rows = list(sources(self.loaded, self.probes))
        config = self.loaded.config
        planar = config.signals.accelerometer[0].z is None
        motion = Motion(self._means.grid(), planar)
        decoding = Decoding(
            self.loaded,
            self.probes,
            rows,
            self.ids,
            self.router.sample_counts,
            self.duration,
            self._timebase.steps,
            self.bad_lines,
            self.output.can_ids,
            max(self._bits.values(), default=0) / FASTEST_BUS,
            self._means.paces(),
            self._announced,
            drives=motion.drives,
            is_reverse_derived=self._is_reverse_derived,
        )
        model = self.compensation
        notes = () if model is None else model.notes_for(self.router.channels)
        dead = {row.wanted.channel for row in rows if never_changes(row)}
        for channel in dead if motion.drives else ():  # what it is compared with would be blamed
            motion = motion.without(channel)
        mixed = list(jumping_finding(self._health.left_out, self.duration))
        if mixed:  # what it is compared with would be blamed
            motion = motion.without("speed")
        found = [
            *mixed,
            *(Finding("note", "model", text) for text in notes),
            *decoding.findings(),
            *judge(
                motion,
                config.vehicle,
                config.calibration.orientation,
                unit_advice(rows),
                turned_quantities(rows),
                never_negative(rows),
                signs_of_speed(rows) if self._is_reverse_derived else "",
            ),
        ]
        wrong = {f.quantity for f in found if f.level == "error"}  # says more than its health
        found += [f for f in health_findings(self._health.events) if f.quantity not in wrong]
        found += left_out_finding(self._health.left_out, self.duration, bool(wrong))
        return [*found, *not_judged(rows, found)]

    @property
    def _is_reverse_derived(self) -> bool:
        """True if no reverse signal is configured and the sign of the speed is used as the reverse
        signal."""
        return self.loaded.config.signals.reverse is None and "reverse" in self.router.channels

    def report(self) -> dict[str, Any]:
        """Return the complete report, in the form of docs/json.md."""
        findings = self.findings()
        rejected = self.router.rejected + self.bad_lines
        matched = {
            key for key in self.ids if any(p.match.matches(key[1], key[0]) for p in self.probes)
        }
        unknown = {key: n for key, n in self.ids.items() if key not in matched}
        return {
            "usable": not any(f.level == "error" for f in findings),
            "warnings": sum(f.level == "warning" for f in findings),
            "duration_s": round(self.duration, 3),
            "used_for_mount_s": round(used_s(self._health.left_out, self.duration), 3),
            "messages": [message_row(self.loaded, probe) for probe in self.probes],
            "quantities": [quantity_row(source) for source in sources(self.loaded, self.probes)],
            "findings": [finding.as_dict() for finding in findings],
            "output": self._output_ids(),
            "frames": {
                "read": self.frames_read,
                "used": self.router.used,
                "rejected": dict(sorted(rejected.items())),
                "other_ids": len(unknown),
                "other_frames": sum(unknown.values()) + self._uncounted,
            },
        }

    def _output_ids(self) -> list[dict[str, Any]]:
        config = self.loaded.config
        names = list(_OUTPUTS)
        if config.attitude.enabled:
            names += ["attitude", "attitude_deviation", "rates", "grade"]
            names += ["free_acceleration"] if config.attitude.compensation.send else []
        if config.travel_direction.enabled:
            names += ["travel_direction", "travel_deviation"]
        ids = {name: getattr(config.output.ids, name) for name in names}
        if config.signals.gyroscope is None:
            del ids["angular_rate"]
        if config.signals.magnetometer is None:
            del ids["magnetic_field"]
        ids |= {f"parallel.{sensor.name}": sensor.id for sensor in config.signals.parallel}
        seen: Counter[int] = Counter()
        for (_, can_id), n in self.ids.items():
            seen[can_id & CAN_EFF_MASK] += n
        return [{"frame": n, "id": id_text(i), "seen": seen[i]} for n, i in ids.items()]


def least_bits(frames: FrameColumns) -> int:
    """Return the number of bits of all frames without stuff bits (ISO 11898-1). For CAN FD, only
    the bits at the lower bit rate count."""
    extended = int(np.count_nonzero(frames.can_id & CAN_EFF_FLAG))
    payload = np.where(frames.length > CLASSIC_BYTES, 0, frames.length)
    if frames.fd is not None:
        payload = np.where(frames.fd, 0, payload)
    is_slow = 30 if frames.fd is not None else 47
    return is_slow * len(frames) + 20 * extended + 8 * int(payload.sum())


def _shortened(text: str) -> str:
    return text if len(text) <= MAX_TEXT else text[:MAX_TEXT].rpartition(",")[0] + ", ..."
