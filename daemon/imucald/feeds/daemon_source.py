"""The input of a feed: the daemon's status socket, and its corrected frames on the bus. The part of
the status that a feed sends."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from imucald.can.columns import IdMatch
from imucald.can.link.link import Link
from imucald.config import LoadedConfig, load_config
from imucald.core.errors import ImucaldError, LinkError
from imucald.feeds.corrected_frames import GOOD, Attitude, CorrectedFrames, RawSamples, Triple
from imucald.mount.mount_words import SD_95
from imucald.runtime.flow import QUALITIES, present_alarms
from imucald.service.asking import ask, content, understood

STATUS_S = 1.0
"""Period of reading the status [s]."""
ASK_S = 0.5
"""A daemon that does not answer within this time counts as not running [s]."""

Say = Callable[[str], None]


@dataclass(frozen=True)
class Reading:
    """The state at one time. at: wall clock [s]. status: as in `imucald status --json`, or None.

    status is None if no daemon answers. is_new: True if the status was read for this reading.
    corrected: x, y, z in vehicle axes by name ("acceleration" in m/s^2, "angular_rate" in deg/s);
    None means not available. quality: the lowest quality of the frames for each name. raw: raw
    samples in sensor axes, in the same form as corrected. attitude: roll, pitch, heading of the
    vehicle [deg].
    """

    at: float
    status: Mapping[str, Any] | None
    is_new: bool = True
    corrected: Mapping[str, Triple | None] = field(default_factory=dict)
    quality: Mapping[str, int] = field(default_factory=dict)
    raw: Mapping[str, Triple | None] = field(default_factory=dict)
    attitude: Attitude | None = None


class DaemonSource:
    """Reads one daemon. The daemon's status names the bus.

    accepted: accepted qualities of corrected frames. config: path of the configuration; None means
    the path that the daemon's status states. wants_frames: if False, only the status is read.
    wants_raw: whether the sensor's raw frames are read too.
    """

    def __init__(
        self,
        status_socket: Path,
        say: Say,
        accepted: Iterable[int] = GOOD,
        config: Path | None = None,
        wants_frames: bool = True,
        wants_raw: bool = False,
    ) -> None:
        self._socket = status_socket
        self._say = say
        self._accepted = frozenset(accepted)
        self._config = config
        self._wants_frames, self._wants_raw = wants_frames, wants_raw
        self._next_status = time.monotonic()
        self._status: Mapping[str, Any] | None = None
        self._frames: CorrectedFrames | None = None
        self._raw: RawSamples | None = None
        self._link: Link | None = None
        self._reported = ""

    def read(self, seconds: float) -> Reading:
        """Listen for `seconds` [s], then return the present reading."""
        end = time.monotonic() + seconds
        is_new = time.monotonic() >= self._next_status
        if is_new:
            self._next_status = time.monotonic() + STATUS_S
            self._ask()
        while (left := end - time.monotonic()) > 0.0:
            self._listen(left)
        frames, raw, now = self._frames, self._raw, time.monotonic()
        return Reading(
            time.time(),
            self._status,
            is_new,
            {} if frames is None else frames.means(now),
            {} if frames is None else dict(frames.quality),
            {} if raw is None else raw.means(now),
            None if frames is None else frames.attitude(now),
        )

    def _listen(self, seconds: float) -> None:
        if self._link is None or self._frames is None:
            time.sleep(seconds)
            return
        for _, can_id, data in self._link.receive(seconds):
            now = time.monotonic()
            self._frames.take_frame(now, can_id, data)
            if self._raw is not None:
                self._raw.take_frame(now, can_id, data)

    def _ask(self) -> None:
        try:
            found = content(self._socket, "status", ask(self._socket, "status", ASK_S))
            with understood(self._socket):
                status_content(0.0, found)
                channel, interface = found["link"]["channel"], found["link"]["interface"]
            self._status = found
        except LinkError as error:
            if self._status is not None or not self._reported:
                self._report(f"{error}; waiting for it")
            self._status = None
            return
        if self._reported:
            self._report("")
            self._say("the daemon answers")
        if self._wants_frames and self._link is None:
            self._open(Path(found["config"]), str(interface), str(channel))

    def _open(self, config: Path, interface: str, channel: str) -> None:
        """Open the daemon's bus to receive the daemon's output frames."""
        try:
            loaded = load_config(self._config or config)
            frames = CorrectedFrames(loaded.config, self._accepted)
            matches = frames.matches
            if self._wants_raw:
                self._raw = RawSamples(loaded)
                matches += self._raw.matches
            self._link = _opened(loaded, matches, interface, channel)
        except ImucaldError as error:
            self._wants_frames = False
            self._say(f"{error}; only the status is sent. Name the configuration with --config")
            return
        self._frames = frames
        self._say(f"listening on {channel} for {', '.join(frames.names)}")

    def _report(self, text: str) -> None:
        self._reported = text
        if text:
            self._say(text)

    def close(self) -> None:
        """Close the bus."""
        if self._link is not None:
            self._link.close()


def _opened(loaded: LoadedConfig, matches: list[IdMatch], interface: str, channel: str) -> Link:
    bus = loaded.config.bus
    return Link(
        interface,
        channel,
        receive=matches,
        fd=bus.fd,
        bitrate=bus.bitrate,
        options=bus.options,
    )


def status_content(at: float, status: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return state, mount with ± (95 %), and missing evidence. `running` is false if no daemon
    answers.

    at: wall clock [s]. status: see `Reading`.
    """
    if status is None:
        return {"at": round(at, 3), "running": False}
    mount = status["mount"]
    return {
        "at": round(at, 3),
        "running": True,
        "state": status["state"],
        "quality": QUALITIES[status["quality"]],
        "held": bool(status.get("held")),
        "mount": {
            **{f"{a}_deg": mount[f"{a}_deg"] for a in ("roll", "pitch", "yaw")},
            "plus_minus_deg": _halves({axis: mount["std_deg"][axis] for axis in "xyz"}),
            "angle_plus_minus_deg": _halves(mount.get("angle_std_deg", {})),
            "quaternion_wxyz": mount["quaternion_wxyz"],
            "sits": mount["sits"],
        },
        "waiting_for": status["waiting_for"],
        "alarms": list(present_alarms(status)),
        "bus": status["link"]["state"],
    }


def _halves(std: Mapping[str, float | None]) -> dict[str, float | None]:
    return {name: None if s is None else SD_95 * s for name, s in std.items()}
