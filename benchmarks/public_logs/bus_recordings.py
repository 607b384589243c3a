"""Recordings of a CAN bus as they are: the logger's files to frames, with the sender's database."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.public_logs.frames import Array, BusRecording
from benchmarks.public_logs.repositories import CSS
from imucald.api.interchange import library

CSS_PARTS = (
    "00000001-60FEB68B", "00000002-60FEB8E3", "00000003-60FEBB3B", "00000004-60FEBD93",
    "00000005-60FEBFEB",
)  # fmt: skip
"""Its sixth file was recorded a day later."""


def css_165(data: Path) -> BusRecording:
    """Passenger car, 46 min: an IMU-and-GNSS module 100 Hz and 1 Hz on can1, OBD-II on can0."""
    folder = "examples/other/matlab-basics"
    times, lines = [], []
    for part in CSS_PARTS:
        content = CSS.file(data, f"{folder}/LOG_datastore/3BA199E2/00000165/{part}.MF4")
        t, text = _frames_of_mf4(content)
        times.append(t)
        lines.extend(text)
    database = CSS.file(data, f"{folder}/dbc_files/canmod-gps.dbc").decode()
    return BusRecording(np.concatenate(times), lines, database)


def _frames_of_mf4(content: bytes) -> tuple[Array, list[str]]:
    """Times [s] of its clock and the frames of its first group; bus 1 is can0."""
    asammdf = library("asammdf", "mf4")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.mf4"
        path.write_bytes(content)
        with asammdf.MDF(path) as file:
            frames = file.get("CAN_DataFrame", group=0)
    samples = frames.samples
    columns = [samples[f"CAN_DataFrame.{name}"].tolist()
               for name in ("BusChannel", "ID", "IDE", "DataLength")]  # fmt: skip
    payloads = samples["CAN_DataFrame.DataBytes"]
    text = [
        f"can{bus - 1} {id_:0{8 if extended else 3}X}#{bytes(payload[:length]).hex().upper()}"
        for bus, id_, extended, length, payload in zip(*columns, payloads, strict=True)
    ]
    return np.asarray(frames.timestamps, dtype=np.float64), text
