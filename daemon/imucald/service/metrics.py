"""Convert a status to Prometheus text (exposition format 0.0.4)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from imucald.mount.estimate import MountState
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
    none: Mapping[str, str] = {}
    mount, link, saved = status["mount"], status["link"], status["saved_state"]
    process = status["process"]
    states = [
        ({"state": s.name.lower()}, int(status["state"] == s.name.lower())) for s in MountState
    ]
    yield "info", "gauge", "Which program runs.", [({"version": status["version"]}, 1)]
    yield "state", "gauge", "1 for the present state of the mount calibration.", list(states)
    yield "quality", "gauge", "Quality of the corrected frames.", [(none, status["quality"])]
    flows = [(none, int(flow(status).kind is FlowKind.SERVED))]
    about = "1 while corrected frames are sent with quality restored, usable or fine."
    yield "corrected_frames_flow", "gauge", about, list(flows)
    yield "held", "gauge", "1 while the mount is held.", [(none, int(status["held"]))]
    alarms = [({"alarm": name}, int(status["health"][name])) for name in ALARMS]
    yield "alarm", "gauge", "1 while an alarm of the health frame is active.", list(alarms)
    angles = [({"angle": a}, mount[f"{a}_deg"]) for a in ("roll", "pitch", "yaw")]
    yield "mount_angle_degrees", "gauge", "Mount angles.", list(angles)
    std = [({"axis": a}, mount["std_deg"][a]) for a in "xyz"]
    yield (
        "mount_deviation_degrees",
        "gauge",
        "Standard deviation of the mount about the vehicle axes.",
        list(std),
    )
    samples = [({"channel": c}, row["samples"]) for c, row in status["signals"].items()]
    yield "samples_total", "counter", "Accepted samples.", list(samples)
    rejected = [({"reason": r}, n) for r, n in status["frames"]["rejected"].items()]
    yield "rejected_total", "counter", "Rejected frames and samples.", list(rejected)
    for name, text in _LINK_COUNTERS.items():
        yield f"link_{name}_total", "counter", text, [(none, link[name])]
    errors = [({"reason": r}, n) for r, n in link["send_errors"].items()]
    yield "link_send_errors_total", "counter", "Frames not sent.", list(errors)
    yield "link_up", "gauge", "1 while the interface is up.", [(none, int(link["state"] == "up"))]
    yield "state_saves_total", "counter", "Number of saves of the state.", [(none, saved["saves"])]
    moved = [(none, saved["remounts"])]
    yield "remounts", "gauge", "Number of detected moves of the sensor.", moved
    failures = [(none, saved["failures"])]
    yield "state_save_failures_total", "counter", "Number of failed saves of the state.", failures
    sent = [(none, status["frames_given_out"])]
    yield "frames_given_out_total", "counter", "Frames sent to the bus.", sent
    yield "uptime_seconds", "gauge", "Time since the start.", [(none, status["uptime_s"])]
    yield "cpu_seconds_total", "counter", "Processor time.", [(none, process["cpu_s"])]
    yield "resident_memory_bytes", "gauge", "Memory in use.", [(none, process["rss_bytes"])]


def _line(name: str, labels: Mapping[str, str], value: float | int | None) -> str:
    if value is None:
        return ""
    named = ",".join(f'{key}="{escaped(text)}"' for key, text in labels.items())
    return f"imucald_{name}{{{named}}} {value}\n"
