"""What is sent and said of drives that stay the same is frozen: a change of either is meant.

Hashes of the frames and of the result, by case, in tests/data/frozen_outputs.json. They were made
by the code, so they judge nothing; they show that a change which should change nothing does so.
`PYTHONPATH=tests python tests/runtime/test_frozen_outputs.py` writes new ones, and the
picture of the demo, which shows results too.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from imucald.can.columns import FrameColumns
from imucald.can.logs.log_reader import LogReader
from imucald.cli import main as imucald
from imucald.config import LoadedConfig
from imucald.runtime.session import make_engine, open_config
from imucald.runtime.summary import RunCounts, as_json, summary
from paths import ROOT, SHARED_DATA
from simulated_bus import CONFIG, drive, drive_frames, with_times

FROZEN = ROOT / "tests" / "data" / "frozen_outputs.json"
MINUTES = 7.0
CHUNK = 20_000
SECOND_WORLD = ("01_none", "05_accel_bias", "09_frame_dropout", "14_mount_shift_at_200_s")

WITH_ALL = """
attitude: {enabled: true, method: filter}
model: car.yaml
"""
PARALLEL = """  parallel:
    - {name: force, kind: acceleration, id: 0x700, x: IMU_Accel.AccelX, y: IMU_Accel.AccelY,
       z: IMU_Accel.AccelZ}
    - {name: turn, kind: angular_rate, id: 0x701, x: IMU_Gyro.RateX, y: IMU_Gyro.RateY,
       z: IMU_Gyro.RateZ}
"""
LEVEL = """  parallel:
    - {name: flat, kind: angular_rate, id: 0x700, x: IMU_Gyro.RateX, y: IMU_Gyro.RateY}
"""
CASES = (
    *("joint", "joint with gaps", "published with gaps", "level with gaps", "all"),
    "stated mount",
)
LIVE = ("joint with gaps", "level with gaps", "all")


def config_of(case: str, folder: Path) -> LoadedConfig:
    """The simulated bus, and what the case adds."""
    text = CONFIG.read_text().replace("../../", f"{ROOT}/")
    is_published = case.startswith(("published", "level"))
    more = [f"estimator: {'published' if is_published else 'joint'}"]
    if case == "all":
        (folder / "car.yaml").write_text(drive(minutes=MINUTES).model.to_yaml())
        text = text.replace("messages:\n", PARALLEL + "messages:\n", 1) + WITH_ALL
    if case.startswith("level"):
        text = text.replace("messages:\n", LEVEL + "messages:\n", 1)
        text = text.replace("    z: IMU_Accel.AccelZ\n", "", 1)
    if case == "stated mount":  # some degrees off: it gives way
        true = drive(minutes=MINUTES).model.mount
        stated = f"roll_deg: {true.roll_deg + 2.0}, pitch_deg: {true.pitch_deg - 3.0}"
        stated += f", yaw_deg: {true.yaw_deg + 6.0}, std_deg: 0.9"
        more.append(f"mount: {{{stated}}}")
    (folder / "sim.yaml").write_text(f"{text}\ncalibration: {{{', '.join(more)}}}\n")
    return open_config(folder / "sim.yaml")


def frames_of(case: str) -> FrameColumns:
    """The drive's frames; with holes of 3 and 40 s, and a clock that is set back by 20 s."""
    frames = drive_frames(minutes=MINUTES)
    if "gaps" not in case:
        return frames
    t = frames.t - frames.t[0]
    kept = ~((t > 100.0) & (t < 103.0)) & ~((t > 200.0) & (t < 240.0))
    return with_times(frames, frames.t - np.where(t > 300.0, 20.0, 0.0)).take(np.flatnonzero(kept))


def hashed(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()[:24]


def in_columns(config: LoadedConfig, chunks: Iterable[FrameColumns]) -> tuple[str, str]:
    """Hashes of the frames that are sent, and of the result."""
    engine, sent, read, span = make_engine(config), hashlib.sha256(), 0, list[float]()
    for chunk in chunks:
        out = engine.columns(chunk)
        assert out is not None
        for _, can_id, data in out.rows():
            sent.update(b"%x#%b;" % (can_id, data))
        read += len(chunk)
        span += [float(chunk.t[0]), float(chunk.t[-1])]
    assert engine.pipeline.first_usable is not None, "nothing was ever applied"
    counts = RunCounts(read, engine.router.used, engine.router.rejected)
    result = summary(engine, counts, max(span) - min(span))
    if "model" in result:
        result["model"].pop("file")  # lies in another folder each time
    return sent.hexdigest()[:24], hashed(as_json(result).encode())


def live(config: LoadedConfig, frames: FrameColumns) -> str:
    """Hash of the frames that are sent, one by one."""
    engine, sent = make_engine(config), hashlib.sha256()
    for stamp, can_id, data in frames.rows():
        for out_id, out in engine.frame(stamp, can_id, data):
            sent.update(b"%x#%b;" % (out_id, out))
    return sent.hexdigest()[:24]


def chunks_of(frames: FrameColumns) -> Iterable[FrameColumns]:
    for start in range(0, len(frames), CHUNK):
        yield frames.take(slice(start, start + CHUNK))


def second_world(name: str) -> tuple[LoadedConfig, Iterable[FrameColumns]] | None:
    """A drive of another simulator, where it is."""
    folder = SHARED_DATA / "second_world" / name
    if not (folder / "can.log.gz").exists():
        return None
    config = open_config(folder / "car.yaml")
    return config, LogReader([folder / "can.log.gz"], make_engine(config).router.matches)


@cache
def frozen() -> dict[str, dict[str, str]]:
    found: dict[str, dict[str, str]] = json.loads(FROZEN.read_text())
    return found


def log_hash() -> str:
    """Of the simulated log and of this machine's arithmetic.

    Another numpy may simulate another drive, and another processor may round the sums of a matrix
    product otherwise: the outputs are others then.
    """
    frames = drive_frames(minutes=MINUTES)
    log = frames.t.tobytes() + frames.can_id.tobytes() + frames.data.tobytes()
    return hashed(log + arithmetic())


def arithmetic() -> bytes:
    """What sums, products, solutions and transforms of fixed numbers come to, to the last bit."""
    x = np.modf(np.arange(1.0, 64.0 * 64.0 + 1.0) * 0.6180339887498949)[0].reshape(64, 64)
    square = x @ x.T + np.eye(64)
    found = [x.sum(axis=0), square, np.linalg.solve(square, x), np.linalg.inv(square)]
    found += [np.einsum("ij,kj,k->i", x, x, x[0]), np.sin(x), np.linalg.eigvalsh(square)]
    return b"".join(a.tobytes() for a in found) + np.fft.rfft(x, axis=0).tobytes()


@pytest.fixture(scope="module")
def same_log() -> None:
    if log_hash() != frozen()["log"]["hash"]:
        pytest.skip("this machine computes otherwise than the one of the frozen outputs")


@pytest.mark.slow
@pytest.mark.usefixtures("same_log")
@pytest.mark.parametrize("case", CASES)
def test_a_simulated_drive_gives_the_frozen_frames_and_result(case, tmp_path):
    sent, result = in_columns(config_of(case, tmp_path), chunks_of(frames_of(case)))
    assert {"frames": sent, "result": result} == frozen()[case]


@pytest.mark.slow
@pytest.mark.usefixtures("same_log")
@pytest.mark.parametrize("case", LIVE)
def test_frame_by_frame_it_gives_the_same(case, tmp_path):
    assert live(config_of(case, tmp_path), frames_of(case)) == frozen()[case]["frames"]


@pytest.mark.slow
@pytest.mark.usefixtures("same_log")
@pytest.mark.parametrize("name", SECOND_WORLD)
def test_a_drive_of_another_simulator_gives_the_frozen_frames_and_result(name):
    found = second_world(name)
    if found is None:
        pytest.skip("the drives of second_world are not here")
    sent, result = in_columns(*found)
    assert {"frames": sent, "result": result} == frozen()[name]


def main() -> None:
    """Write the hashes of what comes now."""
    found = {"log": {"hash": log_hash()}}
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            config = config_of(case, Path(folder))
            found[case] = dict(
                zip(
                    ("frames", "result"),
                    in_columns(config, chunks_of(frames_of(case))),
                    strict=True,
                )
            )
            if case in LIVE:
                assert live(config, frames_of(case)) == found[case]["frames"], case
    for name in SECOND_WORLD:
        if (other := second_world(name)) is not None:
            found[name] = dict(zip(("frames", "result"), in_columns(*other), strict=True))
    FROZEN.write_text(json.dumps(found, indent=2) + "\n")
    imucald(["demo", "--seed", "1", "--minutes", "6", "--svg", str(ROOT / "docs" / "demo.svg")])


if __name__ == "__main__":
    main()
