"""Recordings of a CAN bus as they are: the logger's files to frames, with the sender's database."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.public_logs.frames import Array, BusRecording
from benchmarks.public_logs.repositories import CSS, CSS_2026, CSS_PARQUET, Repository
from imucald.api.interchange import library

CSS_PARTS = (
    "00000001-60FEB68B", "00000002-60FEB8E3", "00000003-60FEBB3B", "00000004-60FEBD93",
    "00000005-60FEBFEB",
)  # fmt: skip
"""Its sixth file was recorded a day later."""


def css_165(data: Path) -> BusRecording:
    """Passenger car, 46 min: an IMU-and-GNSS module 100 Hz and 1 Hz on can1, OBD-II on can0."""
    folder = "examples/other/matlab-basics"
    parts = [f"{folder}/LOG_datastore/3BA199E2/00000165/{part}.MF4" for part in CSS_PARTS]
    return _recording(data, CSS, parts, CSS, f"{folder}/dbc_files/canmod-gps.dbc")


BUCKET = "local-testing/local-input-bucket"


def kia_5hz(data: Path) -> BusRecording:
    """Electric car, 32 min: the logger's own GNSS and IMU 5 Hz on can8, OBD-II on can0."""
    return _recording(
        data, CSS_2026, ["examples/other/s3-upload-log-files/LOG/7512BE4D/00000427/00000001.MF4"],
        CSS_PARQUET, f"{BUCKET}/can9-database-01.09.dbc",
    )  # fmt: skip


def kia_10hz(data: Path) -> BusRecording:
    """Electric car, 11 min of a town: a GNSS and IMU module 10 Hz on can1, diagnostics on can0."""
    return _recording(
        data, CSS_PARQUET, [f"{BUCKET}/2F6913DB/00000086/00000003-62977DFB.MF4"],
        CSS_PARQUET, f"{BUCKET}/can2-kia-ev6-data-internal-dbc-modified.dbc",
    )  # fmt: skip


def kia_car_park(data: Path) -> BusRecording:
    """Electric car, 6 min, of which 1 min at 7 m/s and less: the same module, another mounting."""
    folder = "examples/other/concatenate-mf4-by-period"
    parts = [f"{folder}/LOG/2F6913DB/00001089/{part}.MF4" for part in
             ("00000001-63BEF5CD", "00000002-63BEFDF9")]  # fmt: skip
    return _recording(data, CSS_2026, parts, CSS_2026, f"{folder}/dbc_files/gnss.dbc")


def _recording(
    data: Path, logs: Repository, parts: list[str], databases: Repository, database: str
) -> BusRecording:
    """The parts one after another, as their clocks say."""
    times, lines = [], []
    for part in parts:
        for t, text in _frames_of_mf4(logs.file(data, part)):
            times.append(t)
            lines.extend(text)
    return BusRecording(np.concatenate(times), lines, databases.file(data, database).decode())


def _frames_of_mf4(content: bytes) -> list[tuple[Array, list[str]]]:
    """Of each group with frames the times [s] of its clock and the frames; bus 1 is can0."""
    asammdf = library("asammdf", "mf4")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.mf4"
        path.write_bytes(content)
        with asammdf.MDF(path) as file:
            groups = [
                file.get("CAN_DataFrame", group=i) for i, group in enumerate(file.groups)
                if group.channel_group.cycles_nr
                and any(channel.name == "CAN_DataFrame" for channel in group.channels)
            ]  # fmt: skip
    return [(np.asarray(frames.timestamps, dtype=np.float64), _lines(frames.samples))
            for frames in groups]  # fmt: skip


def _lines(samples: Any) -> list[str]:
    """Frames of asammdf's records as candump's text."""
    columns = [samples[f"CAN_DataFrame.{name}"].tolist()
               for name in ("BusChannel", "ID", "IDE", "DataLength")]  # fmt: skip
    payloads = samples["CAN_DataFrame.DataBytes"]
    return [
        f"can{int(bus) - 1} {int(id_):0{8 if extended else 3}X}"
        f"#{bytes(payload[: int(length)]).hex().upper()}"
        for bus, id_, extended, length, payload in zip(*columns, payloads, strict=True)
    ]
