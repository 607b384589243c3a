"""The evidence in the saved state: saved, restored, doubted, and the same live and in replay."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from imucald.can.columns import FrameColumns
from imucald.mount.contradictions import WORDS, StandingFault
from imucald.mount.estimate import ANGLES, MountState
from imucald.mount.restored import RestoredEstimator
from imucald.runtime.engine import Engine
from imucald.runtime.session import make_engine
from imucald.service.calibration_store import CalibrationStore
from imucald.service.journal import WARNING
from imucald.service.saved_state import StateStore
from service_files import KEY
from simulated_bus import EPOCH, drive_frames, loaded, with_times

GAP_S = 600.0
"""Between the two drives."""


class Keepers:
    """Keepers of one folder, one after the other, and what they say."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.warnings: list[str] = []

    def keeper(self) -> CalibrationStore:
        return CalibrationStore(StateStore(self.folder, KEY), self._say, period=0.0)

    def _say(self, text: str, priority: int) -> None:
        if priority <= WARNING:
            self.warnings.append(text)

    def newest(self) -> Path:
        return max(self.folder.glob("*.[01]"), key=lambda path: path.stat().st_mtime_ns)

    def rewrite(self, change, version: int = 2) -> None:
        """Change the content of all generations; their checksums are right."""
        for path in self.folder.glob("*.[01]"):
            content = json.loads(path.read_bytes().partition(b"\n")[2])
            change(content)
            body = json.dumps(content).encode()
            digest = hashlib.sha256(body).hexdigest()
            path.write_bytes(f"imucald-state {version} {len(body)} {digest}\n".encode() + body)


def drive(engine: Engine, frames: FrameColumns) -> None:
    for start in range(0, len(frames), 20_000):
        engine.columns(frames.take(slice(start, start + 20_000)), keep=False)


def restored(keepers: Keepers) -> Engine:
    engine = make_engine(loaded())
    engine.pipeline.replace(keepers.keeper().restore(engine.pipeline.estimator))
    return engine


@pytest.fixture(scope="module")
def content(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A state file after a drive of eight minutes."""
    keepers = Keepers(tmp_path_factory.mktemp("first"))
    engine = make_engine(loaded())
    drive(engine, drive_frames(minutes=8.0))
    keeper = keepers.keeper()
    keeper.update(engine.pipeline.estimator, 480.0)
    keeper.close(engine.pipeline.estimator, 480.0)
    return keepers.newest().read_bytes()


@pytest.fixture
def keepers(content: bytes, tmp_path: Path) -> Keepers:
    made = Keepers(tmp_path)
    StateStore(tmp_path, KEY).path(0).write_bytes(content)
    return made


def test_a_state_with_all_evidence_is_small(content):
    assert len(content) < 12_000
    assert json.loads(content.partition(b"\n")[2])["evidence"]["evidence_std_deg"].keys() >= {
        "yaw_turn",
        "yaw_dvdt",
        "roll_gravity",
        "pitch_gravity",
    }


def test_the_mount_is_known_better_after_a_second_drive_and_the_next_state_says_so(keepers):
    before = deviation(keepers)
    engine = restored(keepers)
    drive(engine, drive_frames(minutes=8.0))
    keeper = keepers.keeper()
    keeper.restore(make_engine(loaded()).pipeline.estimator)
    keeper.close(engine.pipeline.estimator, 480.0)
    assert deviation(keepers) < before
    assert keepers.warnings == []


def deviation(keepers: Keepers) -> float:
    """Of the saved yaw [rad]."""
    content = json.loads(keepers.newest().read_bytes().partition(b"\n")[2])
    return float(content["covariance"][-1]) ** 0.5


class Troubled:
    """An estimator whose accelerometer's zero has changed."""

    state = MountState.SUSPECT
    text = WORDS[StandingFault.ACCEL_LEVEL] + " (9.81 to 10.40 m/s^2)"

    def __init__(self, served: RestoredEstimator, text: str = text) -> None:
        self.correction = served.correction
        said = dict.fromkeys(ANGLES, text)
        self._estimate = replace(served.estimate(), state=self.state, waiting_for=said)

    def estimate(self):
        return self._estimate


def test_why_the_mount_was_suspect_is_known_after_restarts_and_counts_as_one_remount(keepers):
    keeper = keepers.keeper()
    served = keeper.restore(make_engine(loaded()).pipeline.estimator)
    keeper.update(Troubled(served), 10.0)
    keeper.close(Troubled(served), 11.0)
    for _ in range(2):
        keeper = keepers.keeper()
        estimator = keeper.restore(make_engine(loaded()).pipeline.estimator)
        assert estimator.state is MountState.SUSPECT
        assert estimator.estimate().details["restored"]["doubt"] == Troubled.text
        keeper.update(estimator, 10.0)
        keeper.close(estimator, 11.0)
        assert keeper.status()["remounts"] == 1


def test_a_reason_that_is_found_later_is_saved_at_the_stop_and_is_no_second_remount(keepers):
    keeper = keepers.keeper()
    served = keeper.restore(make_engine(loaded()).pipeline.estimator)
    keeper.update(Troubled(served, "the mount creeps"), 10.0)
    keeper.update(Troubled(served), 11.0)
    keeper.close(Troubled(served), 12.0)
    keeper = keepers.keeper()
    estimator = keeper.restore(make_engine(loaded()).pipeline.estimator)
    assert estimator.estimate().details["restored"]["doubt"] == Troubled.text
    assert keeper.status()["remounts"] == 1


def test_a_restart_before_anything_was_learnt_changes_nothing(keepers):
    before = keepers.newest().read_bytes()
    engine = restored(keepers)
    drive(engine, drive_frames(minutes=8.0).take(slice(0, 5000)))
    keeper = keepers.keeper()
    keeper.update(engine.pipeline.estimator, 10.0)
    keeper.close(engine.pipeline.estimator, 10.0)
    assert keepers.newest().read_bytes() == before


@pytest.mark.parametrize("version", [1, 2])
def test_the_mount_of_an_earlier_version_is_used_without_its_sums(keepers, version):
    sums = {"rotation": [1.0] * 9, "kinds": {}}
    keepers.rewrite(lambda content: content["evidence"].update(sums=sums), version=version)
    estimator = restored(keepers).pipeline.estimator
    assert isinstance(estimator, RestoredEstimator)
    assert estimator.state is MountState.RESTORED
    assert keepers.warnings == []


@pytest.mark.slow
def test_live_and_replay_are_the_same_behind_a_saved_state(keepers):
    frames = drive_frames(minutes=8.0)
    frames = with_times(frames, frames.t + GAP_S)
    frames = frames.take(frames.t < EPOCH + GAP_S + 300.0)
    by_columns, one_by_one = restored(keepers), restored(keepers)
    drive(by_columns, frames)
    for t, can_id, length, data in zip(
        frames.t.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True
    ):
        one_by_one.frame(t, can_id, data[:length].tobytes())
    a, b = (engine.pipeline.estimator for engine in (by_columns, one_by_one))
    assert isinstance(a, RestoredEstimator)
    assert isinstance(b, RestoredEstimator)
    assert a.correction == b.correction
    assert (a.estimate().std, a.distance) == (b.estimate().std, b.distance)


@pytest.mark.slow
def test_a_vehicle_that_stands_wears_out_no_memory(keepers):
    engine = make_engine(loaded())
    drive(engine, drive_frames(minutes=8.0))
    keeper = keepers.keeper()
    for second in range(60):
        for tick in range(10):
            stamp = EPOCH + 480.0 + second + tick / 10.0
            engine.columns(standing(stamp), keep=False)
        keeper.update(engine.pipeline.estimator, 480.0)
        assert keeper.writer.flush(2.0)
    assert keeper.writer.saves <= 4, "the drive's end, and what the last turn of hops makes of it"


def standing(stamp: float) -> FrameColumns:
    """A tenth of a second of the drive's first standstill, at another time."""
    frames = drive_frames(minutes=8.0)
    start = np.searchsorted(frames.t, EPOCH + 2.0)
    part = frames.take(slice(int(start), int(np.searchsorted(frames.t, EPOCH + 2.1))))
    return with_times(part, part.t - (EPOCH + 2.0) + stamp)
