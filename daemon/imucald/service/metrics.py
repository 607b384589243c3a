"""Convert a status to Prometheus text (exposition format 0.0.4)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from imucald.mount.estimate import ANGLES, MountState
from imucald.runtime.flow import ALARMS, FlowKind, flow
from imucald.service.exposition import escaped

_Sample = tuple[Mapping[str, str], float | int | None]

_LINK_COUNTERS = {
    "received": "Frames received.",
    "lost": "Frames that the kernel dropped before they were read.",
    "late": "Frames that came too late to be corrected.",
    "sent": "Frames that the interface accepted.",
    "conflicts": "Frames of other nodes under our identifiers.",
    "error_frames": "Error frames.",
    "bus_off": "Number of times that the controller left the bus.",
    "went_down": "Number of times that the interface was set down.",
    "reopened": "Number of times that the interface was opened again.",
    "rejected": "Frames from the driver of the interface that could not be understood.",
}


def metrics_text(status: Mapping[str, Any]) -> str:
    """Return the metrics of a status as Prometheus text. An unknown value has no line.

    Every line has the label `bus`, because one file may contain several daemons.
    """
    bus = str(status["link"]["channel"])
    return "".join(
        f"# HELP imucald_{name} {text}\n# TYPE imucald_{name} {kind}\n{lines}"
        for name, kind, text, samples in _families(status)
        if (lines := "".join(_line(name, {"bus": bus, **labels}, v) for labels, v in samples))
    )


def _families(status: Mapping[str, Any]) -> Iterator[tuple[str, str, str, list[_Sample]]]:
    """Yield name, kind, help and samples of each family."""
    mount, link, saved = status["mount"], status["link"], status["saved_state"]
    process, state = status["process"], status["state"]
    yield "info", "gauge", "Which program runs.", _by("version", {status["version"]: 1})
    about = "1 for the present state of the mount calibration."
    names = [s.name.lower() for s in MountState]
    yield "state", "gauge", about, _by("state", {name: int(state == name) for name in names})
    yield "quality", "gauge", "Quality of the corrected frames.", _one(status["quality"])
    about = "1 while corrected frames are sent with quality restored, usable or fine."
    yield "corrected_frames_flow", "gauge", about, _one(flow(status).kind is FlowKind.SERVED)
    yield "held", "gauge", "1 while the mount is held.", _one(status["held"])
    alarms = {name: int(status["health"][name]) for name in ALARMS}
    yield "alarm", "gauge", "1 while an alarm of the health frame is active.", _by("alarm", alarms)
    angles = {name: mount[f"{name}_deg"] for name in ANGLES}
    yield "mount_angle_degrees", "gauge", "Mount angles.", _by("angle", angles)
    about = "Standard deviation of the mount about the vehicle axes."
    yield "mount_deviation_degrees", "gauge", about, _by("axis", mount["std_deg"])
    samples = {channel: row["samples"] for channel, row in status["signals"].items()}
    yield "samples_total", "counter", "Accepted samples.", _by("channel", samples)
    rejected = _by("reason", status["frames"]["rejected"])
    yield "rejected_total", "counter", "Rejected frames and samples.", rejected
    for name, text in _LINK_COUNTERS.items():
        yield f"link_{name}_total", "counter", text, _one(link[name])
    errors = _by("reason", link["send_errors"])
    yield "link_send_errors_total", "counter", "Frames not sent.", errors
    yield "link_up", "gauge", "1 while the interface is up.", _one(link["state"] == "up")
    yield "state_saves_total", "counter", "Number of saves of the state.", _one(saved["saves"])
    yield "remounts", "gauge", "Number of detected moves of the sensor.", _one(saved["remounts"])
    about = "Number of failed saves of the state."
    yield "state_save_failures_total", "counter", about, _one(saved["failures"])
    sent = _one(status["frames_given_out"])
    yield "frames_given_out_total", "counter", "Frames sent to the bus.", sent
    yield "uptime_seconds", "gauge", "Time since the start.", _one(status["uptime_s"])
    yield "cpu_seconds_total", "counter", "Processor time.", _one(process["cpu_s"])
    yield "resident_memory_bytes", "gauge", "Memory in use.", _one(process["rss_bytes"])


def _one(value: float | int | None) -> list[_Sample]:
    return [({}, None if value is None else +value)]  # a flag as 0 or 1


def _by(label: str, values: Mapping[str, float | int | None]) -> list[_Sample]:
    return [({label: name}, value) for name, value in values.items()]


def _line(name: str, labels: Mapping[str, str], value: float | int | None) -> str:
    if value is None:
        return ""
    named = ",".join(f'{key}="{escaped(text)}"' for key, text in labels.items())
    return f"imucald_{name}{{{named}}} {value}\n"
